"""Where an own arm is seated, and what a tool and a part add to it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from safety_harness.base.shipped.contents import located
from safety_harness.cell.robot.capsules import CapsuleSet
from safety_harness.cell.robot.description import ArmModel
from safety_harness.cell.robot.distance import place_capsules
from safety_harness.cell.robot.kinematics import forward_kinematics
from safety_harness.cell.robot.robots import arm_capsules, arm_model
from safety_harness.scenario.read import read_scenario
from safety_harness.scenario.robots import OwnRobot, Piece, Seat, Tool

JOINTS = np.radians([20.0, 40.0, -30.0, -95.0, 10.0, 45.0, 5.0])
CEILING = Seat(position_in_base_m=(0.3, -0.2, 1.5), yaw_rad=0.7, tilt_rad=(np.pi, 0.0, 0.0))
PIECE = Piece(start_m=(0.0, 0.01, 0.02), end_m=(0.0, 0.0, 0.1), radius_m=0.03)
TOOL = Tool(position_m=(0.02, 0.0, 0.15), tilt_rad=(0.0, 0.4, 0.0), pieces=(PIECE,))


@pytest.fixture(scope="module")
def bare() -> OwnRobot:
    robot = read_scenario(located("shipped:robot-iiwa14")).robot
    assert isinstance(robot, OwnRobot)
    return replace(robot, tool=None)


def transforms(arm: ArmModel) -> np.ndarray:
    found = np.empty((len(JOINTS) + 2, 4, 4))
    forward_kinematics(arm.chain[0], JOINTS, found)
    return found


def bodies(arm: ArmModel, capsules: CapsuleSet) -> dict[str, np.ndarray]:
    """The ends of every capsule in the base frame (2, 3)."""
    ends = np.empty((len(capsules.names), 2, 3))
    place_capsules(capsules.records, transforms(arm), ends)
    return dict(zip(capsules.names, ends, strict=True))


def test_a_seat_moves_tcp_links_and_base_as_one_body(bare: OwnRobot) -> None:
    seated = replace(bare, seat=CEILING)
    turn = Rotation.from_euler("z", 0.7) * Rotation.from_rotvec([np.pi, 0.0, 0.0])
    here, there = transforms(arm_model(bare)), transforms(arm_model(seated))
    moved = turn.apply(here[1:, :3, 3]) + CEILING.position_in_base_m
    np.testing.assert_allclose(there[1:, :3, 3], moved, atol=1e-12)
    np.testing.assert_allclose(there[-1, :3, :3], turn.as_matrix() @ here[-1, :3, :3], atol=1e-12)
    before, after = (bodies(arm_model(one), arm_capsules(one)) for one in (bare, seated))
    for name, ends in before.items():
        np.testing.assert_allclose(after[name], turn.apply(ends) + CEILING.position_in_base_m, atol=1e-12)


def test_a_tool_moves_the_tcp_and_its_capsules_stay_on_the_link(bare: OwnRobot) -> None:
    tooled = replace(bare, tool=TOOL)
    link, tcp = transforms(arm_model(bare))[-1], transforms(arm_model(tooled))[-1]
    np.testing.assert_allclose(tcp[:3, 3], link[:3, :3] @ TOOL.position_m + link[:3, 3], atol=1e-12)
    np.testing.assert_allclose(
        tcp[:3, :3], link[:3, :3] @ Rotation.from_rotvec(TOOL.tilt_rad).as_matrix(), atol=1e-12
    )
    before = bodies(arm_model(bare), arm_capsules(bare))
    after = bodies(arm_model(tooled), arm_capsules(tooled))
    assert set(after) - set(before) == {"tool 1"}
    for name, ends in before.items():
        np.testing.assert_allclose(after[name], ends, atol=1e-12)
    expected = np.array([PIECE.start_m, PIECE.end_m]) @ link[:3, :3].T + link[:3, 3]
    np.testing.assert_allclose(after["tool 1"], expected, atol=1e-12)


def test_a_carried_part_moves_with_the_tcp(bare: OwnRobot) -> None:
    carrying = replace(bare, tool=TOOL, part=(PIECE,))
    tcp = transforms(arm_model(carrying))[-1]
    expected = np.array([PIECE.start_m, PIECE.end_m]) @ tcp[:3, :3].T + tcp[:3, 3]
    np.testing.assert_allclose(bodies(arm_model(carrying), arm_capsules(carrying))["part 1"], expected)
