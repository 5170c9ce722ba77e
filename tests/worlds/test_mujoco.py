"""The world MuJoCo beside the kinematic world and PyBullet, and beside equations of motion that are ours."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from examples import VISIT, scenario

from safety_harness.admission.admit import Admitted, admit
from safety_harness.admission.trial import run_trial
from safety_harness.base.exceptions import InadmissibleError, SimulationError
from safety_harness.base.extras import PYBULLET as PYBULLET_EXTRA
from safety_harness.cell.controller.records import command_dtype
from safety_harness.cell.robot.dynamics import holding_torques, link_masses
from safety_harness.cell.simulation.worlds import KINEMATIC, PYBULLET, WorldEntry, references, world_named
from safety_harness.extensions.worlds.mujoco_entry import MUJOCO
from safety_harness.extensions.worlds.mujoco_model import PREFIX, cell_model
from safety_harness.extensions.worlds.mujoco_world import MujocoWorld, saturated_torques
from safety_harness.scenario.read import read_scenario
from safety_harness.trace.trace import Trace

ARMS = ("first-run", "robot-iiwa14", "robot-panda", "robot-ur3", "robot-ur10e", "robot-xarm6")
FEW_S = 1.5


def shipped(name: str) -> Admitted:
    """Return the beginning of a shipped scenario."""
    return admit(replace(read_scenario(f"shipped:{name}"), duration_s=FEW_S, claims=()))


def visit() -> Admitted:
    return admit(replace(scenario(VISIT), duration_s=FEW_S))


def weakened(admitted: Admitted, factor: float) -> Admitted:
    """Return the same run with motors of less torque, of which neither admission nor the servo knows."""
    arm = replace(admitted.arm, effort_limit=factor * admitted.arm.effort_limit)
    return replace(admitted, arm=arm)


def joints(trace: Trace) -> np.ndarray:
    return np.asarray(trace.ticks["joint_position_rad"])


def apart_rad(first: Trace, second: Trace) -> float:
    return float(np.abs(joints(first) - joints(second)).max())


@pytest.mark.parametrize("name", ARMS)
def test_an_arm_with_strong_motors_moves_as_in_the_kinematic_world(name: str) -> None:
    run = shipped(name)
    in_mujoco = run_trial(run, world=MUJOCO)
    assert apart_rad(in_mujoco, run_trial(run, world=KINEMATIC)) < 1e-12
    assert not in_mujoco.overshoot_radps.any()


def test_two_engines_saturate_weak_motors_alike_where_the_arm_just_holds_itself() -> None:
    run = weakened(visit(), 0.22)
    in_mujoco, in_pybullet = (run_trial(run, world=world) for world in (MUJOCO, PYBULLET))
    assert apart_rad(in_mujoco, run_trial(run, world=KINEMATIC)) > 1e-4
    assert apart_rad(in_mujoco, in_pybullet) < 3e-5
    assert in_mujoco.overshoot_radps.max() == pytest.approx(in_pybullet.overshoot_radps.max(), rel=0.1)


@pytest.mark.parametrize("share", [0.2, 0.18])
def test_two_engines_let_an_arm_that_cannot_hold_itself_sink_alike(share: float) -> None:
    run = weakened(visit(), share)
    in_mujoco, in_pybullet = (run_trial(run, world=world) for world in (MUJOCO, PYBULLET))
    assert apart_rad(in_mujoco, run_trial(run, world=KINEMATIC)) > 0.1
    assert apart_rad(in_mujoco, in_pybullet) < 1e-2


@pytest.mark.parametrize("joints", [1, 3, 6, 8])
def test_a_saturated_motor_never_turns_its_joint_beyond_its_need(joints: int) -> None:
    rng = np.random.default_rng(joints)
    seen = set()
    for _ in range(200):
        root = rng.normal(size=(joints, joints))
        mass = root @ root.T + 0.1 * np.eye(joints)
        other_nm, need_radps2 = rng.normal(size=(2, joints)) * 10.0
        limit_nm = rng.uniform(0.1, 15.0, joints)
        torques_nm = saturated_torques(mass, other_nm, need_radps2, limit_nm)
        beyond_radps2 = np.linalg.solve(mass, torques_nm - other_nm) - need_radps2
        at_end = np.where(np.abs(torques_nm) == limit_nm, np.sign(torques_nm), 0.0)
        assert (np.abs(torques_nm) <= limit_nm).all()
        np.testing.assert_allclose(beyond_radps2[at_end == 0.0], 0.0, atol=1e-6)
        assert (at_end * beyond_radps2 <= 1e-6).all()
        seen |= set(at_end)
    assert seen == {-1.0, 0.0, 1.0}


def test_gravity_and_masses_are_those_of_our_equations() -> None:
    run = visit()
    model = cell_model(run.arm, -0.3, 0.002)
    data = mujoco.MjData(model)
    own = [model.joint(PREFIX + name) for name in run.arm.joint_names]
    rng = np.random.default_rng(7)
    for _ in range(20):
        pose_rad = rng.uniform(-1.5, 1.5, len(own))
        data.qpos[[joint.qposadr[0] for joint in own]] = pose_rad
        mujoco.mj_forward(model, data)
        ours = holding_torques(run.arm, link_masses(run.arm), pose_rad)
        theirs = data.qfrc_bias[[joint.dofadr[0] for joint in own]]
        np.testing.assert_allclose(theirs, ours, atol=1e-9)


def test_a_saturated_motor_gives_its_limit_and_the_others_hold_their_speeds() -> None:
    run = weakened(visit(), 0.2)
    command = np.zeros(1, command_dtype())
    with MujocoWorld(run.scenario, run.arm, run.joint_position_rad) as world:
        for _ in range(40):
            world.step(command)
        torques_nm, weak = world._data.qfrc_applied, world._limit_nm
        at_limit = np.isclose(np.abs(torques_nm), weak, rtol=1e-12)
        assert at_limit.any()
        assert not (np.abs(torques_nm) > weak * (1.0 + 1e-12)).any()
        np.testing.assert_allclose(world._data.qvel[~at_limit], 0.0, atol=1e-9)
        assert world.saturated > 0


def test_an_arm_that_falls_onto_the_table_stops_there() -> None:
    run = weakened(visit(), 1e-3)
    command = np.zeros(1, command_dtype())
    with MujocoWorld(run.scenario, run.arm, run.joint_position_rad) as world:
        for _ in range(run.scenario.ticks):
            world.step(command)
        assert world.contacts > 0
        depth_m = [-world._data.contact[k].dist for k in range(world._data.ncon)]
        assert max(depth_m) < 2e-3


def test_a_run_repeats_to_the_last_bit() -> None:
    run = weakened(visit(), 0.25)
    assert joints(run_trial(run, world=MUJOCO)).tobytes() == joints(run_trial(run, world=MUJOCO)).tobytes()


def test_rendered_images_are_refused() -> None:
    rendered = admit(read_scenario("shipped:rendered-images"))
    with pytest.raises(InadmissibleError, match="no renderer"):
        run_trial(rendered, world=MUJOCO)


def test_a_urdf_that_mujoco_cannot_use_is_an_error_of_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    run = visit()
    monkeypatch.setattr(
        "safety_harness.extensions.worlds.mujoco_model._urdf", lambda arm: "<robot><joint/></robot>"
    )
    with pytest.raises(SimulationError, match="MuJoCo cannot use"):
        cell_model(replace(run.arm), -0.3, 0.002)


def test_it_is_found_by_its_label_and_confirms_after_pybullet() -> None:
    assert world_named("mujoco", "--world") is MUJOCO
    there: list[WorldEntry] = list(references())
    assert there == ([PYBULLET, MUJOCO] if PYBULLET.is_installed else [MUJOCO])
    assert not MUJOCO.model_only


def test_the_hint_for_pybullet_names_it() -> None:
    assert "mujoco" in PYBULLET_EXTRA.hint.lower()
