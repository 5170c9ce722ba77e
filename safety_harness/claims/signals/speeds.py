"""Compute the speeds of the TCP and the joints, and their displacements from tick to tick."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import compiled
from safety_harness.cell.robot.capsules import Arm
from safety_harness.cell.robot.distance import place_capsules
from safety_harness.cell.robot.kinematics import fastest_end, forward_kinematics, link_twists, tcp_velocity
from safety_harness.cell.simulation.worlds import entry_of
from safety_harness.claims.signals.bounds import speed_cells
from safety_harness.claims.signals.occasions import MOVES
from safety_harness.claims.signals.signal import Sampled, Values
from safety_harness.claims.signals.true_motion import arm_of, true_motion
from safety_harness.trace.trace import Trace, history, once_a_trace


def speeds(at_tick: Values, mean: Values, *, moving_part: str) -> Sampled:
    """Return the signal for the fastest of several speeds.

    Its bounds between the ticks come from ``speed_cells``. A run exercises the signal at each tick after
    which ``moving_part`` moves. ``at_tick`` (n, joints) has the speeds at the ticks, and ``mean`` (n-1,
    joints) has the mean speeds between them.
    """
    value, low, high, mean = speed_cells(at_tick, mean)
    moves = value - MOVES
    moves[:-1] = np.fmax(moves[:-1], mean - MOVES)
    return Sampled(
        value=value, low=low, high=high, tried=(moves, moves), untried=f"{moving_part} never moves"
    )


@once_a_trace
def tcp_steps_m(trace: Trace) -> Values:
    """Return the distance [m] between the TCP's positions at successive ticks, shape (n-1,)."""
    steps = np.diff(np.ascontiguousarray(true_motion(trace).tcp_m.T))
    return np.asarray(np.sqrt((steps * steps).sum(axis=0)))


def tcp_way_m(trace: Trace) -> Values:
    """Return how far [m] the TCP may move between ticks, shape (n-1,).

    The speed of the TCP is assumed to be the greatest of three speeds: those at the two ticks, and the mean
    speed between them.
    """
    speed = trace.ticks["tcp_speed_mps"]
    steps = tcp_steps_m(trace)
    path_m: Values = np.maximum(np.maximum(speed[:-1], speed[1:]) * np.diff(trace.time_s), steps)
    return path_m


def turned_rad(trace: Trace) -> Values:
    """Return the angle [rad] by which the TCP can turn between ticks, shape (n-1,).

    It is the sum of the angles of all joints.
    """
    speed = np.abs(trace.ticks["joint_velocity_radps"])
    steps = np.abs(np.diff(trace.ticks["joint_position_rad"], axis=0))
    most = np.maximum(np.maximum(speed[:-1], speed[1:]) * np.diff(trace.time_s)[:, None], steps)
    turned: Values = most.sum(axis=1)
    return turned


def known_to_radps(trace: Trace) -> float:
    """Return by how much [rad/s] recorded and commanded joint speeds may differ in the trace's world."""
    world = entry_of(trace.provenance.world)
    return 0.0 if world is None else world.known_to_radps


def tcp_speeds_mps(trace: Trace) -> tuple[Values, Values]:
    """Return the TCP's speed [m/s] at the ticks (n,) and its mean speed between the ticks (n-1,)."""
    return history(trace, "tcp_speed_mps"), tcp_steps_m(trace) / np.diff(trace.time_s)


def joint_speeds_radps(trace: Trace) -> tuple[Values, Values]:
    """Return the joints' speeds [rad/s] at the ticks and their mean speeds between the ticks.

    The first result has the shape (n, joints), and the second result has the shape (n-1, joints).
    """
    steps = np.abs(np.diff(history(trace, "joint_position_rad"), axis=0))
    return np.abs(history(trace, "joint_velocity_radps")), steps / np.diff(trace.time_s)[:, None]


def larger(at_tick: Values, mean: Values) -> Values:
    """Return for each tick the larger of its speed and the mean speed until the next tick.

    The result has the shape (n, ...). ``at_tick`` is (n, ...), and ``mean`` is (n-1, ...).
    """
    largest = at_tick.copy()
    largest[:-1] = np.maximum(largest[:-1], mean)
    return largest


def sample_tcp_speed(trace: Trace) -> Sampled:
    """Sample the TCP's speed.

    Between ticks, the bounds include the mean speed.
    """
    at_ticks, mean = tcp_speeds_mps(trace)
    return speeds(at_ticks[:, None], mean[:, None], moving_part="the TCP")


def sample_joint_speed(trace: Trace) -> Sampled:
    """Sample the fastest joint's speed.

    The lower bounds are reduced by ``known_to_radps``, because the commanded speed may be lower than the
    recorded speed by this amount.
    """
    sampled, off_radps = speeds(*joint_speeds_radps(trace), moving_part="the arm"), known_to_radps(trace)
    return replace(
        sampled, low=sampled.low - off_radps, value_low=sampled.value - off_radps, value_high=sampled.value
    )


@once_a_trace
def arm_speeds_mps(trace: Trace) -> Values:
    """Return an array (n, 4).

    It contains the speed of the fastest end of the capsules' axes, and the three components of the TCP's
    velocity. The velocity is in the base frame. No point of an axis is faster than the faster end of the
    axis.
    """
    true = true_motion(trace)
    return _arm_speeds_mps(arm_of(trace), true.joints_rad, true.rates_radps)


@compiled
def _arm_speeds_mps(
    arm: Arm,
    joints_rad: NDArray[np.float64],  # (n, joints)
    rates_radps: NDArray[np.float64],  # (n, joints)
) -> NDArray[np.float64]:
    """Return the result (n, 4) of ``arm_speeds_mps``."""
    n, joints, capsules = joints_rad.shape[0], arm.chain[0].joint_axes.shape[0], arm.capsules.shape[0]
    transforms, ends = np.empty((joints + 2, 4, 4)), np.empty((capsules, 2, 3))
    twists, speeds_mps = np.empty((joints + 1, 6)), np.zeros((n, 4))
    for k in range(n):
        forward_kinematics(arm.chain[0], joints_rad[k], transforms)
        place_capsules(arm.capsules, transforms, ends)
        link_twists(arm.chain[0].joint_axes, transforms, rates_radps[k], twists)
        x, y, z = tcp_velocity(arm.chain[0].joint_axes, transforms, rates_radps[k])
        speeds_mps[k, 1], speeds_mps[k, 2], speeds_mps[k, 3] = x, y, z
        for capsule in range(capsules):
            speed = fastest_end(twists[min(arm.capsules[capsule].link_index, joints)], ends[capsule])
            if not speed <= speeds_mps[k, 0]:
                speeds_mps[k, 0] = speed
    return speeds_mps
