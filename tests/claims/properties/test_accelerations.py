"""Accelerations are the differences of true velocities, and a jerk is seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from examples import ConstantSpeed, run, scenario

from safety_harness.cell.robot.description import load_arm
from safety_harness.cell.robot.kinematics import forward_kinematics
from safety_harness.claims.properties.base import Property
from safety_harness.claims.properties.limits import (
    JointAccelerations,
    TcpAcceleration,
)
from safety_harness.scenario.model import Verdict
from safety_harness.trace.trace import Trace

JOINTS = JointAccelerations(maximum_radps2=np.radians(500.0))
TCP = TcpAcceleration(maximum_mps2=2.0)


def jumping(at: int, joint: int) -> Trace:
    """A visit whose drives report another speed of one joint at one tick."""
    trace = run(scenario(duration_s=1.0))
    ticks = trace.ticks.copy()
    ticks["joint_velocity_radps"][at, joint] += 0.7
    return replace(trace, ticks=ticks)


def tcp_m(joints_rad: np.ndarray) -> np.ndarray:
    arm, links = load_arm(), np.empty((8, 4, 4))
    forward_kinematics(arm.chain[0], joints_rad, links)
    return links[7, :3, 3].copy()


@pytest.mark.parametrize("trace", ["visit", (40, 0), (0, 5), (125, 2)], ids=str)
def test_the_hardest_tick_is_the_hardest_of_all(
    trace: str | tuple[int, int], request: pytest.FixtureRequest
) -> None:
    """Most ticks are passed over: against the velocity at every tick, by differences of true poses."""
    of = request.getfixturevalue(trace) if isinstance(trace, str) else jumping(*trace)
    step_s, rows = 1e-6, zip(of.ticks["joint_position_rad"], of.ticks["joint_velocity_radps"], strict=True)
    velocity = np.array([tcp_m(q + step_s * v) - tcp_m(q - step_s * v) for q, v in rows]) / (2.0 * step_s)
    size = np.linalg.norm(np.diff(velocity, axis=0), axis=1) / 0.008
    found = TCP.evaluate(of)
    assert found.margin == pytest.approx(2.0 - size.max(), abs=1e-6)
    assert size[of.time_s[:-1] == found.worst_time_s] == pytest.approx(size.max(), abs=1e-6)
    assert size.max() > 2.0 * np.median(size)  # there was something to pass over


def test_the_acceleration_that_the_settings_allow_is_the_one_that_is_found(visit: Trace) -> None:
    evaluation = TCP.evaluate(visit)
    assert visit.scenario.settings.motion.max_tcp_acceleration_mps2 == 1.0
    assert (evaluation.verdict, evaluation.margin) == (Verdict.HOLDS, pytest.approx(1.0, abs=0.02))


def test_a_jerk_of_one_joint_has_its_size_time_and_name(visit: Trace) -> None:
    ticks = visit.ticks.copy()
    quiet = ticks["joint_velocity_radps"]
    quiet[:] = 0.0
    quiet[41:, 3] = -0.1
    evaluation = JOINTS.evaluate(replace(visit, ticks=ticks))
    assert evaluation.margin == pytest.approx(np.radians(500.0) - 0.1 / 0.008)
    assert (evaluation.verdict, evaluation.worst_time_s) == (Verdict.VIOLATED, visit.time_s[40])
    assert evaluation.reason.startswith("wrist_1_joint 716 deg/s2")


def test_a_controller_that_jumps_to_a_speed_violates_both() -> None:
    jumps = run(scenario(duration_s=0.2), controller=ConstantSpeed((1.0, 0.0, 0.0, 0.0, 0.0, 0.0)))
    for prop in (JOINTS, TCP):
        assert prop.evaluate(jumps).verdict is Verdict.VIOLATED


@pytest.mark.parametrize("prop", [JOINTS, TCP], ids=lambda prop: prop.sentence)
def test_an_arm_that_stands_still_is_no_evidence(prop: Property) -> None:
    evaluation = prop.evaluate(run(scenario(duration_s=0.2), controller=ConstantSpeed((0.0,) * 6)))
    assert (evaluation.verdict, evaluation.exercised) == (Verdict.INCONCLUSIVE, 0)


@pytest.mark.parametrize("prop", [JOINTS, TCP], ids=lambda prop: prop.sentence)
def test_one_tick_has_no_acceleration(prop: Property, visit: Trace) -> None:
    one = replace(
        visit,
        ticks=visit.ticks[:1].copy(),
        decisions=visit.decisions[:0].copy(),
        decision_latency_s=np.zeros(0),
        ended="interrupted",
    )
    assert prop.evaluate(one).verdict is Verdict.INCONCLUSIVE
