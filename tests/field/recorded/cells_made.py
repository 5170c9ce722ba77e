"""Synthetic recorded cells: what a simulated run did, written as the recorders of a cell would."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from safety_harness.admission.admit import admit
from safety_harness.admission.trial import run_kinematic
from safety_harness.cell.robot.robots import arm_model
from safety_harness.scenario.read import parse_scenario
from safety_harness.trace.trace import Trace

Floats = NDArray[np.float64]
CELL = """\
scenario: a hand reaches for the tool
duration: 2 s
avoider: opposite pose
tcp start:
  offset: [0 mm, 10 mm, 20 mm]
hands:
  - hand: right hand
    starts at: [800 mm, -600 mm, 400 mm]
    elbow towards: [1000 mm, -1200 mm, 500 mm]
    moves:
      - wait: 300 ms
      - reach for tcp: 1 m/s
        stop at distance: 100 mm
        give up after: 1.2 s
claims:
  joint speeds within limits: holds
"""
LOG = """\
title: {title}
log: {{joints: joints.csv, hands: {{{hands}}}{part}}}
clock: {{hands are ahead by: {ahead_ms} ms, known to: 2 ms}}
joints: {{known to: {joints_mrad} mrad, accelerate at most: 20 rad/s2}}
hands:
  forearm: {{{elbows}}}
  frame: base
  longest gap: {gap_ms} ms
  moves at most: 3 m/s
  known to: {hands_mm} mm
robot: {robot}
claims:
{claims}
"""


def run_of_cell() -> Trace:
    """What arm and hand of CELL do, in the kinematic world."""
    return run_kinematic(admit(parse_scenario(CELL)))


def write_log(
    trace: Trace,
    folder: Path,
    *claims: str,
    ahead_ms: int = 137,
    late_s: float = 0.0,
    offset_rad: Floats | None = None,
    every: int = 1,
    lost_s: tuple[float, float] | None = None,
    gap_ms: int = 200,
    part: str = "",
    forearms: bool = True,
    noise: np.random.Generator | None = None,
    joints_mrad: float = 0.01,
    hands_mm: float = 1.0,
) -> Path:
    """LOG.yaml, joints.csv at every tick, hands.csv at one in ``every``, of a simulated run.

    The joints are ``late_s`` behind what the arm did, and off by ``offset_rad`` (j,); no hand is seen in
    ``lost_s``.  With ``noise`` each is off by up to ``joints_mrad`` and ``hands_mm``.
    """
    folder.mkdir(parents=True, exist_ok=True)
    names, time_s = arm_model(trace.scenario.robot).joint_names, trace.time_s
    joints = trace.ticks["joint_position_rad"]
    joints = np.column_stack([np.interp(time_s - late_s, time_s, column) for column in joints.T])
    joints = joints + (0.0 if offset_rad is None else offset_rad)
    if noise is not None:
        joints = joints + noise.uniform(-joints_mrad, joints_mrad, joints.shape) * 1e-3
    _table(folder / "joints.csv", time_s, [f"{name}_rad" for name in names], joints)
    number = len(trace.scenario.hands)
    points = [
        trace.ticks[f"{one}_position_in_base_m"][:, k] for k in range(number) for one in ("hand", "elbow")
    ]
    tracks = [f"{one}{k}" for k in range(number) for one in ("hand", "elbow")]
    kept = np.arange(0, len(time_s), every)
    if lost_s is not None:
        kept = kept[(time_s[kept] <= lost_s[0]) | (time_s[kept] >= lost_s[1])]
    places = np.hstack(points)[kept]
    if noise is not None:  # in a cube within the sphere of what is said
        places = places + noise.uniform(-hands_mm, hands_mm, places.shape) * 1e-3 / np.sqrt(3.0)
    columns = [f"{track}_{axis}_m" for track in tracks for axis in "xyz"]
    _table(folder / "hands.csv", time_s[kept] + ahead_ms / 1e3, columns, places)
    hands = [one.name for one in trace.scenario.hands]
    text = LOG.format(
        title=f"a simulated run of {trace.scenario.name}",
        hands=", ".join(f'{name}: "hands.csv#hand{k}"' for k, name in enumerate(hands)),
        elbows=", ".join(
            f'{name}: "hands.csv#elbow{k}"' if forearms else f"{name}: not measured"
            for k, name in enumerate(hands)
        ),
        part=part,
        ahead_ms=ahead_ms,
        gap_ms=gap_ms,
        joints_mrad=joints_mrad,
        hands_mm=hands_mm,
        robot=trace.scenario.robot.label,
        claims="\n".join(f"  {claim}" for claim in claims),
    )
    file = folder / "LOG.yaml"
    file.write_text(text)
    return file


def _table(file: Path, time_s: Floats, names: list[str], values: Floats) -> None:
    lines = ["time_ns," + ",".join(names)]
    for time, row in zip(time_s.tolist(), values.tolist(), strict=True):
        lines.append(f"{round(time * 1e9)}," + ",".join(map(repr, row)))
    file.write_text("\n".join(lines) + "\n")
