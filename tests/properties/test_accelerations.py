"""Accelerations are the differences of true velocities, and a jerk is seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from examples import ConstantSpeed, run, scenario

from safety_harness.properties.accelerations import (
    JointAccelerations,
    TcpAcceleration,
    tcp_velocity_in_base_mps,
)
from safety_harness.properties.base import Property
from safety_harness.scenario.model import Verdict
from safety_harness.trace.trace import Trace

JOINTS = JointAccelerations(maximum_radps2=np.radians(500.0))
TCP = TcpAcceleration(maximum_mps2=2.0)


def test_the_tcp_s_velocity_is_that_of_its_positions(visit: Trace) -> None:
    """By differences over two ticks, where no acceleration is above 1 m/s2: at most that times a tick."""
    positions = visit.ticks["transform_tcp_to_base"][:, :3, 3]
    period_s = visit.scenario.settings.clock.control_period_s
    central = (positions[2:] - positions[:-2]) / (2.0 * period_s)
    velocity = tcp_velocity_in_base_mps(visit)
    assert np.abs(velocity[1:-1] - central).max() < 1.05 * period_s
    assert np.linalg.norm(velocity, axis=1) == pytest.approx(visit.ticks["tcp_speed_mps"], abs=1e-12)


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
