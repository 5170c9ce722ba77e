"""A synthetic cell: an arm and a hand whose motion is known at every instant, and logs of it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
NAMES = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint",
         "wrist_3_joint")  # fmt: skip
MIDDLE_RAD = np.array([-0.22, -1.27, 1.98, -2.27, -1.57, -0.22])
SWING_RAD = np.array([0.25, 0.10, 0.10, 0.15, 0.10, 0.20])
HARDEST_RADPS2 = 4.0
FASTEST_MPS = 1.0


@dataclass(frozen=True, eq=False)
class Cell:
    """Joints swing, the hand goes to and fro and stops; both are smooth, within the bounds above."""

    rate_radps: Floats
    phase_rad: Floats
    from_m: Floats
    to_m: Floats
    hand_rate_radps: float
    forearm_m: Floats

    def joints_rad(self, time_s: Floats) -> Floats:
        """(n, 6)."""
        return MIDDLE_RAD + SWING_RAD * np.sin(self.rate_radps * time_s[:, None] + self.phase_rad)

    def rates_radps(self, time_s: Floats) -> Floats:
        """(n, 6)."""
        return SWING_RAD * self.rate_radps * np.cos(self.rate_radps * time_s[:, None] + self.phase_rad)

    def hand_m(self, time_s: Floats) -> Floats:
        """(n, 3)."""
        far = 0.5 - 0.5 * np.cos(self.hand_rate_radps * time_s)[:, None]
        return self.from_m + far * (self.to_m - self.from_m)

    def elbow_m(self, time_s: Floats) -> Floats:
        """(n, 3)."""
        return self.hand_m(time_s) + self.forearm_m


def cell(rng: np.random.Generator) -> Cell:
    """Any such cell."""
    start = np.array([1.2, rng.uniform(-0.6, 0.6), 0.2])
    end = np.array([rng.uniform(0.6, 1.05), rng.uniform(-0.5, 0.5), rng.uniform(0.0, 0.6)])
    way_m = np.linalg.norm(end - start)
    return Cell(
        rate_radps=rng.uniform(0.5, 2.5, 6),
        phase_rad=rng.uniform(0.0, 2.0 * np.pi, 6),
        from_m=start,
        to_m=end,
        hand_rate_radps=float(rng.uniform(0.3, 1.0) * 2.0 * FASTEST_MPS / way_m),
        forearm_m=np.array([0.3, 0.0, 0.1]),
    )


@dataclass(frozen=True, eq=False)
class Streams:
    """What recorders wrote of a cell: times on their own clocks, in nanoseconds."""

    joint_ns: NDArray[np.int64]
    joints_rad: Floats
    hand_ns: NDArray[np.int64]
    hand_m: Floats
    elbow_m: Floats


def recorded(
    cell: Cell,
    rng: np.random.Generator,
    *,
    seconds: float = 3.0,
    ahead_s: float = 0.137,
    clock_s: float = 0.005,
    joints_off_rad: float = 2e-4,
    hand_off_m: float = 0.008,
    lost: tuple[tuple[float, float], ...] = (),
    start_ns: int = 1_700_000_000_000_000_000,
) -> Streams:
    """Joints at 125 Hz and hands at 30 Hz, both with jitter; ``lost`` are times without hands."""
    n = int(seconds * 125) + 1
    joint_s = np.arange(n) * 0.008 + rng.uniform(-5e-4, 5e-4, n)
    joint_s[0] = 0.0
    hand_s = np.arange(-0.05, seconds + 0.05, 1.0 / 30.0)
    hand_s = hand_s + rng.uniform(-3e-3, 3e-3, len(hand_s))
    for begin, end in lost:
        hand_s = hand_s[(hand_s < begin) | (hand_s > end)]
    off_s = rng.uniform(-clock_s, clock_s) if clock_s else 0.0
    own = rng.uniform(-1.0, 1.0, (2, len(hand_s), 3))
    own *= (hand_off_m * rng.uniform(0.0, 1.0, (2, len(hand_s), 1))) / np.maximum(
        np.linalg.norm(own, axis=2, keepdims=True), 1e-9
    )
    noise = rng.uniform(-1.0, 1.0, (n, 6)) * joints_off_rad
    return Streams(
        joint_ns=start_ns + np.round(joint_s * 1e9).astype(np.int64),
        joints_rad=cell.joints_rad(joint_s) + noise,
        hand_ns=start_ns + np.round((hand_s + ahead_s + off_s) * 1e9).astype(np.int64),
        hand_m=cell.hand_m(hand_s) + own[0],
        elbow_m=cell.elbow_m(hand_s) + own[1],
    )


def write_csv(streams: Streams, folder: Path) -> None:
    """``joints.csv`` and ``hands.csv``."""
    lines = ["time_ns," + ",".join(f"{name}_rad" for name in NAMES)]
    lines += [
        f"{t}," + ",".join(repr(float(a)) for a in row)
        for t, row in zip(streams.joint_ns.tolist(), streams.joints_rad, strict=True)
    ]
    (folder / "joints.csv").write_text("\n".join(lines) + "\n")
    names = [f"{track}_{axis}_m" for track in ("hand", "elbow") for axis in "xyz"]
    rows = np.hstack([streams.hand_m, streams.elbow_m])
    lines = ["time_ns," + ",".join(names)]
    lines += [
        f"{t}," + ",".join(repr(float(a)) for a in row)
        for t, row in zip(streams.hand_ns.tolist(), rows, strict=True)
    ]
    (folder / "hands.csv").write_text("\n".join(lines) + "\n")


SAID = """\
log: {{joints: "{joints}", hands: "{hands}"}}
clock: {{hands are ahead by: 137 ms, known to: 5 ms}}
joints: {{known to: 0.2 mrad, accelerate at most: {hardest} rad/s2}}
hands:
  forearm: "{elbow}"
  longest gap: 200 ms
  moves at most: {fastest} m/s
  known to: 8 mm
  {frame}
robot: UR10
claims:
  - hand distance never below 50 mm
  - always hand distance > 50 mm
  - protective separation kept from hands at their own speeds
  - joint positions within limits
  - joint speeds within limits
  - never gives way without a hand
"""


def said(joints: str, hands: str, elbow: str, frame: str = "frame: base") -> str:
    """The text of a LOG.yaml."""
    return SAID.format(
        joints=joints, hands=hands, elbow=elbow, frame=frame, hardest=HARDEST_RADPS2, fastest=FASTEST_MPS
    )
