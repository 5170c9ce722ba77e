"""Own arms in both worlds, where they are seated, and their traces where their files are not."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from safety_harness import judge, load_trace, read_scenario, run_trial, save_trace
from safety_harness.admission.admit import admit
from safety_harness.base.shipped.contents import located
from safety_harness.cell.robot.robots import arm_model, transform_seat
from safety_harness.cell.simulation.cell import load_robot
from safety_harness.cell.simulation.engine import pybullet
from safety_harness.cell.simulation.worlds import KINEMATIC, PYBULLET
from safety_harness.scenario.model import Scenario
from safety_harness.scenario.robots import OwnRobot, Seat
from safety_harness.trace.trace import Trace


def shipped(name: str) -> Scenario:
    return replace(read_scenario(located(f"shipped:robot-{name}")), duration_s=4.0)


def in_both_worlds(name: str) -> dict[str, Trace]:
    admitted = admit(shipped(name))
    return {world.name: run_trial(admitted, world=world) for world in (PYBULLET, KINEMATIC)}


@pytest.fixture(scope="module")
def panda() -> dict[str, Trace]:
    return in_both_worlds("panda")


def test_seven_joints_give_way_alike_in_both_worlds(panda: dict[str, Trace]) -> None:
    one, other = (panda[world.name].ticks for world in (PYBULLET, KINEMATIC))
    assert len(np.unique(one["mode"])) > 1
    np.testing.assert_array_equal(one["mode"], other["mode"])
    np.testing.assert_allclose(one["joint_position_rad"], other["joint_position_rad"], atol=5e-4)


def test_a_trace_is_judged_where_the_arms_files_are_not(tmp_path: Path) -> None:
    folder, mine = tmp_path / "there", tmp_path / "there" / "robot-ur10e.yaml"
    shutil.copytree(located("shipped:scenarios"), folder, ignore=shutil.ignore_patterns("rec*", "spaces"))
    shutil.copytree(located("shipped:robots"), folder / "robots")
    mine.write_text(mine.read_text().replace("shipped:ur10e", "robots/ur10e.yaml"))
    scenario = replace(read_scenario(mine), duration_s=3.0)
    trace = run_trial(admit(scenario), world=KINEMATIC)
    save_trace(trace, tmp_path / "trace.zip")
    expected = [(one.verdict, one.margin) for one in judge(trace)]
    arm_model.cache_clear()
    shutil.rmtree(folder)
    again = load_trace(tmp_path / "trace.zip")
    assert again.scenario.robot == scenario.robot
    assert [(one.verdict, one.margin) for one in judge(again)] == expected


@pytest.mark.parametrize("tilt", [(np.pi, 0.0, 0.0), (0.0, np.pi / 2, 0.0)])
def test_an_arm_on_ceiling_or_wall_stands_in_the_engine_where_kinematics_have_it(
    tilt: tuple[float, float, float],
) -> None:
    robot = shipped("iiwa14").robot
    assert isinstance(robot, OwnRobot)
    seat = Seat(position_in_base_m=(0.2, 0.1, 1.4), yaw_rad=0.5, tilt_rad=tilt)
    arm = arm_model(replace(robot, seat=seat))
    np.testing.assert_array_equal(arm.transform_seat, transform_seat(seat))
    client = pybullet.connect(pybullet.DIRECT)
    try:
        body, joints = load_robot(client, arm, visuals=False)
        for i, joint in enumerate(joints):
            pybullet.resetJointState(body, joint, 0.1 * (i + 1), physicsClientId=client)
        state = pybullet.getLinkState(body, joints[0], computeForwardKinematics=True, physicsClientId=client)
        np.testing.assert_allclose(state[4], arm.joint_origins[0][:3, 3], atol=1e-6)
        position, turn = pybullet.getBasePositionAndOrientation(body, physicsClientId=client)
        inertial = pybullet.getDynamicsInfo(body, -1, physicsClientId=client)[3]
        np.testing.assert_allclose(
            position, seat.position_in_base_m + arm.transform_seat[:3, :3] @ inertial, atol=1e-6
        )
        matrix = np.reshape(pybullet.getMatrixFromQuaternion(turn), (3, 3))
        np.testing.assert_allclose(matrix, arm.transform_seat[:3, :3], atol=1e-6)
    finally:
        pybullet.disconnect(client)


def test_gravity_pulls_at_a_hanging_arm_and_its_drives_hold_it() -> None:
    scenario = shipped("iiwa14")
    assert isinstance(scenario.robot, OwnRobot)
    settings = scenario.settings
    preferred = tuple(np.radians([0.0, 20.0, 0.0, -80.0, 0.0, -90.0, 0.0]))
    hanging = replace(
        scenario,
        robot=replace(scenario.robot, seat=Seat(position_in_base_m=(0.0, 0.0, 1.3), tilt_rad=(np.pi, 0, 0))),
        hands=(),
        duration_s=0.5,
        settings=replace(settings, cell=replace(settings.cell, preferred_joint_position_rad=preferred)),
    )
    runs = [run_trial(admit(hanging), world=world) for world in (PYBULLET, KINEMATIC)]
    one, other = (run.ticks["joint_position_rad"] for run in runs)
    assert np.abs(one[-1] - one[0]).max() > 0.001
    np.testing.assert_allclose(one, other, atol=1e-4)
