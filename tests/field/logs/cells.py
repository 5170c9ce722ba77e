"""A synthetic cell: an arm and a hand whose motion is known at every instant, and logs of it."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from safety_harness.cell.robot.description import load_arm
from safety_harness.cell.robot.kinematics import links_in_base

Floats = NDArray[np.float64]
NAMES = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint",
         "wrist_3_joint")  # fmt: skip
MIDDLE_RAD = np.array([-0.22, -1.27, 1.98, -2.27, -1.57, -0.22])
SWING_RAD = np.array([0.25, 0.10, 0.10, 0.15, 0.10, 0.20])
HARDEST_RADPS2 = 4.0
FASTEST_MPS = 1.0
NEAR_M = 0.4  # the critical distance of the settings


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
    words: Words | None = None


@dataclass(frozen=True, eq=False)
class Words:
    """What the controller told at every sample of the joints, and of its decisions."""

    mode: list[str]
    limits: list[int]
    commands_radps: Floats
    predicted_m: Floats
    decided_ns: NDArray[np.int64]
    places_m: dict[str, Floats]  # (m, 3) by field
    outcome: list[str]
    trigger: list[str]


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


def words_of(cell: Cell, streams: Streams, *, late_s: float = 0.04, off_m: float = 0.01) -> Words:
    """A controller that predicts 100 ms ahead, ``off_m`` wrongly, and gives way ``late_s`` after that.

    It decides when it begins, and brakes from 0.2 s after that on.
    """
    time_s = (streams.joint_ns - streams.joint_ns[0]) / 1e9
    predicted = cell.hand_m(time_s + 0.1) + np.array([0.0, 0.0, off_m])
    near = np.linalg.norm(predicted - tcp_m(cell.joints_rad(time_s)), axis=1) < NEAR_M
    late = round(late_s / 0.008)
    gives = np.concatenate([np.zeros(late, bool), near])[: len(near)]
    at = np.flatnonzero(gives & ~np.append(False, gives[:-1]))
    brakes = gives & np.append(np.zeros(25, bool), gives)[: len(gives)]
    tcp, hand = tcp_m(cell.joints_rad(time_s[at])), predicted[at]
    away = (tcp - hand) / np.linalg.norm(tcp - hand, axis=1, keepdims=True)
    return Words(
        mode=["RETREAT" if one else "RUN" for one in gives],
        limits=[2 if one else 0 for one in brakes],
        commands_radps=cell.rates_radps(time_s),
        predicted_m=predicted,
        decided_ns=streams.joint_ns[at],
        places_m={"hand": hand, "tcp": tcp, "proposed": tcp + 0.1 * away, "chosen": tcp + 0.1 * away},
        outcome=["OK"] * len(at),
        trigger=["hand entered"] * len(at),
    )


def tcp_m(joints_rad: Floats) -> Floats:
    """(n, 3) of the arm at (n, 6)."""
    arm = load_arm("ur10")
    return np.array([links_in_base(arm, row)[-1][:3, 3] for row in joints_rad]).reshape(-1, 3)


def rows_of(words: Words) -> tuple[dict[str, list[object]], dict[str, list[object]]]:
    """The columns of two tables: what was told regularly, and the decisions."""
    regular: dict[str, list[object]] = {"state": list(words.mode), "flags": list(words.limits)}
    for name, column in zip(NAMES, words.commands_radps.T, strict=True):
        regular[f"to_{name}_radps"] = column.tolist()
    for axis, column in zip("xyz", words.predicted_m.T, strict=True):
        regular[f"right_{axis}_m"] = [None if np.isnan(one) else one for one in column.tolist()]
    decided: dict[str, list[object]] = {"result": list(words.outcome), "why": list(words.trigger)}
    for field, rows in words.places_m.items():
        for axis, column in zip("xyz", rows.T, strict=True):
            decided[f"{field}_{axis}_m"] = column.tolist()
    return regular, decided


def _write_words(streams: Streams, folder: Path) -> None:
    if streams.words is None:
        return
    regular, decided = rows_of(streams.words)
    for name, time_ns, columns in (
        ("words", streams.joint_ns, regular),
        ("decisions", streams.words.decided_ns, decided),
    ):
        lines = ["time_ns," + ",".join(columns)]
        for t, row in zip(time_ns.tolist(), zip(*columns.values(), strict=True), strict=True):
            lines.append(f"{t}," + ",".join("" if one is None else str(one) for one in row))
        (folder / f"{name}.csv").write_text("\n".join(lines) + "\n")


def write_csv(streams: Streams, folder: Path) -> None:
    """``joints.csv`` and ``hands.csv``, ``words.csv`` and ``decisions.csv``."""
    _write_words(streams, folder)
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
log: {{joints: "{joints}", hands: "{hands}"{streams}}}
clock: {{hands are ahead by: 137 ms, known to: 5 ms}}
joints: {{known to: 0.2 mrad, accelerate at most: {hardest} rad/s2}}
hands:
  forearm: "{elbow}"
  longest gap: 200 ms
  moves at most: {fastest} m/s
  known to: 8 mm
  {frame}
robot: UR10
{told}claims:
  - hand distance never below 50 mm
  - always hand distance > 50 mm
  - protective separation kept from hands at their own speeds
  - joint positions within limits
  - joint speeds within limits
  - never retreats without a hand
"""


TOLD = """\
mode: {{words: {{RUN: servoing, RETREAT: repulsing}}, known to: 0 ms, longest gap: 40 ms}}
limits: {{words: {{0: none, 2: braking, 3: joint speed and braking}}, known to: 0 ms, longest gap: 40 ms}}
commands: {{known to: 0 ms, longest gap: 40 ms}}
detections: {{ahead by: 100 ms, known to: 0 ms, longest gap: until the next{frame}}}
decisions:
  known to: 0 ms
  frame: base
  fields: {{hand: hand, tcp: tcp, proposed: proposed, chosen: chosen, outcome: result, trigger: why}}
  words: {{outcome: {{OK: proposed, OTHER: opposite, HALT: stop}}}}
"""
TOLD_CLAIMS = """\
  - starts retreating within 100 ms of a predicted hand
  - starts retreating within 100 ms of a true hand
  - hand predictions within 60 mm
  - proposals lead away to within 10 mm
  - repulsion moves away from every hand to within 5 mm
  - always hand tracked
"""


def said(
    joints: str,
    hands: str,
    elbow: str,
    frame: str = "frame: base",
    told: dict[str, str] | None = None,
    told_frame: str = "",
) -> str:
    """The text of a LOG.yaml; ``told`` are the streams of what the controller said."""
    streams = "".join(f', {name}: "{one}"' for name, one in (told or {}).items())
    text = SAID.format(
        joints=joints,
        hands=hands,
        elbow=elbow,
        frame=frame,
        hardest=HARDEST_RADPS2,
        fastest=FASTEST_MPS,
        streams=streams,
        told=TOLD.format(frame=f", {told_frame}" if told_frame else "") if told else "",
    )
    return text + TOLD_CLAIMS if told else text


def wrapped(streams: Streams, joint: int) -> Streams:
    """One joint goes through half a turn, and its angles wrap there."""
    angles = streams.joints_rad.copy()
    angles[:, joint] += np.pi - angles[len(angles) // 2, joint]
    angles[:, joint] = (angles[:, joint] + np.pi) % (2.0 * np.pi) - np.pi
    assert np.abs(np.diff(angles[:, joint])).max() > 6.0
    return replace(streams, joints_rad=angles)


def endless_arm(folder: Path) -> str:
    """Return the file of a UR10e whose last joint has no ends."""
    robots = Path(__file__).parents[3] / "robots"
    old = (robots / "ur10e.urdf").read_text()
    new = old.replace('"wrist_3_joint" type="revolute"', '"wrist_3_joint" type="continuous"')
    assert new != old
    before, after = (hashlib.sha256(text.encode()).hexdigest() for text in (old, new))
    for file in robots.glob("ur10e*"):
        text = new if file.suffix == ".urdf" else file.read_text().replace(before, after)
        (folder / file.name).write_text(text)
    return str(folder / "ur10e.yaml")
