"""Apply speed and separation monitoring to every link, as the last step of a control tick.

The shield scales the command of any controller. If the arm brakes from the next tick on, it stops before a
hand at its greatest speed can reach a moving part. The theorem, its assumptions and its proof are in
docs/explanation/shield.md. This file applies the theorem's rule, with the symbols of that page. Take the
distance of hand i from the arm, and subtract both the size of the hand's body and the uncertainty of its
position. Let g_i be the result. The fraction s of the command obeys

    s <= (g_i - F - v_h t_0) / (v_h V/a + R),   R = V l + D.L.|u| l + A l^2/2,
    l = P + V/2a,   t_0 = age + P + T_r

V is a bound of the arm's speed, a is its deceleration, P is the control period, and T_r is the reaction time.
F is the sum of V(c) P + D.L.D/2 over the commands c that the drives may still have to execute. If a hand's
acceleration is at most b and its measured speed is at most w, it suffices that

    w t + b t^2/2 + F + s R <= g_i,   t = t_0 + s V/a
"""

from __future__ import annotations

from functools import lru_cache
from math import inf, isnan, sqrt
from typing import Any, NamedTuple, NewType

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import inlined, njit_no_nrt
from safety_harness.base.geometry.arrays import Array3, ArrayN, ArrayNx3
from safety_harness.base.geometry.linear import copy_vector
from safety_harness.base.geometry.segments import point_segment_distance
from safety_harness.base.settings import HAND_SLOTS, Settings
from safety_harness.cell.controller.records import (
    CommandRecords,
    ObservationRecords,
    ParameterRecords,
    StateRecords,
    overhead_transform_sensor_to_base,
)
from safety_harness.cell.perception.hand_boxes import position_from_box
from safety_harness.cell.perception.hand_filter import filter_parameters
from safety_harness.cell.robot.capsules import CapsuleSet
from safety_harness.cell.robot.description import ArmModel
from safety_harness.cell.robot.distance import CAPSULE, CapsuleRecords, chain_lengths, place_capsules
from safety_harness.cell.robot.drive import delay_ticks
from safety_harness.cell.robot.kinematics import link_twists, point_velocity
from safety_harness.scenario.shield import Shield
from safety_harness.trace.records import JOINTS, TRACKS_PER_HAND, Limit, intervention_dtype

LIMIT_SHIELD = int(Limit.SHIELD)

Records = NDArray[np.void]
ShieldRecords = NewType("ShieldRecords", Records)  # (1,) SHIELD, or (0,): there is none
Interventions = NewType("Interventions", Records)  # (n,) INTERVENTION, one a tick


@lru_cache
def shield_dtype(hands: int, joints: int = JOINTS) -> np.dtype[Any]:
    """Return the record type SHIELD.

    The record has room for ``joints`` joints, and for TRACKS_PER_HAND boxes for each of ``hands`` hands.
    """
    boxes = TRACKS_PER_HAND * hands
    return np.dtype(
        [
            ("hand_speed_mps", np.float64),
            ("hand_acceleration_mps2", np.float64),  # infinite: without a bound
            ("body_m", np.float64),
            ("uncertainty_m", np.float64),
            ("reaction_time_s", np.float64),  # in whole control periods
            ("deceleration_mps2", np.float64),
            ("window_s", np.float64),  # the least span of a measurement of a hand's speed
            ("reach_m", np.float64, (joints,)),  # from ``chain_lengths``
            # for the positions of boxes
            ("transform_sensor_to_base", np.float64, (4, 4)),
            ("focal_px", np.float64),
            ("c_u", np.float64),
            ("c_v", np.float64),
            ("assumed_radius_m", np.float64),
            # memory: the last frame that showed all hands, and two before it
            ("taken_s", np.float64, (3,)),  # -inf: never
            ("count", np.int64, (3,)),
            ("hand_in_base_m", np.float64, (3, boxes, 3)),
            ("speed_mps", np.float64, (boxes,)),  # a bound for each hand of the last frame
            # the command of the tick before, and the arm's braking time from it
            ("last_radps", np.float64, (joints,)),
            ("stop_s", np.float64),
            # scratch arrays of a tick
            ("flight_rad", np.float64, (joints,)),  # the largest turn of each joint by commands on their way
            ("clearance_m", np.float64, (boxes,)),
            ("capsule", np.int64, (boxes,)),
            ("twists", np.float64, (joints + 1, 6)),
            ("ends", np.float64, (1, 2, 3)),
            ("in_sensor", np.float64, (3,)),
        ],
        align=True,
    )


class Guard(NamedTuple):
    """The shield's records in a run, in the form that ``act`` takes.

    All arrays are empty without a shield.
    """

    shield: ShieldRecords  # (1,) SHIELD
    interventions: Interventions  # (n,) INTERVENTION
    capsules: CapsuleRecords  # (n,) CAPSULE


def guard_of(
    shield: Shield | None,
    settings: Settings,
    arm: ArmModel,
    capsules: CapsuleSet,
    ticks: int,
    hand_slots: int = HAND_SLOTS[0],
) -> Guard:
    """Return the shield's records for a run of ``ticks`` ticks.

    At first the arm is at rest, and there is no frame.

    Args:
        shield: The scenario's shield. None means that the records are empty.
        settings: The settings, with the control period and the sensor.
        arm: The arm.
        capsules: Its capsules.
        ticks: The number of ticks.
        hand_slots: The scenario's number of hands.

    """
    joints = len(arm.joint_names)
    if shield is None:
        return no_guard(hand_slots, joints)
    g = np.zeros(1, shield_dtype(hand_slots, joints))
    for name in ("hand_speed_mps", "body_m", "uncertainty_m", "deceleration_mps2"):
        g[name] = getattr(shield, name)
    period_s = settings.clock.control_period_s
    g["reaction_time_s"] = delay_ticks(shield.reaction_time_s, period_s) * period_s
    most = shield.hand_acceleration_mps2
    g["hand_acceleration_mps2"] = inf if most is None else most
    # This span makes the bound 2 Z/t + b t/2 of ``measure_speeds`` least.
    g["window_s"] = 0.0 if most is None else sqrt(4.0 * shield.uncertainty_m / most)
    g["reach_m"] = chain_lengths(arm.chain, capsules.records)
    g["transform_sensor_to_base"] = overhead_transform_sensor_to_base(settings)
    sensor = filter_parameters(settings.hand_filter, settings.hand_sensor)
    for name in ("focal_px", "c_u", "c_v", "assumed_radius_m"):
        g[name] = sensor[name]
    g["taken_s"] = -inf
    interventions = np.zeros(ticks, intervention_dtype(hand_slots, joints))
    interventions["scale"], interventions["capsule"] = 1.0, -1
    return Guard(ShieldRecords(g), Interventions(interventions), capsules.records.copy())


def no_guard(hand_slots: int = HAND_SLOTS[0], joints: int = JOINTS) -> Guard:
    """Return a guard of empty records for a run without a shield.

    The records have the same types as in a real guard.
    """
    return Guard(
        ShieldRecords(np.zeros(0, shield_dtype(hand_slots, joints))),
        Interventions(np.zeros(0, intervention_dtype(hand_slots, joints))),
        np.zeros(0, CAPSULE),
    )


@njit_no_nrt
def keep_apart(
    parameters: ParameterRecords,
    states: StateRecords,
    shields: ShieldRecords,
    interventions: Interventions,
    capsules: CapsuleRecords,
    observations: ObservationRecords,
    commands: CommandRecords,
    tick: int,
) -> None:
    """Scale the command of this tick, or brake along the path of the last command.

    If a number is NaN, the shield brakes. If the controller demands a stop, the shield brakes first. The
    shield passes the stop to the drives only when the arm is at rest. If the drives themselves stopped the
    moving arm, the arm would not brake during their reaction time.
    """
    p, s, g, command = parameters[0], states[0], shields[0], commands[0]
    joints, period_s = command.joint_velocity_radps.shape[0], p.control_period_s
    if observations[0].boxes_new:
        take_frame(shields, observations)
    axes, transforms, wanted_radps = p.chain.joint_axes, s.link_transforms, command.joint_velocity_radps
    flight_m = in_flight(axes, transforms, shields, interventions, capsules, tick, period_s)
    share, capsule, stop_s = 1.0, -1, 0.0
    if not command.protective_stop:
        clearances(transforms, shields, capsules)
        fastest_mps = fastest_point(axes, transforms, wanted_radps, shields, capsules)
        stop_s = fastest_mps / g.deceleration_mps2
        moves = False
        for i in range(joints):
            moves = moves or wanted_radps[i] != 0.0
        if moves:
            share, capsule = allowed_share(
                shields, wanted_radps, fastest_mps, flight_m, period_s, observations[0].time_s
            )
        if not stop_s < np.inf:  # a NaN or infinity somewhere, which a scaled command would contain too
            share, stop_s = 0.0, np.nan
    # The last command needs ``stop_s`` to brake. A command that needs less than the rest would brake harder
    # than the arm can, so the shield brakes along the last command's path instead.
    left_s = g.stop_s - period_s
    if command.protective_stop or (share < 1.0 and not share * stop_s >= left_s):
        kept = left_s / g.stop_s if left_s > 0.0 else 0.0
        # The drives may still execute the latest command that no later one need have replaced by now.
        stands, done_with = True, max(tick - 1 - round(g.reaction_time_s / period_s), 0)
        for i in range(joints):
            stands = stands and g.last_radps[i] == 0.0 and g.flight_rad[i] == 0.0
            stands = stands and interventions[done_with].sent_radps[i] == 0.0
            command.joint_velocity_radps[i] = kept * g.last_radps[i]
        command.protective_stop = command.protective_stop and stands
        g.stop_s = max(left_s, 0.0)
    else:
        for i in range(joints):
            command.joint_velocity_radps[i] *= share
        g.stop_s = share * stop_s
    copy_vector(command.joint_velocity_radps, g.last_radps)
    done = interventions[tick]
    done.scale, done.capsule, done.taken_s, done.count = share, capsule, g.taken_s[0], g.count[0]
    copy_vector(command.joint_velocity_radps, done.sent_radps)
    for k in range(g.count[0]):
        copy_vector(g.hand_in_base_m[0, k], done.hand_in_base_m[k])
    if share < 1.0:
        s.limits |= LIMIT_SHIELD
        for i in range(6):  # the controller must continue from the arm's motion, not from its own demand
            s.previous_twist_in_base[i] = 0.0
            for j in range(joints):
                s.previous_twist_in_base[i] += s.jacobian[i, j] * command.joint_velocity_radps[j]


@inlined
def in_flight(
    joint_axes: ArrayNx3,
    transforms: NDArray[np.float64],  # (joints + 2, 4, 4)
    shields: ShieldRecords,
    interventions: Interventions,
    capsules: CapsuleRecords,
    tick: int,
    period_s: float,
) -> float:
    """Return a bound [m] of how far the commands of the last reaction time may still move a point of the arm.

    The function also fills the largest turn of each joint that these commands may still cause. These bounds
    are valid because the drives execute each command at most once, and within the reaction time.
    """
    g, flight_m = shields[0], 0.0
    g.flight_rad[:] = 0.0
    for k in range(max(tick - round(g.reaction_time_s / period_s), 0), tick):
        sent, moves = interventions[k].sent_radps, False
        for i in range(sent.shape[0]):
            moves = moves or sent[i] != 0.0
            g.flight_rad[i] += abs(sent[i]) * period_s
        if moves:
            flight_m += fastest_point(joint_axes, transforms, sent, shields, capsules) * period_s
    return flight_m


@inlined
def middle_of(capsules: CapsuleRecords, k: int, transforms: NDArray[np.float64], middle: Array3) -> float:
    """Fill the middle (3,) of a capsule's axis in the base frame, and return half the length of the axis.

    ``transforms`` (frames, 4, 4) transform from each frame to the base.
    """
    start, end, squared = capsules[k].start_in_link, capsules[k].end_in_link, 0.0
    at = transforms[capsules[k].link_index]
    for i in range(3):
        squared += (end[i] - start[i]) * (end[i] - start[i])
        middle[i] = at[i, 3]
        for j in range(3):
            middle[i] += at[i, j] * 0.5 * (start[j] + end[j])
    return 0.5 * sqrt(squared)


@inlined
def fastest_point(
    joint_axes: ArrayNx3,
    transforms: NDArray[np.float64],  # (joints + 2, 4, 4)
    rates_radps: ArrayN,
    shields: ShieldRecords,
    capsules: CapsuleRecords,
) -> float:
    """Return a bound V [m/s] of the speed of all points on the capsules' axes, or NaN if a speed is NaN.

    The speed of a point on an axis exceeds the speed of the axis's middle by at most |w| times half the
    axis's length.
    """
    g, fastest_mps, joints = shields[0], 0.0, joint_axes.shape[0]
    link_twists(joint_axes, transforms, rates_radps, g.twists)
    for k in range(capsules.shape[0]):
        if capsules[k].link_index == 0:
            continue  # the base stands
        half_m = middle_of(capsules, k, transforms, g.in_sensor)
        twist = g.twists[min(capsules[k].link_index, joints)]
        x, y, z = point_velocity(twist, g.in_sensor)
        turn = sqrt(twist[0] * twist[0] + twist[1] * twist[1] + twist[2] * twist[2])
        speed_mps = sqrt(x * x + y * y + z * z) + turn * half_m
        if speed_mps > fastest_mps or isnan(speed_mps):  # a NaN stays until the end
            fastest_mps = speed_mps
    return fastest_mps


@inlined
def clearances(
    transforms: NDArray[np.float64],  # (joints + 2, 4, 4)
    shields: ShieldRecords,
    capsules: CapsuleRecords,
) -> None:
    """Fill the distance [m] of each hand from the arm, and the index of the nearest capsule.

    The distance is between the surface of the moving parts, without the base, and the measured centre of the
    hand. The distance between a point of an axis and the axis's middle is at most half the axis's length. So
    the loop can skip most capsules.
    """
    g = shields[0]
    for i in range(g.count[0]):
        g.clearance_m[i], g.capsule[i] = np.inf, -1
    middle = g.in_sensor
    for k in range(capsules.shape[0] - 1, -1, -1):  # the arm's end first: usually the nearest
        capsule = capsules[k]
        if capsule.link_index == 0:
            continue  # the base stands
        placed, around_m = False, middle_of(capsules, k, transforms, middle) + capsule.radius_m
        for i in range(g.count[0]):
            hand, away = g.hand_in_base_m[0, i], 0.0
            for n in range(3):
                away += (hand[n] - middle[n]) * (hand[n] - middle[n])
            bound_m = g.clearance_m[i] + around_m
            if bound_m > 0.0 and away >= bound_m * bound_m:
                continue
            if not placed:
                place_capsules(capsules[k : k + 1], transforms, g.ends)
                placed = True
            clear_m = point_segment_distance(hand, g.ends[0, 0], g.ends[0, 1]) - capsule.radius_m
            if clear_m < g.clearance_m[i] or isnan(clear_m):
                g.clearance_m[i], g.capsule[i] = clear_m, k


@inlined
def allowed_share(
    shields: ShieldRecords,
    rates_radps: ArrayN,
    fastest_mps: float,
    flight_m: float,
    period_s: float,
    time_s: float,
) -> tuple[float, int]:
    """Return the allowed fraction s of the command, and the index of the capsule that determines s.

    The index is -1 if no capsule determines s. ``flight_m`` comes from ``in_flight``.
    """
    g = shields[0]
    if not g.taken_s[0] > -np.inf:
        return 0.0, -1
    stop_s = fastest_mps / g.deceleration_mps2
    hold_s = period_s + g.reaction_time_s
    way_s = period_s + 0.5 * stop_s
    bend, cross, flown, rate_sum, turn_sum_rad = 0.0, 0.0, 0.0, 0.0, 0.0  # A, D.L.|u|, D.L.D
    for j in range(rates_radps.shape[0]):
        rate, turn_rad, reach_m = abs(rates_radps[j]), g.flight_rad[j], g.reach_m[j]
        # For a pair of joints the reach of the outer joint counts, as in ``closest_approach._bend``. The sums
        # over earlier joints avoid the double loop.
        bend += rate * reach_m * (rate + 2.0 * rate_sum)
        cross += reach_m * (turn_rad * (rate + rate_sum) + rate * turn_sum_rad)
        flown += turn_rad * reach_m * (turn_rad + 2.0 * turn_sum_rad)
        rate_sum += rate
        turn_sum_rad += turn_rad
    robot_m = (fastest_mps + cross) * way_s + 0.5 * bend * way_s * way_s
    known_s = time_s - g.taken_s[0] + hold_s
    share, capsule = 1.0, -1
    for i in range(g.count[0]):
        free_m = g.clearance_m[i] - g.body_m - g.uncertainty_m - (flight_m + 0.5 * flown)
        seen = g.speed_mps[i]
        # Both rules are proven, so the shield may use the one that allows more.
        own = share_within(free_m, robot_m, known_s, stop_s, g.hand_speed_mps, 0.0)
        if g.hand_acceleration_mps2 < np.inf:
            own = max(own, share_within(free_m, robot_m, known_s, stop_s, seen, g.hand_acceleration_mps2))
        # The negated form also takes over a NaN.
        if not own >= share:
            share, capsule = own, g.capsule[i]
    return share, capsule


@inlined
def share_within(
    free_m: float, robot_m: float, known_s: float, stop_s: float, hand_mps: float, hand_mps2: float
) -> float:
    """Return the largest s for which w t + b t^2/2 + s R <= ``free_m``.

    Here t = t_0 + s V/a. The arguments are R = ``robot_m``, t_0 = ``known_s``, V/a = ``stop_s``, w =
    ``hand_mps`` and b = ``hand_mps2``. Return 0 if such an s does not exist, or if a number is NaN.
    """
    room_m = free_m - hand_mps * known_s - 0.5 * hand_mps2 * known_s * known_s
    if not room_m > 0.0:
        return 0.0
    per_share = (hand_mps + hand_mps2 * known_s) * stop_s + robot_m
    # The quadratic formula in the form that does not cancel and also holds for b = 0.
    root = sqrt(per_share * per_share + 2.0 * hand_mps2 * stop_s * stop_s * room_m)
    return 2.0 * room_m / (per_share + root)


@njit_no_nrt
def take_frame(shields: ShieldRecords, observations: ObservationRecords) -> None:
    """Store the hands of a new frame, unless the frame shows fewer hands than the last stored frame."""
    g, o = shields[0], observations[0]
    # A frame with fewer hands has missed one. The older positions stay, and their age enters the bound.
    if o.box_count < g.count[0]:
        return
    g.taken_s[0], g.count[0] = o.boxes_time_s, o.box_count
    for k in range(o.box_count):
        position_from_box(o.boxes[k], g.focal_px, g.c_u, g.c_v, g.assumed_radius_m, g.in_sensor)
        for i in range(3):
            g.hand_in_base_m[0, k, i] = g.transform_sensor_to_base[i, 3]
            for j in range(3):
                g.hand_in_base_m[0, k, i] += g.transform_sensor_to_base[i, j] * g.in_sensor[j]
    if g.hand_acceleration_mps2 < np.inf:
        measure_speeds(shields)


@inlined
def measure_speeds(shields: ShieldRecords) -> None:
    """Fill an upper bound of the speed of each hand in the last frame.

    The bound uses an earlier frame, which is older by at least the window. The bound is |v| <= (|p -
    p_before| + 2 Z)/t + b t/2. Z is the uncertainty of a position, t is the time between the two frames, and
    b is the largest acceleration. The shield does not know which hand of the older frame is which hand of the
    newer frame. So p_before is the farthest position in the older frame from which the hand could have come.
    """
    g = shields[0]
    if g.taken_s[0] - g.taken_s[1] >= g.window_s:  # frame 1 becomes frame 2, and this frame 1
        for later in range(1, -1, -1):
            g.taken_s[later + 1], g.count[later + 1] = g.taken_s[later], g.count[later]
            for k in range(g.count[later]):
                copy_vector(g.hand_in_base_m[later, k], g.hand_in_base_m[later + 1, k])
    span_s, doubt_m = g.taken_s[0] - g.taken_s[2], 2.0 * g.uncertainty_m
    for k in range(g.count[0]):
        farthest_m = -1.0
        for earlier in range(g.count[2]):
            total = 0.0
            for i in range(3):
                total += (g.hand_in_base_m[0, k, i] - g.hand_in_base_m[2, earlier, i]) ** 2
            if sqrt(total) <= g.hand_speed_mps * span_s + doubt_m:
                farthest_m = max(farthest_m, sqrt(total))
        g.speed_mps[k] = g.hand_speed_mps
        if farthest_m >= 0.0 and g.count[2] >= g.count[0] and 0.0 < span_s < np.inf:
            speed_mps = (farthest_m + doubt_m) / span_s + 0.5 * g.hand_acceleration_mps2 * span_s
            g.speed_mps[k] = min(g.hand_speed_mps, speed_mps)
