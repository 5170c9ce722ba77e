"""Move the hands as the scenario states.

The module interprets the moves of hands for both worlds. The velocity of a moving hand is continuous. The
rate of change of this velocity is at most the hand's largest acceleration. A closed form gives straight paths
from rest to rest (``follow_leg``). A hand that heads for the TCP turns its velocity towards the TCP
(``pursue``). A hand that must stop brakes along its path (``brake``).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import njit_no_nrt
from safety_harness.base.elementary import sin
from safety_harness.base.geometry.arrays import Array3

LEG, WAIT, REACH_FOR_TCP, FOLLOW_TCP = range(4)  # kinds of compiled moves

# A move of a scenario is a group of one or more MOVE records with a common time limit.
MOVE = np.dtype(
    [
        ("kind", np.int64),
        ("target_in_base_m", np.float64, (3,)),  # of a leg
        ("speed_mps", np.float64),
        ("distance_m", np.float64),  # the distance from the target or TCP at which the hand arrives
        ("duration_s", np.float64),  # of a wait
        ("within_s", np.float64),  # time limit of the group
        ("after", np.int64),  # where the next group begins, counted from the hand's first move
    ],
    align=True,
)

HAND = np.dtype(
    [
        ("present", np.bool_),
        ("recorded", np.bool_),
        ("leader", np.int64),  # the hand with which this hand moves, else -1
        ("apart_in_base_m", np.float64, (3,)),  # from its leader
        ("position_in_base_m", np.float64, (3,)),
        ("elbow_in_base_m", np.float64, (3,)),
        ("elbow_towards_in_base_m", np.float64, (3,)),
        ("forearm_length_m", np.float64),
        ("max_acceleration_mps2", np.float64),
        ("tremor_m", np.float64),  # along each axis
        ("tremor_radps", np.float64),
        ("tremor_phase_rad", np.float64, (3,)),
        ("first", np.int64),  # index of this hand's first move or sample
        ("count", np.int64),
        ("current", np.int64),  # number of the present move or sample interval
        ("elapsed_s", np.float64),  # in the current move
        ("spent_s", np.float64),  # in its group
        ("steady_in_base_m", np.float64, (3,)),  # without tremor, as the next
        ("velocity_in_base_mps", np.float64, (3,)),
        ("on_leg", np.bool_),  # whether the current leg has begun; then it has:
        ("leg_start_in_base_m", np.float64, (3,)),
        ("leg_direction_in_base", np.float64, (3,)),
        ("leg_way_m", np.float64),
        ("leg_s", np.float64),  # time since it began
    ],
    align=True,
)
MoveRecords = NDArray[np.void]  # (m,) MOVE
HandRecords = NDArray[np.void]  # (hands,) HAND, present hands first

# Rounding: a hand that brakes towards its goal may end this far from it.
ARRIVED_M = 1e-9


@njit_no_nrt
def advance_hands(
    hands: HandRecords,
    moves: MoveRecords,
    samples: NDArray[np.float64],  # (s, 7)
    tcp_position_in_base_m: Array3,  # at time_s
    time_s: float,
    dt_s: float,
) -> None:
    """Move every hand from ``time_s`` to ``time_s + dt_s``.

    If a move ends within the tick, the next move gets the rest of the tick. Hands that head for the TCP aim
    at the TCP's position at ``time_s``.
    """
    for k in range(hands.shape[0]):
        hand = hands[k]
        if not hand.present:
            continue
        if hand.recorded:
            follow_recording(hands, k, samples, time_s + dt_s)
            continue
        if hand.leader >= 0:
            leader = hands[hand.leader]
            for i in range(3):
                hand.position_in_base_m[i] = leader.position_in_base_m[i] + hand.apart_in_base_m[i]
            point_forearm(hands, k)
            continue
        left_s = dt_s
        while left_s > 0.0 and hand.current < hand.count:
            left_s = advance_move(hands, k, moves, tcp_position_in_base_m, left_s)
        brake(hands, k, left_s)
        for i in range(3):
            # Added to the steady position, so that the tremor never enters the hand's velocity or its
            # arrival.
            tremor_m = 0.0
            if hand.tremor_m != 0.0:
                angle = hand.tremor_radps * (time_s + dt_s) + hand.tremor_phase_rad[i]
                tremor_m = hand.tremor_m * sin(angle)
            hand.position_in_base_m[i] = hand.steady_in_base_m[i] + tremor_m
        point_forearm(hands, k)


@njit_no_nrt
def advance_move(
    hands: HandRecords, k: int, moves: MoveRecords, tcp_position_in_base_m: Array3, left_s: float
) -> float:
    """Execute the current move for at most ``left_s``.

    Return the time [s] that remains of ``left_s``.
    """
    hand = hands[k]
    move = moves[hand.first + hand.current]
    allowed_s = min(left_s, move.within_s - hand.spent_s)
    if move.kind == WAIT:
        used_s = min(allowed_s, move.duration_s - hand.elapsed_s)
        brake(hands, k, used_s)
        done = used_s >= move.duration_s - hand.elapsed_s
    elif move.kind == LEG:
        used_s, done = follow_leg(hands, k, move.target_in_base_m, move.distance_m, move.speed_mps, allowed_s)
    else:
        used_s, done = pursue(hands, k, tcp_position_in_base_m, move.distance_m, move.speed_mps, allowed_s)
        # A following hand has no arrival: it stops beside the TCP and waits for its time limit.
        if done and move.kind == FOLLOW_TCP:
            brake(hands, k, allowed_s)
            used_s, done = allowed_s, False
    group_over = used_s >= move.within_s - hand.spent_s
    hand.elapsed_s += used_s
    hand.spent_s += used_s
    if done or group_over:
        hand.current = move.after if group_over else hand.current + 1
        hand.elapsed_s = 0.0
        hand.on_leg = False
        if hand.current == move.after:
            hand.spent_s = 0.0
    return float(max(left_s - used_s, 0.0))


@njit_no_nrt
def brake(hands: HandRecords, k: int, dt_s: float) -> float:
    """Slow down along the path for at most ``dt_s``, or until standstill.

    Return the time [s] that this takes.
    """
    hand = hands[k]
    squared = 0.0
    for i in range(3):
        squared += hand.velocity_in_base_mps[i] * hand.velocity_in_base_mps[i]
    speed = np.sqrt(squared)
    if speed == 0.0:
        return 0.0
    stop_s = speed / hand.max_acceleration_mps2
    used_s = min(dt_s, stop_s)
    kept = 0.0 if used_s >= stop_s else 1.0 - used_s / stop_s
    for i in range(3):
        hand.steady_in_base_m[i] += hand.velocity_in_base_mps[i] * 0.5 * (1.0 + kept) * used_s
        hand.velocity_in_base_mps[i] *= kept
    return float(used_s)


@njit_no_nrt
def follow_leg(
    hands: HandRecords, k: int, target_in_base_m: Array3, distance_m: float, speed_mps: float, dt_s: float
) -> tuple[float, bool]:
    """Move straight, from rest to rest, until the hand is ``distance_m`` from the target.

    Return the time used [s], and whether the hand has arrived. The speed is a trapezoid over time, or a
    triangle if the path is too short for ``speed_mps``.
    """
    hand = hands[k]
    used_s = 0.0
    if not hand.on_leg:
        # A leg starts at rest, so a hand that comes from a pursuit brakes first.
        used_s = brake(hands, k, dt_s)
        for i in range(3):
            if hand.velocity_in_base_mps[i] != 0.0:
                return dt_s, False
        begin_leg(hands, k, target_in_base_m, distance_m)
    acceleration, path_m = hand.max_acceleration_mps2, hand.leg_way_m
    # On a short path the hand accelerates over one half and brakes over the other: v^2/2a = path/2.
    peak = min(speed_mps, np.sqrt(acceleration * path_m))
    ramp_s = peak / acceleration
    total_s = path_m / peak + ramp_s if peak > 0.0 else 0.0
    if hand.leg_s + (dt_s - used_s) >= total_s:
        for i in range(3):
            hand.steady_in_base_m[i] = hand.leg_start_in_base_m[i] + path_m * hand.leg_direction_in_base[i]
            hand.velocity_in_base_mps[i] = 0.0
            if distance_m == 0.0:
                hand.steady_in_base_m[i] = target_in_base_m[i]  # exactly, whatever the rounding
        return used_s + max(total_s - hand.leg_s, 0.0), True
    hand.leg_s += dt_s - used_s
    to_end_s = total_s - hand.leg_s
    if hand.leg_s < ramp_s:
        gone, rate = 0.5 * acceleration * hand.leg_s**2, acceleration * hand.leg_s
    elif to_end_s < ramp_s:
        gone, rate = path_m - 0.5 * acceleration * to_end_s**2, acceleration * to_end_s
    else:
        gone, rate = peak * (hand.leg_s - 0.5 * ramp_s), peak
    for i in range(3):
        hand.steady_in_base_m[i] = hand.leg_start_in_base_m[i] + gone * hand.leg_direction_in_base[i]
        hand.velocity_in_base_mps[i] = rate * hand.leg_direction_in_base[i]
    return dt_s, False


@njit_no_nrt
def begin_leg(hands: HandRecords, k: int, target_in_base_m: Array3, distance_m: float) -> None:
    """Set the start, direction and length of a leg that begins at the hand's present position."""
    hand = hands[k]
    hand.on_leg = True
    hand.leg_s = 0.0
    total = 0.0
    for i in range(3):
        hand.leg_start_in_base_m[i] = hand.steady_in_base_m[i]
        hand.leg_direction_in_base[i] = target_in_base_m[i] - hand.steady_in_base_m[i]
        total += hand.leg_direction_in_base[i] ** 2
    length = np.sqrt(total)
    hand.leg_way_m = max(length - distance_m, 0.0)
    for i in range(3):
        hand.leg_direction_in_base[i] = hand.leg_direction_in_base[i] / length if length > 0.0 else 0.0


@njit_no_nrt
def pursue(
    hands: HandRecords, k: int, goal_in_base_m: Array3, distance_m: float, speed_mps: float, dt_s: float
) -> tuple[float, bool]:
    """Turn the velocity towards the goal for ``dt_s``.

    Return the time used [s], and whether the hand is within ``distance_m`` of the goal. The hand approaches
    with the largest speed w from which it can still stop within the remaining gap g. The equation is
    (v + w)/2 dt + w^2/2a = g, in which v is the present speed and a is the deceleration.
    """
    hand = hands[k]
    total, closing = 0.0, 0.0
    for i in range(3):
        ahead = goal_in_base_m[i] - hand.steady_in_base_m[i]
        total += ahead**2
        closing += ahead * hand.velocity_in_base_mps[i]
    away = np.sqrt(total)
    gap = away - distance_m
    if gap <= ARRIVED_M:
        return 0.0, True
    change = hand.max_acceleration_mps2 * dt_s
    discriminant = 4.0 * hand.max_acceleration_mps2 * gap - 2.0 * change * closing / away
    # Even with w = 0 the hand would need more than the gap to stop, so it brakes as hard as it can.
    if discriminant <= 0.0:
        return brake(hands, k, dt_s), False
    # The positive root of the equation above, without a difference of nearly equal numbers.
    wanted = min(speed_mps, discriminant / (change + np.sqrt(change**2 + 2.0 * discriminant)))
    squared = 0.0
    for i in range(3):
        direction = (goal_in_base_m[i] - hand.steady_in_base_m[i]) / away
        squared += (wanted * direction - hand.velocity_in_base_mps[i]) ** 2
    # The velocity changes by at most a dt, also when its direction must change.
    part = min(1.0, change / np.sqrt(squared)) if squared > 0.0 else 0.0
    for i in range(3):
        direction = (goal_in_base_m[i] - hand.steady_in_base_m[i]) / away
        step = wanted * direction - hand.velocity_in_base_mps[i]
        hand.steady_in_base_m[i] += (hand.velocity_in_base_mps[i] + 0.5 * part * step) * dt_s
        hand.velocity_in_base_mps[i] += part * step
    return dt_s, False


@njit_no_nrt
def point_forearm(hands: HandRecords, k: int) -> None:
    """Put the elbow at a distance of the forearm's length from the hand, towards the person."""
    hand = hands[k]
    total = 0.0
    for i in range(3):
        total += (hand.elbow_towards_in_base_m[i] - hand.position_in_base_m[i]) ** 2
    distance = np.sqrt(total)
    for i in range(3):
        direction = 1.0 if i == 2 else 0.0  # straight up if the hand is at the person's place
        if distance > 0.0:
            direction = (hand.elbow_towards_in_base_m[i] - hand.position_in_base_m[i]) / distance
        hand.elbow_in_base_m[i] = hand.position_in_base_m[i] + hand.forearm_length_m * direction


@njit_no_nrt
def follow_recording(hands: HandRecords, k: int, samples: NDArray[np.float64], time_s: float) -> None:
    """Put hand and elbow at their recorded positions.

    The positions are linear between samples, and constant after the last sample. ``samples`` (s, 7).
    """
    hand = hands[k]
    last = hand.first + hand.count - 1
    row = hand.first + hand.current
    while row < last - 1 and samples[row + 1, 0] <= time_s:
        row += 1
    hand.current = row - hand.first
    span_s = samples[row + 1, 0] - samples[row, 0]
    fraction = min(max((time_s - samples[row, 0]) / span_s, 0.0), 1.0)
    for i in range(3):
        earlier, later = samples[row, 1 + i], samples[row + 1, 1 + i]
        hand.position_in_base_m[i] = earlier + fraction * (later - earlier)
        earlier, later = samples[row, 4 + i], samples[row + 1, 4 + i]
        hand.elbow_in_base_m[i] = earlier + fraction * (later - earlier)
