"""The joints along a straight way of the TCP, its orientation kept."""

from __future__ import annotations

from math import ceil, sqrt

import numpy as np
from numpy.typing import NDArray

from safety_harness.compiled import compiled
from safety_harness.robot.description import ArmModel
from safety_harness.robot.inverse import follow_pose
from safety_harness.robot.kinematics import forward_kinematics

MOST_STEPS = 4000


def straight_way(
    arm: ArmModel,
    joint_position_rad: NDArray[np.float64],
    position_in_base_m: NDArray[np.float64],
    *,
    step_m: float,
) -> NDArray[np.float64]:
    """(k, 6) joints from ``joint_position_rad`` (6,) straight to ``position_in_base_m`` (3,), k >= 1.

    Neighbouring rows are at most ``step_m`` of way apart (more on a way of over 4000 steps).  The rows
    end where the arm cannot follow continuously; position limits and singularities are not looked at.
    """
    return _straight_way(
        arm.joint_origins,
        arm.joint_axes,
        arm.flange,
        np.array(joint_position_rad, dtype=np.float64),
        np.array(position_in_base_m, dtype=np.float64),
        step_m,
    )


@compiled
def _straight_way(
    joint_origins: NDArray[np.float64],
    joint_axes: NDArray[np.float64],
    flange: NDArray[np.float64],
    start_rad: NDArray[np.float64],
    end_in_base_m: NDArray[np.float64],
    step_m: float,
) -> NDArray[np.float64]:
    transforms, jacobian = np.empty((8, 4, 4)), np.empty((6, 6))
    forward_kinematics(joint_origins, joint_axes, flange, start_rad, transforms)
    start_pose = transforms[7].copy()
    target, joints = start_pose.copy(), start_rad.copy()
    squared = 0.0
    for i in range(3):
        squared += (end_in_base_m[i] - start_pose[i, 3]) ** 2
    steps = int(min(ceil(sqrt(squared) / step_m), MOST_STEPS))
    rows = np.empty((steps + 1, 6))
    rows[0] = start_rad
    for k in range(1, steps + 1):
        for i in range(3):
            target[i, 3] = start_pose[i, 3] + k / steps * (end_in_base_m[i] - start_pose[i, 3])
        if not follow_pose(joint_origins, joint_axes, flange, target, joints, transforms, jacobian):
            return rows[:k].copy()
        rows[k] = joints
    return rows
