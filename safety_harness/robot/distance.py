"""Surface-to-surface distance between a hand and the arm's capsules, at and between instants.

A hand is a sphere about ``hand`` and a capsule about the segment from ``hand`` to ``elbow``, its
forearm.  A distance is that of the axes less both radii: negative in penetration.
"""

from __future__ import annotations

from math import isnan, nan, sqrt

import numpy as np
from numpy.typing import NDArray

from safety_harness.compiled import compiled
from safety_harness.geometry.segments import point_segment_distance, segment_segment_distance


@compiled
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
        link = transforms[link_index[capsule]]
        for i in range(3):
            placed_out[capsule, 0, i] = (
                link[i, 0] * start_in_link[capsule, 0]
                + link[i, 1] * start_in_link[capsule, 1]
                + link[i, 2] * start_in_link[capsule, 2]
                + link[i, 3]
            )
            placed_out[capsule, 1, i] = (
                link[i, 0] * end_in_link[capsule, 0]
                + link[i, 1] * end_in_link[capsule, 1]
                + link[i, 2] * end_in_link[capsule, 2]
                + link[i, 3]
            )


@compiled
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
    for capsule in range(radius_m.shape[0]):
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
