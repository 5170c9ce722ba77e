"""A hand that follows the TCP is told where the TCP is, on every axis, by either world."""

from __future__ import annotations

import numpy as np
import pytest
from examples import ConstantSpeed, hand, run, scenario

from safety_harness.admission.admit import admit
from safety_harness.cell.controller.records import COMMAND
from safety_harness.cell.simulation.kinematic_world import KinematicWorld
from safety_harness.scenario.moves import FollowTcp
from safety_harness.trace.records import TICK

RATES = (0.06, -0.05, 0.08, 0.0, 0.0, 0.0)
DISTANCE_M, SPEED_MPS = 0.15, 1.5
WHAT = scenario(hand(FollowTcp(speed_mps=SPEED_MPS, distance_m=DISTANCE_M, duration_s=2.0)), duration_s=2.0)


def last_ticks_in_pybullet() -> np.ndarray:
    return run(WHAT, controller=ConstantSpeed(RATES)).ticks[-20:]


def last_ticks_in_the_kinematic_world() -> np.ndarray:
    admitted = admit(WHAT)
    world = KinematicWorld(WHAT, admitted.arm, admitted.joint_position_rad)
    command, ticks = np.zeros(1, COMMAND), np.zeros(250, TICK)
    command["joint_velocity_radps"] = RATES
    for k in range(len(ticks)):
        world.true_state(ticks[k : k + 1])
        world.step(command)
    return ticks[-20:]


@pytest.mark.parametrize("last_ticks", [last_ticks_in_pybullet, last_ticks_in_the_kinematic_world])
def test_a_hand_that_follows_keeps_its_distance_from_a_tcp_that_moves(last_ticks: object) -> None:
    ticks = last_ticks()  # type: ignore[operator]
    tcp = ticks["transform_tcp_to_base"][:, :3, 3]
    assert (np.abs(tcp[-1] - tcp[0]) > 0.002).all()  # on every axis
    away = np.linalg.norm(ticks["hand_position_in_base_m"][:, 0] - tcp, axis=1)
    # the TCP moves on for a tick after the hand has looked
    assert away == pytest.approx(np.full(len(away), DISTANCE_M), abs=0.003)
