"""Compute the distance between a hand and the arm's capsules at an instant.

A hand is a sphere about ``hand`` with a forearm. The forearm is a capsule about the segment from ``hand`` to
``elbow``. The distance of two bodies is the distance of their axes less both radii, so it is negative if the
bodies overlap.
"""

from __future__ import annotations

from math import isnan, nan, sqrt

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import compiled, inlined, njit_no_nrt
from safety_harness.base.geometry.arrays import Array3, ArrayNx2x3, ArrayNx4x4
from safety_harness.base.geometry.segments import point_segment_distance, segment_segment_distance
from safety_harness.cell.robot.description import ChainRecords

CAPSULE = np.dtype(
    [
        ("link_index", np.int64),
        ("start_in_link", np.float64, (3,)),
        ("end_in_link", np.float64, (3,)),
        ("radius_m", np.float64),
    ],
    align=True,
)
CapsuleRecords = NDArray[np.void]  # (n,) CAPSULE


@inlined
def place_capsules(
    capsules: CapsuleRecords, transforms: ArrayNx4x4, capsule_endpoints_in_base_m_out: ArrayNx2x3
) -> None:
    """Fill ``capsule_endpoints_in_base_m_out`` (n, 2, 3) with the axis ends of the records ``capsules`` (n,).

    The start and the end of each axis follow from p_base = T_link p_link. The ``transforms`` T (n + 2, 4, 4)
    come from ``forward_kinematics`` for n joints.
    """
    for k in range(capsules.shape[0]):
        capsule = capsules[k]
        start, end, link = capsule.start_in_link, capsule.end_in_link, capsule.link_index
        for i in range(3):
            x, y, z = transforms[link, i, 0], transforms[link, i, 1], transforms[link, i, 2]
            origin = transforms[link, i, 3]
            capsule_endpoints_in_base_m_out[k, 0, i] = x * start[0] + y * start[1] + z * start[2] + origin
            capsule_endpoints_in_base_m_out[k, 1, i] = x * end[0] + y * end[1] + z * end[2] + origin


@njit_no_nrt
def hand_distance(
    capsules: CapsuleRecords,
    capsule_endpoints_in_base_m: ArrayNx2x3,
    hand: Array3,
    elbow: Array3,
    hand_radius_m: float,
    forearm_radius_m: float,
) -> tuple[float, int]:
    """Return the distance [m] of hand and forearm from the nearest capsule, and the index of that capsule.

    The distance is min over capsules c of min(|h, c| - r_h, |h e, c| - r_f) - r_c. Here |., .| is the
    distance of a point or segment from an axis, and r are the radii of hand, forearm and capsule.
    ``capsules`` (n,) contains records CAPSULE, and ``capsule_endpoints_in_base_m`` (n, 2, 3) comes from
    ``place_capsules``. ``hand`` h and ``elbow`` e are positions (3,) [m] in the base frame. If the distance
    of a capsule is NaN, the function returns NaN with the index of that capsule.
    """
    last = capsules.shape[0] - 1  # the arm's end first: usually the nearest
    return hand_distance_from(
        capsules, capsule_endpoints_in_base_m, hand, elbow, hand_radius_m, forearm_radius_m, last
    )


@njit_no_nrt
def hand_distance_from(
    capsules: CapsuleRecords,
    capsule_endpoints_in_base_m: ArrayNx2x3,
    hand: Array3,
    elbow: Array3,
    hand_radius_m: float,
    forearm_radius_m: float,
    likely: int,
) -> tuple[float, int]:
    """Return the result of ``hand_distance``.

    The function needs less work if ``likely`` is the nearest capsule. A bound on the distance of the
    remaining capsules then lets the function skip most of them.
    """
    best = np.inf
    nearest = -1
    thickest = max(hand_radius_m, forearm_radius_m)
    forearm_half = 0.5 * segment_length(hand, elbow)
    for turn in range(capsules.shape[0], -1, -1):
        # The first turn is for the likely nearest capsule, so that its distance excludes most others.
        capsule = likely if turn == capsules.shape[0] else turn
        if turn == likely or capsule < 0:
            continue
        # No point of a segment is farther from its middle than half its length.
        centres_squared, squared = 0.0, 0.0
        for i in range(3):
            start_i = capsule_endpoints_in_base_m[capsule, 0, i]
            end_i = capsule_endpoints_in_base_m[capsule, 1, i]
            centres_squared += (0.5 * (hand[i] + elbow[i]) - 0.5 * (start_i + end_i)) ** 2
            squared += (end_i - start_i) * (end_i - start_i)
        radius_m = capsules[capsule].radius_m
        reach = best + forearm_half + 0.5 * sqrt(squared) + thickest + radius_m
        if reach < 0.0 or centres_squared > reach * reach:  # never true of a NaN
            continue
        start, end = capsule_endpoints_in_base_m[capsule, 0], capsule_endpoints_in_base_m[capsule, 1]
        to_hand = point_segment_distance(hand, start, end) - hand_radius_m
        to_forearm = segment_segment_distance(hand, elbow, start, end) - forearm_radius_m
        distance = min(to_hand, to_forearm) - radius_m
        if isnan(to_hand + to_forearm + distance):
            if turn < capsules.shape[0]:
                return nan, capsule
            likely = -1  # search again in order, to return the first capsule with NaN
        # Of equal distances the capsule with the larger index wins, so the result does not depend on
        # ``likely``.
        elif distance < best or (distance == best and capsule > nearest):
            best = distance
            nearest = capsule
    return best, nearest


@inlined
def segment_length(start: Array3, end: Array3) -> float:
    """Return the length [m] of a segment."""
    x, y, z = end[0] - start[0], end[1] - start[1], end[2] - start[2]
    return sqrt(x * x + y * y + z * z)


@compiled
def chain_lengths(chains: ChainRecords, capsules: CapsuleRecords) -> NDArray[np.float64]:
    """Return the greatest length [m] of the chain from each joint to a capsule, shape (n,).

    The function considers the capsules that the joint moves.

    The length l_j is the maximum of |p| + sum of |o_i| over all capsules and their ends p. The sum includes
    the joints i between joint j and the capsule's link. Here o_i is the step from joint i - 1 to i. In any
    joint position, the distance of p from joint j is at most l_j. ``chains`` (1,) is the record of a chain
    with n joints, and ``capsules`` (m,) contains records CAPSULE.
    """
    origins, flange = chains[0].joint_origins, chains[0].flange
    n = origins.shape[0]
    longest = np.zeros(n)  # from joint j to any point that it moves
    for k in range(capsules.shape[0]):
        capsule = capsules[k]
        start = end = length = 0.0
        for i in range(3):
            start += capsule.start_in_link[i] ** 2
            end += capsule.end_in_link[i] ** 2
        length = sqrt(max(start, end))
        # The tool's capsules are in the TCP frame, so their chain includes the flange.
        if capsule.link_index == n + 1:
            length += sqrt(flange[0, 3] ** 2 + flange[1, 3] ** 2 + flange[2, 3] ** 2)
        for joint in range(min(capsule.link_index, n) - 1, -1, -1):
            longest[joint] = max(longest[joint], length)
            x, y, z = origins[joint, 0, 3], origins[joint, 1, 3], origins[joint, 2, 3]
            length += sqrt(x * x + y * y + z * z)
    return longest
