"""The numbers of arms of four makers, beside two other readers: PyBullet, and the plain rules of a URDF."""

import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pybullet
import pytest

from safety_harness.base.exceptions import ArmModelError
from safety_harness.base.geometry.rotations import rotation_about
from safety_harness.cell.robot.closed_form import arm_geometry
from safety_harness.cell.robot.description import (
    PACKAGES,
    ArmModel,
    load_arm,
    read_arm,
    resolved_urdf,
    urdf_file,
)
from tests.cell.robot.arms import ARMS, pose_of_link
from tests.cell.robot.urdfs import OTHERS

POSES = 20


def arm_named(name: str) -> ArmModel:
    if name in ARMS:
        return load_arm(name)
    file, base, tcp = OTHERS[name]
    return read_arm(file, base=base, tcp=tcp)


def transforms(arm: ArmModel, joints: np.ndarray) -> list[np.ndarray]:
    """Of the moving links, then of the tcp (4, 4) to the base, by NumPy."""
    found, frame, turn = [], np.eye(4), np.eye(4)
    for origin, axis, angle in zip(arm.joint_origins, arm.joint_axes, joints, strict=True):
        cross = np.cross(np.eye(3), axis)
        turn[:3, :3] = np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross
        frame = frame @ origin @ turn
        found.append(frame)
    return [*found, frame @ arm.flange]


@contextmanager
def in_bullet(name: str, folder: Path) -> Iterator[tuple[int, int]]:
    """Body and client of an arm in PyBullet."""
    file = arm_named(name).file
    if name in ARMS:
        file = folder / "arm.urdf"
        file.write_text(resolved_urdf(arm_named(name), visuals=False))
    client = pybullet.connect(pybullet.DIRECT)
    try:
        yield pybullet.loadURDF(str(file), useFixedBase=True, physicsClientId=client), client
    finally:
        pybullet.disconnect(client)


@pytest.mark.parametrize("name", ["ur10", *OTHERS])
def test_every_link_stands_where_pybullet_has_it_and_limits_are_its_own(name: str, tmp_path: Path) -> None:
    arm, rng = arm_named(name), np.random.default_rng(1)
    with in_bullet(name, tmp_path) as (body, client):
        rows = [pybullet.getJointInfo(body, i, client) for i in range(pybullet.getNumJoints(body, client))]
        of_joint = {row[1].decode(): row for row in rows}
        of_link = {row[12].decode(): row[0] for row in rows}
        base_name = pybullet.getBodyInfo(body, client)[0].decode()
        rows = [of_joint[joint] for joint in arm.joint_names]
        np.testing.assert_allclose(arm.position_lower_rad, [row[8] for row in rows], atol=1e-9)
        np.testing.assert_allclose(arm.position_upper_rad, [row[9] for row in rows], atol=1e-9)
        np.testing.assert_allclose(arm.effort_limit, [row[10] for row in rows], atol=1e-9)
        np.testing.assert_allclose(arm.velocity_limit_radps, [row[11] for row in rows], atol=1e-9)
        assert [row[12].decode() for row in rows] == list(arm.link_names[1:])
        for _ in range(POSES):
            joints = rng.uniform(arm.position_lower_rad, arm.position_upper_rad)
            for row, angle in zip(rows, joints, strict=True):
                pybullet.resetJointState(body, row[0], angle, physicsClientId=client)
            base = np.eye(4)
            if arm.link_names[0] != base_name:
                base = pose_of_link(body, of_link[arm.link_names[0]], client)
            links = [*arm.link_names[1:], arm.tcp_link]
            for link, ours in zip(links, transforms(arm, joints), strict=True):
                bullets = pose_of_link(body, of_link[link], client)
                np.testing.assert_allclose(base @ ours, bullets, atol=2e-6)  # it answers in single precision
                assert np.linalg.norm(ours[:3, 3] - arm_shoulder(arm, joints)) <= arm.farthest_reach_m + 1e-12


def arm_shoulder(arm: ArmModel, joints: np.ndarray) -> np.ndarray:
    return transforms(arm, joints)[1][:3, 3]


@pytest.mark.parametrize("name", ARMS)
def test_the_shipped_arms_have_the_numbers_that_they_had_bit_for_bit(name: str) -> None:
    """As they were read when there were six joints and a flange, and nothing else."""
    robot = ElementTree.parse(urdf_file(name)).getroot()
    below = {joint.find("parent").attrib["link"]: joint for joint in robot.findall("joint")}  # type: ignore[union-attr]
    below |= {  # of several below a link that of the arm
        joint.find("parent").attrib["link"]: joint  # type: ignore[union-attr]
        for joint in robot.findall("joint")
        if joint.get("type") == "revolute" or joint.find("child").attrib["link"] == "tool0"  # type: ignore[union-attr]
    }
    joints, link = [], "base_link"
    while link != "tool0":
        joints.append(below[link])
        link = joints[-1].find("child").attrib["link"]  # type: ignore[union-attr]
    assert [joint.get("type") for joint in joints] == ["revolute"] * 6 + ["fixed"]
    arm, read = load_arm(name), read_arm(urdf_file(name), base="base_link", tcp="tool0", packages=PACKAGES)
    axes = np.array([numbers(joint, "axis", "xyz") for joint in joints[:6]])
    limits = [joint.find("limit").attrib for joint in joints[:6]]  # type: ignore[union-attr]
    for one in (arm, read):
        assert one.joint_origins.tobytes() == np.array([origin(joint) for joint in joints[:6]]).tobytes()
        assert one.flange.tobytes() == origin(joints[6]).tobytes()
        assert one.joint_axes.tobytes() == (axes / np.linalg.norm(axes, axis=1, keepdims=True)).tobytes()
        assert one.position_lower_rad.tolist() == [float(limit["lower"]) for limit in limits]
        assert one.position_upper_rad.tolist() == [float(limit["upper"]) for limit in limits]
        assert one.velocity_limit_radps.tolist() == [float(limit["velocity"]) for limit in limits]
        assert one.effort_limit.tolist() == [float(limit["effort"]) for limit in limits]
        assert one.name == robot.get("name")
        assert one.chain["joint_origins"].tobytes() == one.joint_origins.tobytes()


def numbers(element: ElementTree.Element, tag: str, key: str) -> list[float]:
    return [float(word) for word in element.find(tag).attrib[key].split()]  # type: ignore[union-attr]


def origin(joint: ElementTree.Element) -> np.ndarray:
    frame, turn = np.eye(4), np.empty((3, 3))
    for axis, angle in zip(np.eye(3), numbers(joint, "origin", "rpy"), strict=True):
        rotation_about(axis, angle, turn)
        frame[:3, :3] = turn @ frame[:3, :3]
    frame[:3, 3] = numbers(joint, "origin", "xyz")
    return frame


def test_the_closed_form_of_six_joints_is_given_no_arm_of_seven() -> None:
    with pytest.raises(ArmModelError, match="panda: the closed form is of six joints, not 7"):
        arm_geometry(arm_named("panda"))


def test_a_panda_is_seven_joints_its_hand_and_no_fingers() -> None:
    arm = arm_named("panda")
    assert arm.joint_axes.shape == (7, 3)
    assert arm.joint_names == tuple(f"panda_joint{i}" for i in range(1, 8))
    assert arm.left_out == ("panda_leftfinger", "panda_rightfinger")
    last = arm.links[7]
    assert [Path(shape.uri).name for shape in last.collision] == ["link7.obj", "hand.obj"]
    np.testing.assert_allclose(last.collision[1].transform_shape_to_link[:3, 3], [0.0, 0.0, 0.107])
