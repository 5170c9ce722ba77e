"""Compute a lower bound of the distance between a hand and the arm during the motion between two instants.

The module ``distance`` defines hand, arm and distance.
"""

from __future__ import annotations

from math import isfinite, nan, sqrt

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import compiled, inlined, njit_no_nrt
from safety_harness.base.geometry.arrays import Array2x3, Array3, ArrayN, ArrayNx2x3
from safety_harness.base.geometry.linear import copy_matrix
from safety_harness.base.geometry.segments import ROUNDING_M, segment_segment_vector
from safety_harness.cell.robot.capsules import Arm
from safety_harness.cell.robot.distance import CapsuleRecords, hand_distance, place_capsules, segment_length
from safety_harness.cell.robot.kinematics import forward_kinematics

MAX_BISECTIONS = 48  # halvings of an interval: far below any tolerance that float64 can serve


@compiled
def closest_approach_between(
    arm: Arm,
    scratch: NDArray[np.float64],  # (MAX_BISECTIONS + 1, n, 2, 3), overwritten
    q0: ArrayN,
    q1: ArrayN,
    hand0: Array3,
    hand1: Array3,
    elbow0: Array3,
    elbow1: Array3,
    hand_radius_m: float,
    forearm_radius_m: float,
    tolerance_m: float,
    not_below_m: float,
) -> tuple[float, float, float, float]:
    """Return a guaranteed lower bound [m] of ``hand_distance`` during a linear motion of joints and hand.

    As t goes from 0 to 1, the joints go from ``q0`` to ``q1`` [rad]. The hand's centre goes from ``hand0`` to
    ``hand1``, and the elbow goes from ``elbow0`` to ``elbow1``. These positions are in the base frame [m].
    The function returns four numbers: the bound, the t at which the sampled distance is least, the least
    sampled distance, and the distance at t = 1. The bound is never above the true minimum, and it is below
    the minimum by at most ``tolerance_m`` > 0. To save work, the function does not improve a bound that
    exceeds ``not_below_m``. Such a bound may be farther below the minimum. The bound is NaN if the distance
    at either end is NaN.

    The method is branch and bound, from left to right. The function halves an interval [a, b] until its bound
    is good enough:

        min d >= min d_linear - B (b - a)^2 / 8

    Here d_linear is the distance that results if all axis ends move linearly from a to b (``_linear_bound``).
    B comes from ``_bend``. A curve with |p''| <= B deviates from its chord by at most the last term.
    """
    if not tolerance_m > 0.0:
        raise ValueError("tolerance_m must be positive")
    bend = _bend(arm.reach_m, q0, q1)
    n = arm.chain[0].joint_axes.shape[0]
    transforms = np.empty((n + 2, 4, 4))
    # capsules at the left end, and at the right ends still to be reached
    left_m, right_m = scratch[MAX_BISECTIONS], scratch[:MAX_BISECTIONS]
    at = np.empty(MAX_BISECTIONS)
    joints = np.empty(n)
    hands = np.empty((3, 2, 3))  # hand and elbow at the left end, at the right end, in between
    left, t_best, best, lower, first, last = 0.0, 0.0, np.inf, np.inf, np.nan, np.nan
    depth = 0
    t_next = 0.0
    while True:
        # Sample at t_next: first 0, then 1, then the middles of intervals that must be halved.
        for i in range(n):
            joints[i] = q0[i] + t_next * (q1[i] - q0[i])
        forward_kinematics(arm.chain[0], joints, transforms)
        sample = left_m if t_next == 0.0 else right_m[depth]
        place_capsules(arm.capsules, transforms, sample)
        _hand_at(t_next, hand0, hand1, elbow0, elbow1, hands[2])
        distance, _ = hand_distance(
            arm.capsules, sample, hands[2, 0], hands[2, 1], hand_radius_m, forearm_radius_m
        )
        if not isfinite(distance):
            return nan, t_next, nan, nan
        if distance < best:
            best, t_best = distance, t_next
        if t_next == 0.0:
            first, t_next = distance, 1.0
            continue
        if t_next == 1.0:
            last = distance
            # Between the two ends every point stays within its chord and its bend.
            chord = _longest_chord(left_m, sample)
            chord += max(segment_length(hand0, hand1), segment_length(elbow0, elbow1))
            # From either end, the distance falls by at most the chord. Where both bounds are equal, each is
            # half of first + last - chord.
            coarse = 0.5 * (first + last - chord) - bend / 8.0
            if coarse > not_below_m:
                return min(coarse, best), t_best, best, last
        at[depth] = t_next
        depth += 1
        # Skip every interval whose bound is good enough.
        while depth > 0:
            right = at[depth - 1]
            _hand_at(left, hand0, hand1, elbow0, elbow1, hands[0])
            _hand_at(right, hand0, hand1, elbow0, elbow1, hands[1])
            bound = _linear_bound(
                arm.capsules, left_m, right_m[depth - 1], hands, hand_radius_m, forearm_radius_m
            )
            bound -= bend * (right - left) ** 2 / 8.0
            # Only such an interval could make the result too low by more than the tolerance.
            if bound < min(best - tolerance_m, not_below_m) and depth < MAX_BISECTIONS:
                break
            lower = min(lower, bound)
            left = right
            for capsule in range(left_m.shape[0]):
                copy_matrix(right_m[depth - 1, capsule], left_m[capsule])
            depth -= 1
        if depth == 0:
            return min(lower, best), t_best, best, last
        t_next = 0.5 * (left + at[depth - 1])


@inlined
def _longest_chord(left: ArrayNx2x3, right: ArrayNx2x3) -> float:
    """Return the longest distance [m] between corresponding axis ends in ``left`` and ``right``."""
    longest = 0.0
    for capsule in range(left.shape[0]):
        for i in range(2):
            total = 0.0
            for j in range(3):
                total += (right[capsule, i, j] - left[capsule, i, j]) ** 2
            longest = max(longest, total)
    return sqrt(longest)


@njit_no_nrt
def _hand_at(
    t: float, hand0: Array3, hand1: Array3, elbow0: Array3, elbow1: Array3, hand_out: Array2x3
) -> None:
    """Fill ``hand_out`` (2, 3) with the positions of hand and elbow at the fraction ``t`` of the motion."""
    for i in range(3):
        hand_out[0, i] = hand0[i] + t * (hand1[i] - hand0[i])
        hand_out[1, i] = elbow0[i] + t * (elbow1[i] - elbow0[i])


@njit_no_nrt
def _bend(reach_m: ArrayN, q0: ArrayN, q1: ArrayN) -> float:
    """Return a bound B [m] of |d^2 p / dt^2| for all points p on the capsules' axes and all t from 0 to 1.

    The bound is B = sum over joints i, j of |dq_i dq_j| l_max(i, j), with l from ``chain_lengths``. For i <=
    j, d^2 p / dq_i dq_j = a_i x (a_j x (p - p_j)) is at most |p - p_j|. In every joint position, the chain of
    links from joint j to p is at least as long as |p - p_j|. Over an interval of length h, a point deviates
    from its chord by at most B h^2 / 8.

    ``reach_m``, ``q0`` and ``q1`` have the shape (n,).
    """
    bend = 0.0
    for i in range(reach_m.shape[0]):
        for j in range(reach_m.shape[0]):
            bend += abs((q1[i] - q0[i]) * (q1[j] - q0[j])) * reach_m[max(i, j)]
    return bend


@compiled
def _linear_bound(
    capsules: CapsuleRecords,
    left: ArrayNx2x3,
    right: ArrayNx2x3,
    hands: NDArray[np.float64],
    hand_radius_m: float,
    forearm_radius_m: float,
) -> float:
    """Return a lower bound [m] of the hand distance while all axis ends move linearly from left to right.

    The bound is the minimum over all capsules of ``_linear_pair_bound`` less the two radii. The minimum
    includes both the hand and the forearm. ``left`` and ``right`` (n, 2, 3) are the ends of the capsules'
    axes. ``hands`` (3, 2, 3) contains hand and elbow at the left end, at the right end and at the middle. The
    function writes the middle.
    """
    for i in range(2):
        for j in range(3):
            hands[2, i, j] = 0.5 * (hands[0, i, j] + hands[1, i, j])
    middle = np.empty((2, 3))
    bound = np.inf
    forearm = segment_length(hands[2, 0], hands[2, 1])
    thickest = max(hand_radius_m, forearm_radius_m)
    for capsule in range(capsules.shape[0] - 1, -1, -1):  # the arm's end first: usually the nearest
        squared, displacement, radius_m = 0.0, 0.0, capsules[capsule].radius_m
        for i in range(2):
            for j in range(3):
                middle[i, j] = 0.5 * (left[capsule, i, j] + right[capsule, i, j])
        for j in range(3):
            offset = 0.5 * (hands[2, 0, j] + hands[2, 1, j]) - 0.5 * (middle[0, j] + middle[1, j])
            squared += offset * offset
        for i in range(2):
            for k in range(2):
                total = 0.0
                for j in range(3):
                    moved = right[capsule, i, j] - left[capsule, i, j] - (hands[1, k, j] - hands[0, k, j])
                    total += moved * moved
                displacement = max(displacement, total)
        # ``_linear_pair_bound`` of this capsule is no less than this, since every point of a segment is
        # within half the length of its middle.
        halves = 0.5 * (forearm + segment_length(middle[0], middle[1]) + sqrt(displacement))
        if sqrt(squared) - halves - thickest - radius_m - ROUNDING_M > bound:  # never of a NaN
            continue
        for points in range(1, 3):  # 1: the hand's sphere, 2: the forearm
            radius = radius_m + (hand_radius_m if points == 1 else forearm_radius_m)
            axes = _linear_pair_bound(left[capsule], right[capsule], middle, hands, points)
            bound = min(bound, axes - radius)
    return bound


@njit_no_nrt
def _linear_pair_bound(
    left: Array2x3, right: Array2x3, middle: Array2x3, hands: NDArray[np.float64], points: int
) -> float:
    """Return a lower bound [m] of the distance of two segments whose ends move linearly in an interval.

    ``left``, ``right`` and ``middle`` (2, 3) are the capsule's segment at the two ends and at the middle of
    the interval. ``hands`` (3, 2, 3) is the same as in ``_linear_bound``. ``points`` is 1 for the hand's
    centre and 2 for the forearm.

    The bound is max(0, |m| - max |u_ij(1) - u_ij(0)|/2, min dot(u_ij(t), m)/|m|). The last minimum is over
    the ends i and j and over t in {0, 1}. The vector u_ij goes from end i of the hand's segment to end j of
    the capsule's segment. The vector m is the shortest vector between the segments at the middle.

    The result is thus the largest of 0 and two bounds. The first bound is the distance at the middle, less
    half of the longest relative displacement of two ends. The second bound is the gap between the segments
    along the fixed direction of m. This gap is a minimum of functions that are linear in time, so it is
    smallest at an end of the interval.
    """
    x, y, z = segment_segment_vector(hands[2, 0], hands[2, points - 1], middle[0], middle[1])
    distance = sqrt(x * x + y * y + z * z)
    displacement = 0.0
    gap_left, gap_right = np.inf, np.inf
    for i in range(2):
        for j in range(points):
            lx = left[i, 0] - hands[0, j, 0]
            ly = left[i, 1] - hands[0, j, 1]
            lz = left[i, 2] - hands[0, j, 2]
            rx = right[i, 0] - hands[1, j, 0]
            ry = right[i, 1] - hands[1, j, 1]
            rz = right[i, 2] - hands[1, j, 2]
            gap_left = min(gap_left, lx * x + ly * y + lz * z)
            gap_right = min(gap_right, rx * x + ry * y + rz * z)
            displacement = max(displacement, (rx - lx) ** 2 + (ry - ly) ** 2 + (rz - lz) ** 2)
    bound = max(0.0, distance - 0.5 * sqrt(displacement))
    if distance > 0.0:
        bound = max(bound, min(gap_left, gap_right) / distance)
    return bound
