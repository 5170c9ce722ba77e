"""How far the arm is from table, object and itself, along a sequence of joint positions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from safety_harness.avoidance.own_body import wrist_distance
from safety_harness.compiled import compiled
from safety_harness.geometry.segments import segment_segment_distance
from safety_harness.properties.true_motion import capsules_of
from safety_harness.robot.description import load_arm
from safety_harness.robot.distance import place_capsules
from safety_harness.robot.kinematics import forward_kinematics
from safety_harness.simulation.cameras import object_polygon_in_base
from safety_harness.trace.trace import Trace

OBSTACLES = ("table", "object", "robot itself")
FOREARM = 3  # base, shoulder and upper arm stand there, and end where the forearm begins


def clearances_m(trace: Trace, joints_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 3) clearance from the table, the object and the robot itself at each of ``joints_rad`` (n, 6).

    Capsules enclose the links and the camera, so that no clearance is longer than the true one;
    negative in penetration (of the object, which is flat, by the radius at most).  The table is its
    plane, without end.  From table and object: forearm, wrist and camera; base, shoulder and upper arm
    stand there, and end where the forearm begins.  From the robot itself: wrist and camera from base,
    shoulder and upper arm.
    """
    arm = load_arm(trace.scenario.robot.arm_name)
    settings = trace.scenario.settings
    capsules = capsules_of(trace)
    return _clearances(
        arm.joint_origins,
        arm.joint_axes,
        arm.flange,
        capsules.link_index,
        capsules.start_in_link,
        capsules.end_in_link,
        capsules.radius_m,
        np.ascontiguousarray(joints_rad),
        settings.cell.table_height_m,
        object_polygon_in_base(settings),
    )


@compiled
def _clearances(
    joint_origins: NDArray[np.float64],
    joint_axes: NDArray[np.float64],
    flange: NDArray[np.float64],
    link_index: NDArray[np.int64],
    start_in_link: NDArray[np.float64],
    end_in_link: NDArray[np.float64],
    radius_m: NDArray[np.float64],
    joints_rad: NDArray[np.float64],
    table_m: float,
    polygon: NDArray[np.float64],  # (m, 3)
) -> NDArray[np.float64]:
    found = np.full((joints_rad.shape[0], 3), np.inf)
    transforms, placed = np.empty((8, 4, 4)), np.empty((radius_m.shape[0], 2, 3))
    for k in range(joints_rad.shape[0]):
        forward_kinematics(joint_origins, joint_axes, flange, joints_rad[k], transforms)
        place_capsules(transforms, link_index, start_in_link, end_in_link, placed)
        if np.isnan(joints_rad[k].sum()):
            found[k] = np.nan
            continue
        for capsule in range(radius_m.shape[0] - 1, -1, -1):  # the hand end first: usually the nearest
            if link_index[capsule] < FOREARM:
                continue
            start, end, radius = placed[capsule, 0], placed[capsule, 1], radius_m[capsule]
            found[k, 0] = min(found[k, 0], min(start[2], end[2]) - radius - table_m)
            if min(start[2], end[2]) - polygon[0, 2] - radius < found[k, 1]:  # it may be nearer
                found[k, 1] = min(found[k, 1], above_polygon(start, end, polygon) - radius)
        found[k, 2] = wrist_distance(placed, radius_m, link_index)
    return found


@compiled
def above_polygon(
    start: NDArray[np.float64],  # (3,)
    end: NDArray[np.float64],  # (3,), may be the start
    polygon: NDArray[np.float64],  # (m, 3) corners, one after another, all at one height
) -> float:
    """Distance [m] of a segment from a level polygon; at an edge, at an end over it, or 0 if through it."""
    height = polygon[0, 2]
    first, last = start[2] - height, end[2] - height
    least = np.inf
    for k in range(polygon.shape[0]):
        following = polygon[(k + 1) % polygon.shape[0]]
        least = min(least, segment_segment_distance(start, end, polygon[k], following))
    if _over(start[0], start[1], polygon):
        least = min(least, abs(first))
    if _over(end[0], end[1], polygon):
        least = min(least, abs(last))
    if first * last < 0.0:
        share = first / (first - last)
        if _over(start[0] + share * (end[0] - start[0]), start[1] + share * (end[1] - start[1]), polygon):
            least = 0.0
    return float(least)


@compiled
def _over(x: float, y: float, polygon: NDArray[np.float64]) -> bool:
    """Is a point within a polygon, seen from above?  Even-odd rule."""
    odd = False
    n = polygon.shape[0]
    for k in range(n):
        a, b = polygon[k], polygon[(k + 1) % n]
        if (a[1] > y) != (b[1] > y) and x < a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0]):
            odd = not odd
    return odd
