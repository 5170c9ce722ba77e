"""Surface-to-surface distance between a hand and the arm's capsules, at an instant.

A hand is a sphere about ``hand`` and a capsule about the segment from ``hand`` to ``elbow``, its
forearm.  A distance is that of the axes less both radii: negative in penetration.
"""

from __future__ import annotations

from math import isnan, nan, sqrt

import numpy as np
from numpy.typing import NDArray

from safety_harness.compiled import compiled, inlined, njit_no_nrt
from safety_harness.geometry.segments import (
    point_segment_distance,
    segment_segment_distance,
)


@inlined
def place_capsules(
    transforms: NDArray[np.float64],
    link_index: NDArray[np.int64],
    start_in_link: NDArray[np.float64],
    end_in_link: NDArray[np.float64],
    placed_out: NDArray[np.float64],
) -> None:
    """Fill ``placed_out`` (n, 2, 3) with both axis ends of every capsule in the base frame [m].

    ``transforms`` (8, 4, 4) are those of ``forward_kinematics``.
    """
    for capsule in range(link_index.shape[0]):
        link = link_index[capsule]
        for i in range(3):
            x, y, z = transforms[link, i, 0], transforms[link, i, 1], transforms[link, i, 2]
            placed_out[capsule, 0, i] = (
                x * start_in_link[capsule, 0]
                + y * start_in_link[capsule, 1]
                + z * start_in_link[capsule, 2]
                + transforms[link, i, 3]
            )
            placed_out[capsule, 1, i] = (
                x * end_in_link[capsule, 0]
                + y * end_in_link[capsule, 1]
                + z * end_in_link[capsule, 2]
                + transforms[link, i, 3]
            )


@njit_no_nrt
def hand_distance(
    placed: NDArray[np.float64],
    radius_m: NDArray[np.float64],
    hand: NDArray[np.float64],
    elbow: NDArray[np.float64],
    hand_radius_m: float,
    forearm_radius_m: float,
) -> tuple[float, int]:
    """Least distance [m] of a hand and its forearm from all capsules, and the nearest capsule's index.

    ``placed`` (n, 2, 3) as ``place_capsules`` fills it, ``radius_m`` (n,), ``hand`` and ``elbow``
    (3,) in the base frame.  NaN (with the capsule that gave it) if anything read is NaN.
    """
    best = np.inf
    nearest = -1
    thickest = max(hand_radius_m, forearm_radius_m)
    forearm_half = 0.5 * segment_length(hand, elbow)
    for capsule in range(radius_m.shape[0] - 1, -1, -1):  # the hand end first: usually the nearest
        # No point of a segment is farther from its middle than half its length.
        between, squared = 0.0, 0.0
        for i in range(3):
            start_i, end_i = placed[capsule, 0, i], placed[capsule, 1, i]
            between += (0.5 * (hand[i] + elbow[i]) - 0.5 * (start_i + end_i)) ** 2
            squared += (end_i - start_i) * (end_i - start_i)
        spread = forearm_half + 0.5 * sqrt(squared) + thickest + radius_m[capsule]
        if sqrt(between) - spread >= best:  # never true of a NaN
            continue
        start, end = placed[capsule, 0], placed[capsule, 1]
        to_hand = point_segment_distance(hand, start, end) - hand_radius_m
        to_forearm = segment_segment_distance(hand, elbow, start, end) - forearm_radius_m
        distance = min(to_hand, to_forearm) - radius_m[capsule]
        if isnan(to_hand + to_forearm + distance):
            return nan, capsule
        if distance < best:
            best = distance
            nearest = capsule
    return best, nearest


@inlined
def segment_length(start: NDArray[np.float64], end: NDArray[np.float64]) -> float:
    """The length [m] of a segment, ends (3,) each."""
    x, y, z = end[0] - start[0], end[1] - start[1], end[2] - start[2]
    return sqrt(x * x + y * y + z * z)


@compiled
def chain_lengths(
    joint_origins: NDArray[np.float64],
    flange: NDArray[np.float64],
    link_index: NDArray[np.int64],
    start_in_link: NDArray[np.float64],
    end_in_link: NDArray[np.float64],
) -> NDArray[np.float64]:
    """(6,) lengths [m] of the chain of links from each joint to the farthest capsule axis that it moves."""
    longest = np.zeros(6)  # from joint j to any point that it moves
    for capsule in range(link_index.shape[0]):
        link = link_index[capsule]
        start = end = chain = 0.0
        for i in range(3):
            start += start_in_link[capsule, i] ** 2
            end += end_in_link[capsule, i] ** 2
        chain = sqrt(max(start, end))
        if link == 7:
            chain += sqrt(flange[0, 3] ** 2 + flange[1, 3] ** 2 + flange[2, 3] ** 2)
        for joint in range(min(link, 6) - 1, -1, -1):
            longest[joint] = max(longest[joint], chain)
            x, y, z = joint_origins[joint, 0, 3], joint_origins[joint, 1, 3], joint_origins[joint, 2, 3]
            chain += sqrt(x * x + y * y + z * z)
    return longest
