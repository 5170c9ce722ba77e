"""A named arm takes a tool; a link or a TCP that no capsule encloses is refused unless a file accepts it."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec
import numpy as np
import pytest

from safety_harness.admission.admit import admit
from safety_harness.admission.trial import judge
from safety_harness.base.exceptions import InadmissibleError, InputError
from safety_harness.base.geometry.segments import point_segment_distance
from safety_harness.base.shipped.contents import located
from safety_harness.cell.robot.capsules import StoredCapsules, read_capsules, tcp_beyond
from safety_harness.cell.robot.description import load_arm, read_arm
from safety_harness.cell.robot.kinematics import links_in_base
from safety_harness.cell.robot.robots import arm_capsules, arm_model, refuse_unenclosed
from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT
from safety_harness.extensions.arms import fit_capsules
from safety_harness.extensions.arms.commands import fit
from safety_harness.extensions.field.logs.judging import recorded as judged_log
from safety_harness.scenario.model import Scenario, Verdict
from safety_harness.scenario.read import parse_scenario, read_scenario
from safety_harness.scenario.robots import EquippedArm, Robot, robot_named
from safety_harness.scenario.write import write_scenario
from tests.cell.robot.urdfs import small_arm_in

PIECE = "{from: [0 mm, 0 mm, 0 mm], to: [0 mm, 0 mm, 250 mm], radius: 45 mm}"
TOOL = f"tool: {{position: [0 mm, 0 mm, 250 mm], capsules: [{PIECE}]}}"
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


def scenario(robot: str) -> Scenario:
    return parse_scenario(f"{located('shipped:fast-reach').read_text()}robot: {robot}\n")


def test_a_hand_inside_of_the_tool_of_a_named_arm_is_a_violation(tmp_path: Path) -> None:
    (bare,) = judge(judged_log(log_with("UR10", tmp_path)).trace)
    (tooled,) = judge(judged_log(log_with(f"{{arm: UR10, {TOOL}}}", tmp_path)).trace)
    assert (bare.verdict, tooled.verdict) == (Verdict.HOLDS, Verdict.VIOLATED)
    assert bare.margin > 0.05
    assert tooled.margin == pytest.approx(-0.030 - 0.050, abs=1e-3)


def test_what_is_mounted_on_a_named_arm_is_written_and_read_again(tmp_path: Path) -> None:
    text = f"{{arm: UR5, {TOOL}, carries: [{PIECE}], seated at: {{yaw: 90 deg}}}}"
    first = scenario(text)
    assert isinstance(first.robot, EquippedArm)
    assert first.robot.label == "UR5 with another seat and a tool and a part"
    assert parse_scenario(write_scenario(first)).robot == first.robot
    assert scenario("{arm: UR5}").robot is Robot.UR5
    (tmp_path / "below").mkdir()
    (tmp_path / "base.yaml").write_text(write_scenario(first))
    (tmp_path / "below" / "child.yaml").write_text("scenario: two\nextends: ../base.yaml\n")
    assert read_scenario(tmp_path / "below" / "child.yaml").robot == first.robot


def test_a_mounted_tool_moves_the_tcp_and_is_enclosed() -> None:
    robot = scenario(f"{{arm: UR10, {TOOL}}}").robot
    bare, arm = load_arm(), arm_model(robot)
    np.testing.assert_allclose(
        arm.flange, bare.flange @ [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0.25], [0, 0, 0, 1]]
    )
    names = arm_capsules(robot).names
    assert names[-1] == "tool 1"
    assert len(names) == 1 + len(arm_capsules(Robot.UR10).names)


@pytest.mark.parametrize(
    ("robot", "complaint"),
    [
        ("{arm: UR11, tool: {}}", "expected UR10, UR5 or UR3"),
        (f"{{arm: UR10, {TOOL}, base: base_link}}", 'got the key "base"'),
        (f"{{arm: UR10, {TOOL}, braking: {{stop time: 1 s}}}}", r"settings: \{braking: ...\}"),
    ],
)
def test_other_keys_beside_a_named_arm_are_refused(robot: str, complaint: str) -> None:
    with pytest.raises(InputError, match=complaint):
        scenario(robot)


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


def test_every_shipped_arm_encloses_its_links_and_its_tcp() -> None:
    for name in ("iiwa14", "panda", "xarm6", "ur10e"):
        robot = robot_named(f"shipped:{name}")
        refuse_unenclosed(robot)
        assert tcp_beyond(arm_model(robot), arm_capsules(robot)) == 0.0


def test_the_last_link_with_capsules_counts_where_the_last_has_none(tmp_path: Path) -> None:
    """The small arm's hand is bare: its TCP is 300 mm from the frame of the link before it."""
    arm = read_arm(small_arm_in(tmp_path), base="foot", tcp="hand")
    end = {"name": "lower", "link": "lower", "start_in_link_m": (0, 0, 0), "end_in_link_m": (0.1, 0, 0)}
    stored = msgspec.convert({"arm": "small", "capsules": [{**end, "radius_m": 0.05}]}, StoredCapsules)
    capsules = stored.on(arm, tmp_path)
    expected = point_segment_distance(np.array([0.3, 0, 0]), np.zeros(3), np.array([0.1, 0, 0])) - 0.05
    assert tcp_beyond(arm, capsules) == pytest.approx(expected) == pytest.approx(0.15)


@pytest.fixture
def gapped(tmp_path: Path) -> Path:
    """A URDF whose second link has no shape, between others that have one."""
    box = '<visual><geometry><box size="0.1 0.1 0.2"/></geometry></visual>'
    links = [f'<link name="l{k}">{"" if k == 1 else box}</link>' for k in range(4)]
    joints = [
        f'<joint name="j{k}" type="revolute"><parent link="l{k}"/><child link="l{k + 1}"/>'
        '<origin xyz="0 0 0.2"/><axis xyz="0 1 0"/>'
        '<limit lower="-1" upper="1" velocity="2" effort="9"/></joint>'
        for k in range(3)
    ]
    (tmp_path / "arm.urdf").write_text(f'<robot name="gapped">{"".join(links + joints)}</robot>')
    return tmp_path / "arm.urdf"


def test_a_link_without_geometry_between_others_is_refused_unless_it_is_accepted(
    gapped: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fit_capsules, "STARTS", 1)
    out = tmp_path / "arm.json"
    assert fit(gapped, out) == BAD_INPUT
    assert "no shape of l1" in capsys.readouterr().err
    assert not out.exists()
    assert fit(gapped, out, without_geometry=["l1"]) == AS_EXPECTED
    assert {one["link"] for one in json.loads(out.read_text())["capsules"]} == {"l0", "l2", "l3"}
    text = "urdf: arm.urdf\nbase: l0\ntcp: l3\ncapsules: arm.json\n"
    text += "braking: {reaction time: 0 ms, stop time: 0 ms}\n"
    (tmp_path / "arm.yaml").write_text(text)
    read_capsules(out, read_arm(gapped))
    with pytest.raises(InputError, match=r"arm\.yaml.*every link between.*none of l1 .*geometry: \[l1\]"):
        refuse_unenclosed(robot_named(str(tmp_path / "arm.yaml")))
    (tmp_path / "arm.yaml").write_text(text + "without geometry: [l1]\n")
    refuse_unenclosed(robot_named(str(tmp_path / "arm.yaml")))
