"""A URDF that leaves a number out is read; what needs the number asks for it, naming the key for it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pybullet
import pytest

from safety_harness.cell.robot.capsules import StoredCapsule, StoredCapsules, hashes_of
from safety_harness.cell.robot.description import ArmModel, read_arm, resolved_urdf
from safety_harness.cell.robot.joint_data import Use
from safety_harness.cell.robot.robots import arm_model, drive_model
from safety_harness.cell.robot.urdf import ArmFileError
from safety_harness.cell.simulation.cell import load_robot
from safety_harness.scenario.robots import AnyRobot, robot_named

INERTIAL = '<inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>'
BOX = '<collision><geometry><box size="0.1 0.1 0.3"/></geometry></collision>'
LIMIT = '<limit lower="-2" upper="2" velocity="2" effort="50"/>'
JOINT = """\
<joint name="j{n}" type="revolute"><parent link="{parent}"/><child link="{child}"/>
<origin xyz="0 0 0.3"/><axis xyz="0 1 0"/>{limit}</joint>
"""
SECOND = '<child link="b"/>\n<origin xyz="0 0 0.3"/><axis xyz="0 1 0"/>' + LIMIT


def urdf(old: str = "", new: str = "") -> str:
    """Three joints of +-2 rad, 2 rad/s, 50 N m; ``old`` stands once in it and becomes ``new``."""
    links = [f'<link name="{name}">{INERTIAL}{BOX}</link>' for name in ("base", "a", "b", "c")]
    pairs = zip(("base", "a", "b"), ("a", "b", "c"), strict=True)
    joints = [JOINT.format(n=n, parent=p, child=c, limit=LIMIT) for n, (p, c) in enumerate(pairs, start=1)]
    text = f'<robot name="t">{"".join(links)}\n{"".join(joints)}</robot>'
    assert not old or text.count(old) == 1
    return text.replace(old, new) if old else text


def second(limit: str) -> tuple[str, str]:
    """The change of the second joint's <limit>."""
    return SECOND, SECOND.replace(LIMIT, limit)


def arm_in(folder: Path, change: tuple[str, str]) -> ArmModel:
    (folder / "arm.urdf").write_text(urdf(*change))
    return read_arm(folder / "arm.urdf", base="base", tcp="c")


def robot_in(folder: Path, change: tuple[str, str], keys: str = "") -> AnyRobot:
    """The arm as a scenario names it, in a file with more ``keys``."""
    arm = arm_in(folder, change)
    ends = {"start_in_link_m": (0.0, 0.0, -0.2), "end_in_link_m": (0.0, 0.0, 0.2)}
    capsules = [StoredCapsule(name="a", link="a", **ends, radius_m=0.2)]
    stored = StoredCapsules(
        arm=arm.name, capsules=capsules, base="base", tcp="c", urdf_sha256=hashes_of(arm)[0]
    )
    (folder / "arm.json").write_text(
        json.dumps(
            {name: getattr(stored, name) for name in ("arm", "base", "tcp", "urdf_sha256", "meshes_sha256")}
            | {"capsules": [{"name": "a", "link": "a", **ends, "radius_m": 0.2}]}
        )
    )
    (folder / "arm.yaml").write_text(
        "urdf: arm.urdf\nbase: base\ntcp: c\ncapsules: arm.json\n"
        f"braking: {{reaction time: 100 ms, stop time: 350 ms}}\n{keys}"
    )
    return robot_named(str(folder / "arm.yaml"))


@pytest.mark.parametrize("effort", [' effort="0"', ""])
def test_an_effort_that_is_zero_or_missing_is_unknown(effort: str, tmp_path: Path) -> None:
    arm = arm_in(tmp_path, second(LIMIT.replace(' effort="50"', effort)))
    np.testing.assert_array_equal(arm.effort_limit, [50.0, np.nan, 50.0])
    arm.require(Use.RUN)
    for use in (Use.TORQUES, Use.PHYSICS):
        with pytest.raises(ArmFileError, match=r"the effort of j2, for .*joint torque limits"):
            arm.require(use)


def test_the_file_of_the_arm_supplies_the_torques(tmp_path: Path) -> None:
    change, drives = second(LIMIT.replace(' effort="50"', "")), "drives: {torque limit: 50 %}\n"
    with pytest.raises(ArmFileError, match="for drives with a torque limit"):
        drive_model(robot_in(tmp_path, change, drives))
    model = drive_model(robot_in(tmp_path, change, f"joint torque limits: [10 N m, 20 Nm, 30 N m]\n{drives}"))
    assert model is not None
    assert np.array_equal(np.array(model.torque_limit_nm), [5.0, 10.0, 15.0])


@pytest.mark.parametrize("speed", ["0", "1e16"])
def test_a_speed_of_zero_or_beyond_all_bounds_is_unknown_and_a_run_asks_for_it(
    speed: str, tmp_path: Path
) -> None:
    change = second(LIMIT.replace('velocity="2"', f'velocity="{speed}"'))
    if speed == "1e16":
        change = second(LIMIT.replace('velocity="2"', 'velocity="1001"'))
    with pytest.raises(ArmFileError, match=r"the speed of j2, for a run.*joint speed limits"):
        arm_model(robot_in(tmp_path, change))
    keys = "joint speed limits: [1 rad/s, 2 rad/s, 3 rad/s]\n"
    assert arm_model(robot_in(tmp_path, change, keys)).velocity_limit_radps.tolist() == [1.0, 2.0, 3.0]


def test_what_the_format_makes_optional_has_its_default(tmp_path: Path) -> None:
    arm = arm_in(tmp_path, (SECOND, SECOND.replace('<axis xyz="0 1 0"/>', "")))
    assert arm.joint_axes.tolist() == [[0, 1, 0], [1, 0, 0], [0, 1, 0]]
    arm = arm_in(tmp_path, second('<limit upper="2" velocity="2" effort="50"/>'))
    assert (arm.position_lower_rad[1], arm.position_upper_rad[1]) == (0.0, 2.0)
    endless = urdf().replace('name="j2" type="revolute"', 'name="j2" type="continuous"')
    (tmp_path / "endless.urdf").write_text(endless.replace(SECOND, SECOND.removesuffix(LIMIT)))
    arm = read_arm(tmp_path / "endless.urdf")
    assert (arm.position_lower_rad[1], arm.position_upper_rad[1]) == (-np.inf, np.inf)
    assert [lack.what for lack in arm.lacks] == ["the speed of j2", "the effort of j2"]
    (tmp_path / "endless.urdf").write_text(endless)
    arm = read_arm(tmp_path / "endless.urdf")
    assert np.isinf(arm.position_upper_rad[1])
    assert arm.notes == ("j2 is continuous: its lower and upper limit are not used",)


def test_position_limits_beyond_a_thousand_are_none(tmp_path: Path) -> None:
    arm = arm_in(tmp_path, second('<limit lower="-1e16" upper="1e16" velocity="2" effort="50"/>'))
    assert (arm.position_lower_rad[1], arm.position_upper_rad[1]) == (-np.inf, np.inf)
    arm = arm_in(tmp_path, second('<limit lower="-2" upper="1e16" velocity="2" effort="50"/>'))
    assert (arm.position_lower_rad[1], arm.position_upper_rad[1]) == (-2.0, 1e9)


@pytest.mark.parametrize(
    "size", ['<box size="0 0 0"/>', '<cylinder radius="0" length="0"/>', '<sphere radius="0"/>']
)
def test_an_empty_shape_is_left_out_and_reported(size: str, tmp_path: Path) -> None:
    empty = f"<collision><geometry>{size}</geometry></collision>"
    arm = arm_in(tmp_path, ('<link name="b">', f'<link name="b">{empty}'))
    assert [len(link.collision) for link in arm.links] == [1, 1, 1, 1]
    assert arm.notes == ("an empty <collision> of b is left out: its size is 0",)
    assert size not in resolved_urdf(arm, visuals=False)
    flat = (
        '<link name="b">',
        '<link name="b"><collision><geometry><box size="1 1 0"/></geometry></collision>',
    )
    with pytest.raises(ArmFileError, match="a size above 0"):  # a plate is something that can be hit
        arm_in(tmp_path, flat)


@pytest.mark.parametrize("ixx", ["0", "-1", "9"])
def test_an_inertia_that_no_body_has_is_asked_for_by_drives_and_pybullet_alone(
    ixx: str, tmp_path: Path
) -> None:
    link = f'<link name="b">{INERTIAL}'
    change = link, link.replace('ixx="1"', f'ixx="{ixx}"')
    arm = arm_in(tmp_path, change)
    assert arm.without_inertia == ("b",)
    arm.require(Use.RUN)
    with pytest.raises(ArmFileError, match="inertia that a body can have, of b, for drives with a torque"):
        drive_model(robot_in(tmp_path, change, "drives: {torque limit: 50 %}\n"))
    client = pybullet.connect(pybullet.DIRECT)
    try:
        with pytest.raises(ArmFileError, match="inertia that a body can have, of b, for a world with motors"):
            load_robot(client, arm, visuals=False)
    finally:
        pybullet.disconnect(client)


def test_soft_limits_are_reported_and_taken_if_the_file_says_so(tmp_path: Path) -> None:
    soft = '<safety_controller soft_lower_limit="-1" soft_upper_limit="3" k_velocity="1"/>'
    change = SECOND, SECOND + soft
    np.testing.assert_array_equal(
        arm_in(tmp_path, change).soft_limits_rad, [[np.nan] * 2, [-1, 3], [np.nan] * 2]
    )
    hard, limited = (arm_model(robot_in(tmp_path, change, keys)) for keys in ("", "soft limits: yes\n"))
    assert hard.position_lower_rad.tolist() == [-2.0, -2.0, -2.0]
    assert limited.position_lower_rad.tolist() == [-2.0, -1.0, -2.0]
    assert limited.position_upper_rad.tolist() == [2.0, 2.0, 2.0]  # the narrower of both
    with pytest.raises(ArmFileError, match="a <safety_controller> with soft limits"):
        arm_model(robot_in(tmp_path, ("", ""), "soft limits: yes\n"))


@pytest.mark.parametrize(
    ("upper", "speed", "suspect"),
    [("180", "120", True), ("90", "0", True), ("180", "2", False), ("170", "120", False)],
)
def test_limits_that_look_like_degrees_are_refused_by_a_run(
    upper: str, speed: str, suspect: bool, tmp_path: Path
) -> None:
    change = second(f'<limit lower="-{upper}" upper="{upper}" velocity="{speed}" effort="50"/>')
    arm = arm_in(tmp_path, change)
    assert arm.in_degrees is suspect
    speeds = "joint speed limits: [1 rad/s, 2 rad/s, 3 rad/s]\n"
    if suspect:
        with pytest.raises(ArmFileError, match=r"look like degrees.*`angles: rad`.*180 deg is 3.14159"):
            arm_model(robot_in(tmp_path, change, speeds))
    assert arm_model(robot_in(tmp_path, change, f"{speeds}angles: rad\n")).position_upper_rad[1] == float(
        upper
    )
