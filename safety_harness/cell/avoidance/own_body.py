"""Compute the distance of the arm's wrist from its body, which the gate checks along a path.

The body of an arm with n joints consists of the links up to n - 4. For six joints these are base, shoulder
and upper arm. The wrist consists of the links from number n - 2 on: three links and the TCP's frame. The
check ignores the link in between, which touches both body and wrist. If the wrist's first link is near the
body in most postures, the arm is built that way. The wrist then begins at the next link. An example is the
forearm of a Panda at its elbow.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import compiled
from safety_harness.base.geometry.segments import ROUNDING_M, axes_lower_m, segment_segment_distance
from safety_harness.cell.robot.capsules import Arm, CapsuleSet, arm_with
from safety_harness.cell.robot.description import ArmModel
from safety_harness.cell.robot.distance import place_capsules
from safety_harness.cell.robot.kinematics import forward_kinematics
from safety_harness.cell.robot.numeric_inverse import starts_of

NEAR_M = 0.020  # the least distance that the gate allows
POSTURES = 64


@lru_cache(maxsize=16)
def body_and_wrist(arm: ArmModel, capsules: CapsuleSet) -> tuple[int, int]:
    """Return the numbers of the body's last link and of the wrist's first link.

    The base is link 0.
    """
    joints = len(arm.joint_names)
    body, wrist = max(joints - 4, 0), max(joints - 2, 2)
    postures = starts_of(arm)[:POSTURES]
    while wrist < joints:
        alone = capsules.of_links({*range(body + 1), wrist})
        is_near = _own_distances(arm_with(arm, alone), body, wrist, postures) < NEAR_M
        if np.mean(is_near) <= 0.5:
            break
        wrist += 1
    return body, wrist


@compiled
def wrist_distance(
    capsules: NDArray[np.void], last: int, first: int, capsule_endpoints_in_base_m: NDArray[np.float64]
) -> float:
    """Return the least distance [m] between wrist and body.

    The wrist has the links from ``first`` on, and the body has the links up to ``last``. The result is the
    minimum of d - r_wrist - r_body over all pairs of a wrist capsule and a body capsule. Here d is the
    distance between the axes of the two capsules. ``capsules`` (n,) has the type CAPSULE, and
    ``capsule_endpoints_in_base_m`` (n, 2, 3) is the result of ``place_capsules``. The result is negative if
    the bodies overlap, and NaN if any distance is NaN.
    """
    ends = capsule_endpoints_in_base_m
    least = np.inf  # the loop skips pairs that cannot be nearer than this
    for wrist in range(capsules.shape[0]):
        if capsules[wrist].link_index < first:
            continue
        for body in range(capsules.shape[0]):
            if capsules[body].link_index > last:
                continue
            radii_m = capsules[wrist].radius_m + capsules[body].radius_m
            if axes_lower_m(ends[wrist], ends[body]) - radii_m - ROUNDING_M > least:  # never of a NaN
                continue
            axes = segment_segment_distance(ends[wrist, 0], ends[wrist, 1], ends[body, 0], ends[body, 1])
            distance = axes - capsules[wrist].radius_m - capsules[body].radius_m
            if not distance >= least:  # true of NaN too, and every comparison with NaN is false
                least = distance
                if np.isnan(least):
                    return float(least)
    return float(least)


def own_distances(
    arm: ArmModel, capsules: CapsuleSet, joint_positions_rad: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the ``wrist_distance`` [m] of ``arm`` at each joint position, shape (m,).

    ``joint_positions_rad`` has the shape (m, n).
    """
    return _own_distances(arm_with(arm, capsules), *body_and_wrist(arm, capsules), joint_positions_rad)


@compiled
def _own_distances(
    arm: Arm, last: int, first: int, joint_positions_rad: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the ``wrist_distance`` [m] at each joint position, shape (m,).

    ``joint_positions_rad`` has the shape (m, n).
    """
    frames = arm.reach_m.shape[0] + 2  # records of ``chain`` have no attributes without compilation
    transforms, ends = np.empty((frames, 4, 4)), np.empty((arm.capsules.shape[0], 2, 3))
    distances = np.empty(joint_positions_rad.shape[0])
    for k in range(distances.shape[0]):
        forward_kinematics(arm.chain[0], joint_positions_rad[k], transforms)
        place_capsules(arm.capsules, transforms, ends)
        distances[k] = wrist_distance(arm.capsules, last, first, ends)
    return distances
