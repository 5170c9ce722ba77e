"""Speed and separation monitoring: a moving arm must be able to stop before it reaches any human.

The required distance is the protective separation distance S_p of ISO/TS 15066. It is computed term by term
for every pair of robot and human.

S_p = S_h + S_r + S_s + C + Z_d + Z_r. S_h is the distance that the human moves until the robot has stopped.
S_r is the distance that the robot moves in its reaction time, and S_s is the distance that it moves while it
brakes. C is the distance by which a body part can intrude towards the robot before the sensor detects it. Z_d
and Z_r are the uncertainties of the human's and the robot's position.

A pair is one capsule of the arm and one body of a hand: its sphere or its forearm. The speeds of a pair are
those of its two nearest points, along the line between them. The robot's speed is the rate at which the
distance would shrink if the human did not move. If a point moves away, its speed is set to zero.

``least_separation`` finds the pair with the least margin in a run, in compiled code. For every pair,
``least_separation`` computes the margin or a bound of the margin.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import compiled, inlined
from safety_harness.base.geometry.segments import ROUNDING_M, axes_lower_m, nearest_of_segments
from safety_harness.cell.robot.capsules import Arm
from safety_harness.cell.robot.distance import place_capsules
from safety_harness.cell.robot.kinematics import fastest_end, forward_kinematics, link_twists, point_velocity

REACHING_MPS = 2.0  # ISO 13855, for a hand that reaches from close by
WALKING_MPS = 1.6  # ISO 13855 and ISO/TS 15066, for a person who walks; what edition 1 of the claims assumed
ASSUMED = (
    ("S_h", "the way of the person until the robot stands, v_h (T_r + T_s)"),
    ("S_r", "the way of the robot towards the person during its reaction time, v_r T_r"),
    ("S_s", "the way of the robot while it brakes uniformly, v_r T_s/2"),
    ("C", "zero, because the distance is measured from the true surfaces of hand and forearm"),
    ("Z_d", "the way of the person between two control ticks, where no position is known, |v| dt/2"),
    ("Z_r", "the way of the robot between two control ticks; its capsules enclose its meshes"),
)


@dataclass(frozen=True, kw_only=True)
class Term:
    """A term of S_p, with its length [m] and the assumption behind it."""

    symbol: str
    length_m: float
    assumption: str


@dataclass(frozen=True, kw_only=True)
class Separation:
    """A pair at a tick: its distance, and the terms of the protective separation distance that applies to it.

    ``robot_speed_mps`` and ``hand_speed_mps`` are the speeds of robot and hand towards each other.
    ``reaction_time_s`` and ``stop_time_s`` are the remaining reaction time and stop time. ``hand_moves_m``
    and ``robot_moves_m`` are the distances that the nearest points move in half a control period.
    """

    tick: int
    hand: int
    capsule: int
    forearm: bool
    distance_m: float
    robot_speed_mps: float
    hand_speed_mps: float
    reaction_time_s: float
    stop_time_s: float
    hand_moves_m: float
    robot_moves_m: float

    @property
    def terms(self) -> tuple[Term, ...]:
        """Return the six terms of S_p, in the order of ``ASSUMED``."""
        term_lengths = lengths(
            self.hand_speed_mps,
            self.robot_speed_mps,
            self.reaction_time_s,
            self.stop_time_s,
            self.hand_moves_m,
            self.robot_moves_m,
        )
        return tuple(
            Term(symbol=symbol, length_m=length, assumption=assumption)
            for (symbol, assumption), length in zip(ASSUMED, term_lengths, strict=True)
        )

    @property
    def required_m(self) -> float:
        """Return S_p [m] of the pair."""
        return sum(term.length_m for term in self.terms)

    @property
    def margin_m(self) -> float:
        """Return the distance of the pair less S_p [m]."""
        return self.distance_m - self.required_m


@compiled
def lengths(
    hand_speed_mps: float,
    robot_speed_mps: float,
    reaction_time_s: float,
    stop_time_s: float,
    hand_moves_m: float,
    robot_moves_m: float,
) -> tuple[float, float, float, float, float, float]:
    """Return the lengths [m] of the six terms, in the order of ``ASSUMED``."""
    return (
        hand_speed_mps * (reaction_time_s + stop_time_s),
        robot_speed_mps * reaction_time_s,
        0.5 * robot_speed_mps * stop_time_s,
        0.0,
        hand_moves_m,
        robot_moves_m,
    )


@compiled
def least_separation(
    arm: Arm,
    judged: NDArray[np.bool_],  # (n,) which ticks count
    joints_rad: NDArray[np.float64],  # (n, joints)
    rates_radps: NDArray[np.float64],  # (n, joints)
    present: NDArray[np.bool_],  # (n, hands)
    hands_m: NDArray[np.float64],  # (n, hands, 2, 3): hand and elbow
    reaction_s: NDArray[np.float64],  # (n,) what is left of the reaction time
    stop_s: NDArray[np.float64],  # (n,) and of the stop time
    body_radius_m: NDArray[np.float64],  # (2,): hand and forearm
    hand_speed_mps: float,  # constant, or NaN for each hand's own
    period_s: float,
    arm_step_m: NDArray[np.float64],  # (n,) of ``farthest_steps``, as the next
    hand_step_m: NDArray[np.float64],  # (n,)
    first_look: int,  # a tick whose margin is likely to be small: for less work, the answer is the same
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return the pair with the least margin, or the first such pair if margins are equal.

    The first result (4,) is tick, hand, capsule and body. The body 1 is the forearm, and the tick -1 means
    that there is no pair. The second result (5,) is the distance [m], v_r, v_h, and how far [m] the hand's
    and the robot's nearest points move in half a period.

    The search skips ticks and pairs that cannot have a smaller margin than the least so far. This is correct
    because no distance changes by more than the points move, and because no point of a body is faster than
    the faster end of the body. The search does not use the distances that the trace stores.
    """
    indices, values = np.full(4, -1), np.full(5, np.nan)
    joints, capsules = arm.chain[0].joint_axes.shape[0], arm.capsules.shape[0]
    transforms, ends = np.empty((joints + 2, 4, 4)), np.empty((capsules, 2, 3))
    twists, fastest_mps, velocities = np.empty((joints + 1, 6)), np.empty(capsules), np.empty((2, 3))
    direction, robot, human = np.empty(3), np.empty(3), np.empty(3)
    thickest_m = max(body_radius_m[0], body_radius_m[1])
    least, good_enough = np.inf, np.inf
    looked, near_m, arm_mps = 0, -np.inf, np.inf  # the last tick with all pairs computed, and its result
    for step in range(-1, judged.shape[0]):
        k = step if step >= 0 else first_look
        if step > 0:
            # Since the last look, distances have fallen by at most what arm and hands have moved.
            near_m -= arm_step_m[k - 1] + hand_step_m[k - 1]
        elif step == 0:
            near_m, least = -np.inf, np.inf  # the first look counts again when its tick comes
        if not judged[k]:
            continue
        human_mps = hand_step_m[k] / period_s
        v_h = human_mps if np.isnan(hand_speed_mps) else hand_speed_mps
        # Upper bounds of the human's and the robot's terms of S_p. A tick or a pair whose margin is too large
        # even with them is skipped.
        most_human_m = max(v_h * (reaction_s[k] + stop_s[k]), 0.0) + 0.5 * period_s * human_mps
        per_speed_s = max(reaction_s[k] + 0.5 * stop_s[k], 0.0) + 0.5 * period_s
        # The bound without the arm's speed comes first, because ``faster_mps`` takes longer.
        if near_m - most_human_m > good_enough:
            arm_now_mps = arm_mps + faster_mps(arm, joints_rad, rates_radps, looked, k)
            if near_m - most_human_m - per_speed_s * arm_now_mps > good_enough + ROUNDING_M:
                continue  # never for a NaN, which must come out
        forward_kinematics(arm.chain[0], joints_rad[k], transforms)
        place_capsules(arm.capsules, transforms, ends)
        link_twists(arm.chain[0].joint_axes, transforms, rates_radps[k], twists)
        looked, near_m, arm_mps = k, np.inf, 0.0
        for capsule in range(capsules):
            link = min(arm.capsules[capsule].link_index, joints)
            fastest_mps[capsule] = fastest_end(twists[link], ends[capsule])
            if not fastest_mps[capsule] <= arm_mps:
                arm_mps = fastest_mps[capsule]
        for hand in range(present.shape[1]):
            if not present[k, hand]:
                continue
            for body in range(2):
                for i in range(3):
                    velocities[body, i] = _speed(hands_m, period_s, k, hand, body, i)
            for capsule in range(capsules):
                radius_m = arm.capsules[capsule].radius_m
                most_arm_m = per_speed_s * fastest_mps[capsule] + ROUNDING_M
                # The bound needs no nearest points, and excludes most pairs.
                lower_m = axes_lower_m(hands_m[k, hand], ends[capsule]) - radius_m - thickest_m
                if lower_m - most_human_m - most_arm_m > good_enough:
                    near_m = min(near_m, lower_m)
                    continue
                for body in range(2):
                    start, end = hands_m[k, hand, 0], hands_m[k, hand, body]
                    _, _, _, s, t = nearest_of_segments(start, end, ends[capsule, 0], ends[capsule, 1])
                    total = 0.0
                    for i in range(3):
                        robot[i] = ends[capsule, 0, i]
                        robot[i] += t * (ends[capsule, 1, i] - ends[capsule, 0, i])
                        direction[i] = start[i] + s * (end[i] - start[i]) - robot[i]
                        total += direction[i] * direction[i]
                        human[i] = velocities[0, i]
                        human[i] += s * (velocities[body, i] - velocities[0, i])
                    axes = sqrt(total)
                    distance = axes - radius_m - body_radius_m[body]
                    near_m = min(near_m, distance)
                    own_speed = _along(human, direction, -axes)
                    hand_speed = own_speed if np.isnan(hand_speed_mps) else hand_speed_mps
                    hand_moves = 0.5 * period_s * sqrt(human[0] ** 2 + human[1] ** 2 + human[2] ** 2)
                    human_m = hand_speed * (reaction_s[k] + stop_s[k]) + hand_moves
                    if distance - human_m - most_arm_m > good_enough:
                        continue
                    link = min(arm.capsules[capsule].link_index, joints)
                    robot[0], robot[1], robot[2] = point_velocity(twists[link], robot)
                    robot_speed = _along(robot, direction, axes)
                    robot_moves = 0.5 * period_s * sqrt(robot[0] ** 2 + robot[1] ** 2 + robot[2] ** 2)
                    needed = 0.0
                    for length in lengths(
                        hand_speed, robot_speed, reaction_s[k], stop_s[k], hand_moves, robot_moves
                    ):
                        needed += length
                    if not distance - needed >= least:  # a NaN comes out, and nothing is less than it
                        least = distance - needed
                        good_enough = min(good_enough, least)
                        indices[0], indices[1], indices[2], indices[3] = k, hand, capsule, body
                        values[0], values[1], values[2] = distance, robot_speed, hand_speed
                        values[3], values[4] = hand_moves, robot_moves
                        if np.isnan(least) and step >= 0:
                            return indices, values
    return indices, values


@compiled
def farthest_steps(
    arm: Arm,
    joints_rad: NDArray[np.float64],  # (n, joints)
    hands_m: NDArray[np.float64],  # (n, hands, 2, 3)
    present: NDArray[np.bool_],  # (n, hands)
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return bounds [m] of the motion of points until the next tick, for the arm (n,) and for the hands (n,).

    The value for hands is infinite if a hand appears or leaves. The last tick has the values of the tick
    before it, as for velocities.
    """
    n, joints = joints_rad.shape[0], arm.chain[0].joint_axes.shape[0]
    arm_step_m, hand_step_m = np.zeros(n), np.zeros(n)
    for k in range(n - 1):
        farthest = 0.0
        for i in range(joints):
            arm_step_m[k] += abs(joints_rad[k + 1, i] - joints_rad[k, i]) * arm.reach_m[i]
        for hand in range(hands_m.shape[1]):
            # A hand that appears may be anywhere, so the search must look at the next tick.
            if present[k, hand] != present[k + 1, hand]:
                farthest = np.inf
            if not (present[k, hand] and present[k + 1, hand]):
                continue  # values of an absent hand need not be numbers
            for body in range(2):
                total = 0.0
                for i in range(3):
                    total += (hands_m[k + 1, hand, body, i] - hands_m[k, hand, body, i]) ** 2
                if not total <= farthest:
                    farthest = total
        hand_step_m[k] = sqrt(farthest)
    if n > 1:
        arm_step_m[n - 1], hand_step_m[n - 1] = arm_step_m[n - 2], hand_step_m[n - 2]
    return arm_step_m, hand_step_m


@inlined
def _speed(hands_m: NDArray[np.float64], period_s: float, k: int, hand: int, body: int, i: int) -> float:
    """Return a hand's or forearm's mean velocity [m/s] along axis ``i`` in the period after tick ``k``.

    For the last tick, the last period is used. ``hands_m`` has the shape (n, hands, 2, 3).
    """
    n = hands_m.shape[0]
    if n < 2:
        return 0.0
    tick = min(k, n - 2)
    return float((hands_m[tick + 1, hand, body, i] - hands_m[tick, hand, body, i]) / period_s)


@inlined
def faster_mps(
    arm: Arm,
    joints_rad: NDArray[np.float64],  # (n, joints)
    rates_radps: NDArray[np.float64],  # (n, joints)
    a: int,
    b: int,
) -> float:
    """Return how much faster [m/s] a point of the arm can be at tick b than at tick a.

    This bound is the sum over joints j of |q'_j(b) - q'_j(a)| l_j + |q'_j(b)| sum over i of |q_i(b) - q_i(a)|
    l_max(i, j). It holds because the velocity of a point p is the sum over j of q'_j dp/dq_j. The size of the
    first derivative, dp/dq_j, is at most the length l_j of the chain of links from joint j to p. The size of
    the second derivative, d^2 p/dq_i dq_j, is at most the length from the outer joint of i and j to p.
    """
    faster, distal, proximal = 0.0, 0.0, 0.0  # sums of turns times lengths beyond j, and of turns up to j
    joints, reach_m = arm.chain[0].joint_axes.shape[0], arm.reach_m
    for i in range(joints):
        distal += abs(joints_rad[b, i] - joints_rad[a, i]) * reach_m[i]
    for j in range(joints):
        turn = abs(joints_rad[b, j] - joints_rad[a, j])
        proximal += turn
        distal -= turn * reach_m[j]
        faster += abs(rates_radps[b, j] - rates_radps[a, j]) * reach_m[j]
        faster += abs(rates_radps[b, j]) * (proximal * reach_m[j] + distal)
    return faster


@compiled
def _along(velocity: NDArray[np.float64], displacement: NDArray[np.float64], length: float) -> float:
    """Return the component of ``velocity`` (3,) along ``displacement``/``length``, or 0 if it is negative.

    If ``length`` is 0, return the size of ``velocity``. ``displacement`` is (3,).
    """
    if length == 0.0:
        return sqrt(velocity[0] ** 2 + velocity[1] ** 2 + velocity[2] ** 2)
    total = velocity[0] * displacement[0] + velocity[1] * displacement[1] + velocity[2] * displacement[2]
    return float(max(total / length, 0.0))
