"""A log is judged with the tool that is mounted on its arm."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from safety_harness.admission.admit import admit
from safety_harness.admission.trial import judge
from safety_harness.base.exceptions import InadmissibleError, InputError
from safety_harness.cell.robot.description import load_arm
from safety_harness.cell.robot.kinematics import links_in_base
from safety_harness.cell.robot.robots import refuse_unenclosed
from safety_harness.extensions.field.logs.judging import recorded as judged_log
from safety_harness.scenario.model import Verdict
from tests.cell.robot.test_enclosed import TOOL, scenario

SHORT = TOOL.replace("250 mm], radius", "80 mm], radius")
JOINTS_RAD = np.array([-0.22, -1.27, 1.98, -2.27, -1.57, -0.22])
CLAIM = "hand distance never below 50 mm"


def log_with(robot: str, folder: Path) -> Path:
    """A UR10 that stands still for a second, and a hand 30 mm inside of where its tool is."""
    flange = links_in_base(load_arm(), JOINTS_RAD)[-1]
    hand_m = (flange @ [0.075, 0.0, 0.230, 1.0])[:3]  # radii of 45 mm and 60 mm, 75 mm between the centres
    names = [f"{name}_rad" for name in load_arm().joint_names]
    times = range(0, 1_000_000_001, 8_000_000)
    for file, columns, row in (
        ("joints.csv", names, JOINTS_RAD),
        ("hands.csv", ["hand_x_m", "hand_y_m", "hand_z_m"], hand_m),
    ):
        text = ",".join(map(repr, row.tolist()))
        lines = [",".join(["time_ns", *columns]), *(f"{time},{text}" for time in times)]
        (folder / file).write_text("\n".join(lines) + "\n")
    (folder / "LOG.yaml").write_text(
        'log: {joints: joints.csv, hands: "hands.csv#hand"}\n'
        "clock: {hands are ahead by: 0 ms, known to: 0 ms}\n"
        "joints: {known to: 0 mrad, accelerate at most: 1 rad/s2}\n"
        "hands: {forearm: none, longest gap: 200 ms, moves at most: 0.1 m/s, known to: 0 mm, frame: base}\n"
        f"robot: {robot}\nclaims:\n  - {CLAIM}\n"
    )
    return folder / "LOG.yaml"


def test_a_hand_inside_of_the_tool_of_a_named_arm_is_a_violation(tmp_path: Path) -> None:
    (bare,) = judge(judged_log(log_with("UR10", tmp_path)).trace)
    (tooled,) = judge(judged_log(log_with(f"{{arm: UR10, {TOOL}}}", tmp_path)).trace)
    assert (bare.verdict, tooled.verdict) == (Verdict.HOLDS, Verdict.VIOLATED)
    assert bare.margin > 0.05
    assert tooled.margin == pytest.approx(-0.030 - 0.050, abs=1e-3)


def test_a_tool_that_ends_before_its_tcp_is_refused_unless_that_is_accepted(tmp_path: Path) -> None:
    short = f"{{arm: UR10, {SHORT}}}"  # the axis ends 170 mm before the TCP, its capsule 125 mm
    with pytest.raises(InadmissibleError, match=r"within 20 mm of a capsule.*125\.0 mm away"):
        admit(scenario(short))
    with pytest.raises(InputError, match=r"tcp beyond capsules: 125 mm"):
        judged_log(log_with(short, tmp_path))
    accepted = short.replace("arm: UR10", "arm: UR10, tcp beyond capsules: 130 mm")
    refuse_unenclosed(scenario(accepted).robot)
    with pytest.raises(InputError, match=r"within 120 mm"):
        refuse_unenclosed(scenario(accepted.replace("130 mm", "120 mm")).robot)
