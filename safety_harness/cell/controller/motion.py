"""Compute the twist of the TCP for a tick, for servoing or for a retreat, and apply the limits."""

from __future__ import annotations

import numpy as np

from safety_harness.base.compiled import njit_no_nrt
from safety_harness.base.geometry.arrays import Array6
from safety_harness.cell.controller.records import ParameterRecords, StateRecords
from safety_harness.cell.servoing.control import camera_twist
from safety_harness.trace.records import Limit, Mode

OBJECT_LOST = int(Mode.OBJECT_LOST)
# Joint velocities are constant within a tick while the arm turns.  So at its end the TCP is up to
# 0.2 % faster than at its beginning, where the limit is applied.
SPEED_RESERVE = 0.99
LIMIT_TCP_SPEED = int(Limit.TCP_SPEED)
LIMIT_TCP_ACCELERATION = int(Limit.TCP_ACCELERATION)


@njit_no_nrt
def servo_twist(
    parameters: ParameterRecords,
    states: StateRecords,
    twist_in_base_out: Array6,  # v, w [m/s, rad/s]
) -> None:
    """Fill ``twist_in_base_out`` with the TCP's twist by eq. 1, in the base frame.

        w = R w_camera,   v_tcp = R v_camera - w x c,   R = R_tcp_to_base R_camera_to_tcp

    Here c is the vector from the TCP to the camera's origin, in the base frame. The formula is valid because
    both points belong to the flange, which is a rigid body. The gain lambda is ``gain_near`` if |e|^2 (eq.
    15) is less than ``gain_switch_sse``, and ``gain_far`` otherwise. If the twist is not finite, the object
    counts as lost.
    """
    p, s = parameters[0], states[0]
    s.gain = p.gain_near if s.sse < p.gain_switch_sse else p.gain_far
    good = camera_twist(
        p.choice,
        p.desired_interaction,
        p.desired_interaction_pinv,
        s.moments,
        s.features,
        p.desired_area,
        p.desired_depth_m,
        p.dense,
        s.gain,
        s.feature_error,
        s.camera_twist,
    )
    if not good:
        s.mode = OBJECT_LOST
        s.gain = 0.0
        for i in range(6):
            s.camera_twist[i] = 0.0
        return
    rotation_tcp, twist = s.transform_tcp_to_base, twist_in_base_out
    c = s.twist_in_base  # scratch until ``shaped`` fills it
    for i in range(3):
        twist[i] = twist[3 + i] = c[i] = 0.0
        for k in range(3):
            c[i] += rotation_tcp[i, k] * p.transform_camera_to_tcp[k, 3]
            for j in range(3):
                rotation = rotation_tcp[i, k] * p.transform_camera_to_tcp[k, j]
                twist[i] += rotation * s.camera_twist[j]
                twist[3 + i] += rotation * s.camera_twist[3 + j]
    twist[0] -= twist[4] * c[2] - twist[5] * c[1]
    twist[1] -= twist[5] * c[0] - twist[3] * c[2]
    twist[2] -= twist[3] * c[1] - twist[4] * c[0]


@njit_no_nrt
def approach_twist(
    parameters: ParameterRecords,
    states: StateRecords,
    twist_in_base_out: Array6,  # v, w [m/s, rad/s]
) -> None:
    """Fill ``twist_in_base_out`` with a straight motion that ends at rest at the repulsive position.

        v = min(0.99 v_max, sqrt(2 (0.8 a) d), d/T) (target - tcp)/d,   d = |target - tcp|,   w = 0

    The speed is the least of three bounds. The first bound is 99 % of the repulsion speed v_max. The second
    bound is the speed from which the TCP can still stop within the remaining distance d. The TCP then brakes
    uniformly at 80 % of the permitted acceleration a. The other 20 % of the acceleration are a reserve,
    because the speed changes only once in a control period T. The third bound is the speed at which the TCP
    covers the remaining distance in one tick.
    """
    p, s = parameters[0], states[0]
    total = 0.0
    for i in range(3):
        twist_in_base_out[i] = s.target_in_base_m[i] - s.transform_tcp_to_base[i, 3]
        total += twist_in_base_out[i] * twist_in_base_out[i]
        twist_in_base_out[3 + i] = 0.0
    distance = np.sqrt(total)
    speed = min(
        SPEED_RESERVE * p.repulsion_speed_mps,
        # 2 times 0.8, the fraction of the permitted deceleration that the plan uses.
        np.sqrt(1.6 * p.repulsion_acceleration_mps2 * distance),
        distance / p.control_period_s,
    )
    for i in range(3):
        twist_in_base_out[i] *= speed / distance if distance > 0.0 else 0.0


@njit_no_nrt
def shaped(
    parameters: ParameterRecords,
    previous: Array6,  # the twist of the last tick, base frame
    wanted: Array6,
    max_speed_mps: float,
    max_acceleration_mps2: float,
    twist_out: Array6,
) -> int:
    """Limit the linear and the angular motion separately, and return the flags of the active limits.

    The function limits the speed and the acceleration of each motion:

        u = wanted min(1, v_max/|wanted|),   out = previous + (u - previous) min(1, a_max T/|u - previous|)

    The formula applies both to the velocity v and to the angular velocity w. T is the control period.
    ``SPEED_RESERVE`` reduces the linear v_max.
    """
    p = parameters[0]
    limits = 0
    bounds = (SPEED_RESERVE * max_speed_mps, p.max_tcp_angular_speed_radps)
    steps = (max_acceleration_mps2, p.max_tcp_angular_acceleration_radps2)
    for half in range(2):
        first = 3 * half
        speed = np.sqrt(
            wanted[first] * wanted[first]
            + wanted[first + 1] * wanted[first + 1]
            + wanted[first + 2] * wanted[first + 2]
        )
        # The speed is bounded first and the change second, because a step from an allowed twist towards an
        # allowed twist is allowed too.
        scale = 1.0
        if speed > bounds[half]:
            scale = bounds[half] / speed
            limits |= LIMIT_TCP_SPEED
        change = 0.0
        for i in range(first, first + 3):
            twist_out[i] = scale * wanted[i]
            change += (twist_out[i] - previous[i]) * (twist_out[i] - previous[i])
        change = np.sqrt(change)
        step = steps[half] * p.control_period_s
        if change > step:
            limits |= LIMIT_TCP_ACCELERATION
            for i in range(first, first + 3):
                twist_out[i] = previous[i] + step / change * (twist_out[i] - previous[i])
    return limits
