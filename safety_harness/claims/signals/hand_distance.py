"""Compute the distance of hands from the robot at the ticks and between them, and its errors."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import compiled, inlined
from safety_harness.base.settings import Hand
from safety_harness.cell.robot.capsules import Arm
from safety_harness.cell.robot.closest_approach import MAX_BISECTIONS, closest_approach_between
from safety_harness.cell.robot.distance import hand_distance, place_capsules
from safety_harness.cell.robot.kinematics import forward_kinematics
from safety_harness.cell.simulation.worlds import entry_of
from safety_harness.claims.signals.bounds import apart_between
from safety_harness.claims.signals.occasions import no_hand
from safety_harness.claims.signals.true_motion import (
    JOINTS,
    HandPaths,
    arm_of,
    capsules_of,
    finer_paths,
    first_stray,
    follows_unknown,
    hand_bend_m,
    hand_paths,
    tcp_of,
    true_motion,
)
from safety_harness.trace.trace import Trace, history

POINT = (0.0, 0.0)  # radii of a hand that is a point
FASTEST_RADPS = 1e4  # no joint turns so fast, so that such a speed is meaningless
SATURATED_RADPS = 1e-3  # motors may saturate if the mean speed is this far from that at the tick's end
ROUNDING_RADPS = 1e-6  # by which a mean speed may exceed the recorded speeds: a nanometre or two
TURNED_RAD = 8.0 * np.pi  # four times the limits: beyond it an engine or a file has taken the arm apart


def distance_moved_m(trace: Trace) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the errors [m] of the hands' distances: at the ticks (n,), and between the ticks (n,).

    Both are infinite if a hand heads for the TCP but the TCP was not measured exactly at all ticks.
    """
    known, count = trace.known, len(trace.ticks)
    if follows_unknown(trace):
        return np.full(count, np.inf), np.full(count, np.inf)
    reach_m, period_s = float(arm_of(trace).reach_m.sum()), trace.scenario.settings.clock.control_period_s
    columns = ("hand_position_in_base_m", "elbow_position_in_base_m", *JOINTS)
    hand_m, elbow_m, turned_rad, faster_radps = (known.uncertainty_of(name, count) for name in columns)
    between_m = apart_between(hand_m, elbow_m, turned_rad * reach_m, faster_radps * reach_m, period_s)
    return known.uncertainty_of("hand_distance_m", count), between_m


class Nearest(NamedTuple):
    """The lower and the upper bound [m] of the least distance of a hand.

    Without a hand, both are inf. If no hand is present, both bounds are inf.
    """

    low_m: float = np.inf
    time_s: float = 0.0
    hand: int = 0
    high_m: float = np.inf

    def or_nearer(self, candidate: Nearest) -> Nearest:
        """Return this object or ``candidate``, whichever has the smaller lower bound.

        The upper bound of the result is the smaller of both upper bounds.
        """
        low = self if candidate.low_m >= self.low_m else candidate  # a NaN comes out
        return low._replace(high_m=min(self.high_m, candidate.high_m))


def known_to(
    limit_m: float, nearest: Callable[[Trace, HandPaths], Nearest], trace: Trace, paths: HandPaths
) -> Nearest:
    """Return the result of ``nearest``.

    If ``limit_m`` lies between the bounds of the result, the function computes the result again with
    ``finer_paths``.
    """
    known = nearest(trace, paths)
    return nearest(trace, finer_paths(trace)) if known.low_m < limit_m <= known.high_m else known


def followed_hands(trace: Trace) -> tuple[HandPaths | None, str]:
    """Return the hands' paths, or None and the reason why ``trace`` has no usable hand distances."""
    if not trace.scenario.hands:
        return None, f"never exercised: {no_hand(trace)}"
    if (np.abs(history(trace, "joint_position_rad")) > TURNED_RAD).any():
        return None, "a joint has turned further than any arm can"
    stray = first_stray(trace)
    if stray is not None:
        return None, f"at tick {stray} a hand is not where the scenario moves it"
    return hand_paths(trace), ""


def capsule_name(trace: Trace, tick: int, hand: int) -> str:
    """Return the name of the robot's part that is nearest to ``hand`` at ``tick``."""
    names = capsules_of(trace).names
    number = int(trace.ticks["hand_distance_capsule"][tick, hand])
    return names[number].replace("_", " ") if 0 <= number < len(names) else "an unknown part"


def closest_approach(trace: Trace, paths: HandPaths, off_m: NDArray[np.float64] | None = None) -> Nearest:
    """Return the closest approach of any hand, at the ticks and between them.

    ``off_m`` (n,) is the error of the distance at each tick, which is subtracted. Between two ticks, the
    larger of both errors is subtracted.
    """
    settings = trace.scenario.settings
    best = Nearest()
    for hand in range(len(trace.scenario.hands)):
        at, joints_rad, hand_m, elbow_m, distance_m, slack_m = instants(trace, paths, hand)
        if off_m is not None:
            tick_before = np.minimum(at.astype(int), len(off_m) - 1)
            distance_m = distance_m - off_m[tick_before]
            tick_after = np.minimum(tick_before[:-1] + 1, len(off_m) - 1)
            slack_m = slack_m + np.maximum(off_m[tick_before[:-1]], off_m[tick_after])
        ends_m, instant = closest_between(
            arm_of(trace), at, joints_rad, hand_m, elbow_m, distance_m, slack_m, settings.hand, paths
        )
        time_s = instant * settings.clock.control_period_s
        best = best.or_nearer(Nearest(ends_m[0], time_s, hand, ends_m[1]))
    return best


def closest_between(
    arm: Arm,
    at: NDArray[np.float64],  # (n,) in ticks
    joints_rad: NDArray[np.float64],  # (n, joints)
    hand_m: NDArray[np.float64],  # (n, 3)
    elbow_m: NDArray[np.float64],  # (n, 3)
    distance_m: NDArray[np.float64],  # (n,)
    slack_m: NDArray[np.float64],  # (n - 1,)
    size: Hand,
    paths: HandPaths,
) -> tuple[tuple[float, float], float]:
    """Return both bounds of a hand's least distance [m] over ``instants``.

    The second result is the time of the lower bound, in ticks.
    """
    low_m, index, fraction, high_m = _closest_in_trace(
        arm,
        np.array(joints_rad, order="C"),
        np.array(hand_m, order="C"),
        np.array(elbow_m, order="C"),
        np.array(distance_m, order="C"),
        slack_m,
        size.radius_m,
        size.forearm_radius_m,
        paths.resolution_m,
    )
    later = at[min(index + 1, len(at) - 1)]
    return (low_m, high_m), float(at[index] + fraction * (later - at[index]))


def ends_between(
    trace: Trace, paths: HandPaths, hand: int, *, from_tcp: bool = False
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return both bounds of a hand's least distance [m] between ticks.

    The second result is how far [m] the hand and the elbow move. Both results are (2, n-1); NaN stands for
    unknown. The distance is measured from the arm, surface to surface. If ``from_tcp`` is True, the distance
    is measured from the TCP to the hand's centre.
    """
    own, bodies, size = paths.corner_hand == hand, [0, 0 if from_tcp else 1], trace.scenario.settings.hand
    true, arm = true_motion(trace), tcp_of(trace) if from_tcp else arm_of(trace)
    return between_ticks(
        arm,
        np.empty((MAX_BISECTIONS + 1, len(arm.capsules), 2, 3)),
        np.array(true.joints_rad, order="C"),
        np.array(true.hands_m[:, hand][:, bodies], order="C"),
        paths.corner_at[own],
        np.array(paths.corners_in_base_m[own][:, bodies], order="C"),
        joint_bend_m(trace, arm) + hand_bend_m(trace, paths, hand, centre=from_tcp),
        POINT if from_tcp else (size.radius_m, size.forearm_radius_m),
        paths.resolution_m,
    )


@inlined
def distance_m(first: NDArray[np.float64], second: NDArray[np.float64]) -> float:
    """Return the distance [m] between the points ``first`` (3,) and ``second`` (3,)."""
    x, y, z = second[0] - first[0], second[1] - first[1], second[2] - first[2]
    return float(np.sqrt(x * x + y * y + z * z))


@compiled
def between_ticks(
    arm: Arm,
    space: NDArray[np.float64],  # (MAX_BISECTIONS + 1, capsules, 2, 3), overwritten
    joints_rad: NDArray[np.float64],  # (n, joints)
    bodies_m: NDArray[np.float64],  # (n, 2, 3) a hand and its elbow
    corner_at: NDArray[np.float64],  # (c,) in ticks, rising
    corners_m: NDArray[np.float64],  # (c, 2, 3) both there
    slack_m: NDArray[np.float64],  # (n - 1,) by which arm and hand may leave straight ways
    radii_m: tuple[float, float],  # of hand and forearm
    tolerance_m: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return both bounds of a hand's least distance [m] between ticks.

    The second result is how far [m] the hand and the elbow move. Both results are (2, n - 1). Arm and hand
    move straight from corner to corner.
    """
    ends_m, ways_m, c = np.full((2, len(slack_m)), np.inf), np.zeros((2, len(slack_m))), 0
    radius_m, arm_radius_m = radii_m
    for k in range(len(slack_m)):
        begin, corner, (hand, elbow) = joints_rad[k], True, bodies_m[k]
        while corner:
            # A tick is divided at its corners, between which arm and hand move straight.
            corner = c < len(corner_at) and min(int(corner_at[c]), len(slack_m) - 1) <= k
            end, bodies_end_m = joints_rad[k + 1], bodies_m[k + 1]
            if corner:
                end, bodies_end_m = joints_rad[k] + (corner_at[c] - k) * (end - joints_rad[k]), corners_m[c]
                c += 1
            to, elbow_to = bodies_end_m
            bound_m, _, sampled_m, _ = closest_approach_between(
                arm, space, begin, end, hand, to, elbow, elbow_to, radius_m, arm_radius_m, tolerance_m, np.inf
            )
            ends_m[0, k] = np.minimum(ends_m[0, k], bound_m - slack_m[k])  # a NaN comes out
            ends_m[1, k] = np.minimum(ends_m[1, k], sampled_m + slack_m[k])
            ways_m[0, k] += distance_m(hand, to)
            ways_m[1, k] += distance_m(elbow, elbow_to)
            begin, hand, elbow = end, to, elbow_to
    return ends_m, ways_m


def instants(trace: Trace, paths: HandPaths, hand: int) -> tuple[NDArray[np.float64], ...]:
    """Return the states of arm and hand at the ticks and at the hand's corners, in order of time.

    The arrays are the instants in ticks (n,), the joints (n, 6), the hand (n, 3), the elbow (n, 3) and the
    distance (n,). At a corner, the distance is inf. The last array (n - 1,) belongs to the time after each
    instant. It states how far [m] the distance may be below the distance for straight motion.
    """
    true, distance_m = true_motion(trace), trace.ticks["hand_distance_m"][:, hand]
    joints_rad, hand_m, elbow_m = true.joints_rad, true.hands_m[:, hand, 0], true.hands_m[:, hand, 1]
    slack_m = joint_bend_m(trace) + hand_bend_m(trace, paths, hand)
    ticks = np.arange(len(joints_rad), dtype=np.float64)
    own = paths.corner_hand == hand
    if not own.any():
        return ticks, joints_rad, hand_m, elbow_m, distance_m, slack_m
    corner_at = paths.corner_at[own]
    # a sample that lies before the last tick only by rounding counts as at that tick
    next_tick = np.minimum(np.searchsorted(ticks, corner_at, side="right"), len(ticks) - 1)
    at = np.insert(ticks, next_tick, corner_at)
    corners = paths.corners_in_base_m[own]
    return (
        at,
        np.column_stack([np.interp(at, ticks, column) for column in joints_rad.T]),
        np.insert(hand_m, next_tick, corners[:, 0], axis=0),
        np.insert(elbow_m, next_tick, corners[:, 1], axis=0),
        np.insert(distance_m, next_tick, np.inf),
        np.insert(slack_m, next_tick - 1, slack_m[next_tick - 1]) if len(slack_m) else slack_m,
    )


def joint_bend_m(trace: Trace, arm: Arm | None = None) -> NDArray[np.float64]:
    """Return how far [m] the arm may deviate from linear joint motion between two ticks, shape (n-1,).

    Suppose that a joint's speed stays between its speeds at the two ticks, and that these speeds differ by
    dv. Then the joint deviates from linear motion by at most dv dt/4. This angle moves a point by at most the
    angle times the length of the chain of links that the joint moves. If the mean speed differs by a and b
    from the speeds at the two ticks, the angle is dt a b/(a + b). So the angle is 0 if the joint always turns
    at the speed of the second tick, as it does in both worlds.

    Motors that saturate may exceed the speeds at both ticks. If the world's engine did not record this
    excess, the result is infinite, unless each joint's mean speed equals its speed at the second tick.
    """
    true, world = true_motion(trace), entry_of(trace.provenance.world)
    period_s, known = trace.scenario.settings.clock.control_period_s, trace.known
    return _joint_bends(
        arm or arm_of(trace),
        true.joints_rad,
        true.rates_radps,
        trace.overshoot_radps,
        period_s,
        not (known.column("joint_position_rad").limited or known.column("joint_velocity_radps").limited),
        world is not None and world.substeps,
    )


@compiled
def _joint_bends(
    arm: Arm,
    joints_rad: NDArray[np.float64],  # (n, joints)
    rates_radps: NDArray[np.float64],  # (n, joints)
    overshoot_radps: NDArray[np.float64],  # (n, joints), or (0, joints) where nobody recorded it
    period_s: float,
    exact: bool,  # positions and speeds are known exactly
    engine: bool,  # the world has motors, which may saturate
) -> NDArray[np.float64]:
    """Return a bound [m] for each tick, shape (n-1,): dt times the sum over joints of l a b/(a + b).

    Here l is the length of the joint's chain of links. If the speeds are not exact, the term for a joint is l
    dv/4.
    """
    bends, recorded = np.zeros(max(rates_radps.shape[0] - 1, 0)), len(overshoot_radps) >= len(rates_radps)
    for k in range(bends.shape[0]):
        for joint in range(arm.chain[0].joint_axes.shape[0]):
            start, end = rates_radps[k, joint], rates_radps[k + 1, joint]
            overshoot = overshoot_radps[k, joint] if recorded else 0.0
            mean = (joints_rad[k + 1, joint] - joints_rad[k, joint]) / period_s
            below, above = (mean - min(start, end) + overshoot, max(start, end) + overshoot - mean)
            inside, angle = min(below, above) > -ROUNDING_RADPS, 0.25 * (below + above) * period_s
            # Saturated motors may turn a joint by any amount between the ticks, so no bound is known.
            if engine and not (inside if recorded else abs(mean - end) < SATURATED_RADPS):
                angle = np.inf
            # The speed stays between both ends, so the path stays in the triangle of the two extreme speeds
            # over its chord.
            elif exact and inside and below + above > 0.0:
                angle = max(below, 0.0) * max(above, 0.0) / (below + above) * period_s
            if not below + above < FASTEST_RADPS:  # or a speed is no number
                angle = np.inf
            if angle > 0.0:
                bends[k] += angle * arm.reach_m[joint]
    return bends


@compiled
def _closest_in_trace(
    arm: Arm,
    joints_rad: NDArray[np.float64],  # (n, joints)
    hands_m: NDArray[np.float64],  # (n, 3)
    elbows_m: NDArray[np.float64],  # (n, 3)
    distance_m: NDArray[np.float64],  # (n,) at the ticks, inf elsewhere
    slack_m: NDArray[np.float64],  # (n - 1,)
    hand_radius_m: float,
    forearm_radius_m: float,
    tolerance_m: float,
) -> tuple[float, int, float, float]:
    """Return the least distance [m], its place on the way, and an upper bound of the least distance.

    The place consists of the last instant before the least distance, and the fraction of the way from this
    instant to the next. The function skips stretches that cannot be nearer than the least distance so far.
    This is correct because distances change by no more than points move. A joint moves each point by at most
    the joint's angle times the length of its chain of links.
    """
    best = np.inf
    index, fraction = 0, 0.0
    for k in range(distance_m.shape[0]):
        # The stored distances first: the smaller the least so far, the more the search can skip.
        if distance_m[k] < best:
            best, index, fraction = distance_m[k], k, 0.0
    high = best
    frames = arm.chain[0].joint_axes.shape[0] + 2
    transforms, ends = np.empty((frames, 4, 4)), np.empty((arm.capsules.shape[0], 2, 3))
    workspace = np.empty((MAX_BISECTIONS + 1, arm.capsules.shape[0], 2, 3))
    k, left_m, known = 0, 0.0, False  # whether left_m is the distance at k
    while k < distance_m.shape[0] - 1:
        if not known:
            forward_kinematics(arm.chain[0], joints_rad[k], transforms)
            place_capsules(arm.capsules, transforms, ends)
            left_m, _ = hand_distance(
                arm.capsules, ends, hands_m[k], elbows_m[k], hand_radius_m, forearm_radius_m
            )
        first, known = k, False
        while k < distance_m.shape[0] - 1:
            # The distance at the last known instant falls by at most what arm and hand have moved since.
            left_m -= displacement_m(arm.reach_m, joints_rad, hands_m, elbows_m, k)
            if not left_m - slack_m[k] > high + tolerance_m:  # a NaN must come out, not be passed over
                break
            k += 1
        if k > first:
            continue
        bound, where, sampled, left_m = closest_approach_between(
            arm,
            workspace,
            joints_rad[k],
            joints_rad[k + 1],
            hands_m[k],
            hands_m[k + 1],
            elbows_m[k],
            elbows_m[k + 1],
            hand_radius_m,
            forearm_radius_m,
            tolerance_m,
            high + slack_m[k],
        )
        bound, known = bound - slack_m[k], True
        high = min(high, sampled + slack_m[k])  # between two ticks, at a corner too, joints may be elsewhere
        if not bound >= best:
            best = bound
            if bound != -np.inf:  # of an unbounded stretch, the nearest tick tells more
                index, fraction = k, where
        k += 1
    return best, index, fraction, high


@inlined
def displacement_m(
    reach_m: NDArray[np.float64],  # (joints,)
    joints_rad: NDArray[np.float64],  # (n, joints)
    hands_m: NDArray[np.float64],  # (n, 3)
    elbows_m: NDArray[np.float64],  # (n, 3)
    k: int,
) -> float:
    """Return the largest possible change [m] of a hand's distance from instant ``k`` to the next."""
    moved, hand, elbow = 0.0, 0.0, 0.0
    for i in range(reach_m.shape[0]):
        moved += abs(joints_rad[k + 1, i] - joints_rad[k, i]) * reach_m[i]
    for i in range(3):
        hand += (hands_m[k + 1, i] - hands_m[k, i]) ** 2
        elbow += (elbows_m[k + 1, i] - elbows_m[k, i]) ** 2
    return float(moved + np.sqrt(max(hand, elbow)))
