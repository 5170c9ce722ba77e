"""The smaller arms in their own cells: the world, the controller and the judges all mean the same arm."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples import ConstantSpeed, run

from safety_harness import judge, load_trace, read_scenario, run_trial, save_trace
from safety_harness.admission.admit import admit
from safety_harness.base.exceptions import InadmissibleError, ModelError, TraceError
from safety_harness.base.settings import DEFAULTS
from safety_harness.cell.controller.records import COMMAND
from safety_harness.cell.robot.capsules import load_capsules
from safety_harness.cell.robot.description import load_arm
from safety_harness.cell.simulation.pybullet_world import PyBulletWorld
from safety_harness.claims.properties.limits import JointSpeedLimits
from safety_harness.claims.properties.positions import RepulsivePosesReachable
from safety_harness.scenario.model import JointStart, OffsetStart, Scenario, Verdict
from safety_harness.scenario.robots import Robot
from safety_harness.trace.compare import first_difference
from safety_harness.trace.records import TICK
from tests.cell.robot.arms import pose_in_the_engine

FOLDER = Path(__file__).parents[3] / "scenarios"
OTHERS = (Robot.UR5, Robot.UR3)


def shipped(robot: Robot, duration_s: float = 3.0) -> Scenario:
    return replace(read_scenario(FOLDER / f"robot-{robot.arm_name}.yaml"), duration_s=duration_s)


@pytest.mark.parametrize("robot", OTHERS)
def test_controller_gate_and_world_have_the_scenarios_arm(robot: Robot) -> None:
    admitted = admit(shipped(robot))
    gate = admitted.controller().gate
    assert admitted.arm is load_arm(robot.arm_name) is gate.kinematics.arm
    assert gate.capsules is load_capsules(robot.arm_name)


@pytest.mark.parametrize("robot", OTHERS)
def test_the_pose_of_the_trace_is_the_engines_own(robot: Robot) -> None:
    admitted = admit(shipped(robot))
    command, tick = np.zeros(1, COMMAND), np.zeros(1, TICK)
    command["joint_velocity_radps"] = (0.5, -0.3, 0.2, 0.4, -0.6, 0.7)
    with PyBulletWorld(admitted.scenario, admitted.arm, admitted.joint_position_rad) as world:
        for _ in range(60):
            world.step(command)
        expected = pose_in_the_engine("tool0")
        world.true_state(tick)
    assert tick[0]["transform_tcp_to_base"][:3, 3] == pytest.approx(expected[:3, 3], abs=1e-6)


@pytest.mark.parametrize("robot", OTHERS)
def test_the_arm_stands_still_when_told_to_and_moves_as_told(robot: Robot) -> None:
    rates = (0.3, -0.2, 0.15, 0.4, -0.3, 0.5)
    still, moving = (
        run(shipped(robot, 1.0), controller=ConstantSpeed(told)).ticks["joint_velocity_radps"]
        for told in ((0.0,) * 6, rates)
    )
    assert np.abs(still).max() < 1e-6
    assert moving[1:] == pytest.approx(np.tile(rates, (125, 1)), abs=1e-5)


@pytest.mark.parametrize(
    ("robot", "reach"), [(Robot.UR5, (0.06, 0.15, 0.1)), (Robot.UR3, (0.03, 0.08, 0.05))]
)
def test_all_starts_of_its_workspace_are_admitted(robot: Robot, reach: tuple[float, float, float]) -> None:
    rng = np.random.default_rng(5)
    corners = [np.array([x, y, z]) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    for where in corners + [rng.uniform(-1, 1, 3) for _ in range(20)]:
        x, y, z = where * reach
        admit(replace(shipped(robot), start=OffsetStart(offset_in_base_m=(x, y, z))))


@pytest.mark.parametrize("robot", OTHERS)
def test_a_learned_avoider_of_the_ur10s_cell_is_refused_in_its_cell(robot: Robot) -> None:
    with pytest.raises(ModelError, match="another workspace"):
        admit(replace(shipped(robot), avoider="mc-dropout"))


def test_the_default_cell_is_out_of_a_ur3s_reach() -> None:
    with pytest.raises(InadmissibleError, match="no inverse kinematics") as caught:
        admit(replace(shipped(Robot.UR3), settings=DEFAULTS))
    assert caught.value.place.field == "settings.cell.desired tcp position"


def test_joint_limits_are_those_of_the_arm() -> None:
    slow = JointStart(joint_position_rad=(0.0, -1.3, 3.2, -2.2, -1.57, 0.0))
    with pytest.raises(InadmissibleError, match="elbow_joint between -180 and 180"):
        admit(replace(shipped(Robot.UR5), start=slow))
    trace = run_trial(admit(shipped(Robot.UR5, 0.5)))
    speed = np.abs(trace.ticks["joint_velocity_radps"])
    for robot in (Robot.UR5, Robot.UR10):  # 180 and 124 deg/s at shoulder and lift
        judged = JointSpeedLimits().evaluate(replace(trace, scenario=replace(trace.scenario, robot=robot)))
        left = load_arm(robot.arm_name).velocity_limit_radps - speed
        assert judged.margin == pytest.approx(left.min(), abs=1e-3)
    assert load_arm("ur5").velocity_limit_radps[0] > load_arm("ur10").velocity_limit_radps[0] + 0.9


def test_a_trace_is_judged_with_the_arm_that_made_it() -> None:
    trace = run_trial(admit(shipped(Robot.UR5, 2.6)))
    assert len(trace.decisions) == 1
    assert len(judge(trace)) == len(trace.scenario.claims)
    other = replace(trace, scenario=replace(trace.scenario, robot=Robot.UR10))
    with pytest.raises(TraceError, match="transform_tcp_to_base"):
        judge(other)
    decisions = trace.decisions.copy()
    decisions["chosen_position_in_base_m"][0] += (0.45, 0.0, 0.0)  # as far as no UR5 reaches
    reachable = RepulsivePosesReachable(proposed=False)
    far, as_ur10 = (reachable.evaluate(replace(each, decisions=decisions)) for each in (trace, other))
    assert far.verdict is Verdict.VIOLATED
    assert far.margin != as_ur10.margin


def test_a_stored_trace_keeps_its_robot_and_its_faults_and_repeats(tmp_path: Path) -> None:
    what = read_scenario(FOLDER / "fault-avoider-never-answers.yaml")
    what = replace(what, duration_s=3.0)
    trace = run_trial(admit(what))
    save_trace(trace, tmp_path / "a.trace")
    stored = load_trace(tmp_path / "a.trace")
    assert stored.scenario.faults == what.faults != ()
    assert stored.ticks["faults"].any()
    assert first_difference(stored, run_trial(admit(stored.scenario), recorded=stored)) is None
    small = run_trial(admit(shipped(Robot.UR3, 0.1)))
    save_trace(small, tmp_path / "b.trace")
    assert load_trace(tmp_path / "b.trace").scenario.robot is Robot.UR3
