"""Compute the distance of the arm from the boxes in its cell."""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import compiled, inlined
from safety_harness.base.geometry.arrays import Array3, ArrayN, ArrayNx2x3
from safety_harness.base.geometry.rotations import rotation_from_vector
from safety_harness.base.geometry.transforms import inverse_transform, transform_from
from safety_harness.cell.robot.capsules import Arm, CapsuleSet, arm_with
from safety_harness.cell.robot.description import ArmModel
from safety_harness.cell.robot.distance import CapsuleRecords, place_capsules
from safety_harness.cell.robot.kinematics import forward_kinematics
from safety_harness.scenario.obstacles import Obstacle

BOX = np.dtype([("transform_base_to_box", np.float64, (4, 4)), ("half_m", np.float64, (3,))], align=True)
BoxRecords = NDArray[np.void]  # (n,) BOX
HALVINGS = 60
# With this ratio, one of the two inner points serves again after each section.
GOLDEN = 0.5 * (sqrt(5.0) - 1.0)


def box_records(obstacles: Sequence[Obstacle]) -> BoxRecords:
    """Return the read-only records BOX of the obstacles, (n,)."""
    boxes = np.zeros(len(obstacles), BOX)
    for box, obstacle in zip(boxes, obstacles, strict=True):
        turn = rotation_from_vector(np.array([0.0, 0.0, obstacle.yaw_rad]))
        pose = transform_from(turn, np.array(obstacle.position_in_base_m))
        box["transform_base_to_box"] = inverse_transform(pose)
        box["half_m"] = 0.5 * np.array(obstacle.size_m)
    boxes.setflags(write=False)
    return boxes


def distance_from(
    boxes: BoxRecords, arm: ArmModel, capsules: CapsuleSet, joint_position_rad: ArrayN
) -> float:
    """Return the ``obstacle_distance`` [m] of an arm at a joint position, or infinity without boxes.

    Args:
        boxes: The records BOX (n,) from ``box_records``.
        arm: The arm.
        capsules: The capsules that enclose the arm.
        joint_position_rad: The arm's joint position (n,).

    """
    if len(boxes) == 0:
        return np.inf
    (distance_m,) = distances_m(arm_with(arm, capsules), boxes, np.array(joint_position_rad)[None])
    return float(distance_m)


@compiled
def distances_m(arm: Arm, boxes: BoxRecords, joints_rad: NDArray[np.float64]) -> ArrayN:
    """Return the ``obstacle_distance`` [m] at each row of ``joints_rad`` (n, joints), shape (n,).

    A row with NaN gives NaN.
    """
    distances = np.full(joints_rad.shape[0], np.nan)
    transforms, ends = np.empty((arm.reach_m.shape[0] + 2, 4, 4)), np.empty((arm.capsules.shape[0], 2, 3))
    for k in range(joints_rad.shape[0]):
        forward_kinematics(arm.chain[0], joints_rad[k], transforms)
        place_capsules(arm.capsules, transforms, ends)
        if not np.isnan(joints_rad[k].sum()):
            distances[k] = obstacle_distance(boxes, arm.capsules, ends)
    return distances


@compiled
def obstacle_distance(
    boxes: BoxRecords, capsules: CapsuleRecords, capsule_endpoints_in_base_m: ArrayNx2x3
) -> float:
    """Return the least distance [m] of the moving links' capsules from the boxes, or infinity without boxes.

    Let d be the distance of a capsule's axis from a box, and let r be the capsule's radius. The result is the
    minimum of d - r over all capsules and boxes. If an axis reaches into a box, d is 0, no matter how deep
    the axis is inside. The function ignores the base, which stands still. The result is NaN if any distance
    is NaN. ``capsules`` (n,) contains records CAPSULE, and ``capsule_endpoints_in_base_m`` has the shape (n,
    2, 3).
    """
    least = np.inf
    for b in range(boxes.shape[0]):
        for k in range(capsules.shape[0]):
            if capsules[k].link_index == 0:
                continue
            start, end = capsule_endpoints_in_base_m[k, 0], capsule_endpoints_in_base_m[k, 1]
            distance = segment_box_distance(boxes, b, start, end) - capsules[k].radius_m
            if not distance >= least:  # lets a NaN replace ``least``, and no number is less than a NaN
                least = distance
                if np.isnan(least):
                    return float(least)
    return float(least)


@compiled
def segment_box_distance(boxes: BoxRecords, b: int, start: Array3, end: Array3) -> float:
    """Return the distance [m] of a segment from box ``b``, or 0 if the segment reaches into the box.

    ``start`` and ``end`` (3,) are in the base frame. The distance from a convex body is a convex function
    along a segment. So a search by 60 golden sections finds its least value, with an error of 1e-12 of the
    segment's length. (Boyd and Vandenberghe, Convex Optimization, 2004, 3.2.)
    """
    low, high = 0.0, 1.0
    inner, outer = high - GOLDEN * (high - low), low + GOLDEN * (high - low)
    at_inner, at_outer = _away(boxes, b, start, end, inner), _away(boxes, b, start, end, outer)
    # The search never reaches the ends of the segment exactly.
    least = min(_away(boxes, b, start, end, 0.0), _away(boxes, b, start, end, 1.0))
    for _ in range(HALVINGS):
        if at_inner <= at_outer:
            high, outer, at_outer = outer, inner, at_inner
            inner = high - GOLDEN * (high - low)
            at_inner = _away(boxes, b, start, end, inner)
        else:
            low, inner, at_inner = inner, outer, at_outer
            outer = low + GOLDEN * (high - low)
            at_outer = _away(boxes, b, start, end, outer)
    if np.isnan(at_inner + at_outer):
        return np.nan
    return float(min(least, at_inner, at_outer))


@inlined
def _away(boxes: BoxRecords, b: int, start: Array3, end: Array3, share: float) -> float:
    """Return the distance [m] between box ``b`` and the point at the fraction ``share`` of the segment."""
    squared = 0.0
    for i in range(3):
        local = boxes[b].transform_base_to_box[i, 3]
        for j in range(3):
            local += boxes[b].transform_base_to_box[i, j] * (start[j] + share * (end[j] - start[j]))
        outside = max(abs(local) - boxes[b].half_m[i], 0.0)
        squared += outside * outside
    return sqrt(squared)
