"""Compute the target of servoing: the desired TCP pose and the camera's view from there."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.elementary import product
from safety_harness.base.geometry.arrays import ArrayNx3
from safety_harness.base.geometry.rotations import rotation_from_vector
from safety_harness.base.geometry.transforms import inverse_transform, transform_from
from safety_harness.base.settings import Settings
from safety_harness.cell.perception.camera import transform_camera_to_tcp
from safety_harness.cell.robot.robots import inverse_kinematics
from safety_harness.cell.servoing.control import DesiredView, desired_view
from safety_harness.scenario.robots import AnyRobot, Robot

LOOKING_DOWN = np.diag([1.0, -1.0, -1.0])  # tcp axes in base: x forward, y right, z down


def desired_transform_tcp_to_base(settings: Settings) -> NDArray[np.float64]:
    """Return the desired TCP pose (4, 4).

    The TCP is straight above the object, and its z axis points straight down.
    """
    return transform_from(LOOKING_DOWN, np.array(settings.cell.desired_tcp_position_in_base_m))


def reachable(
    positions_in_base_m: ArrayNx3, settings: Settings, robot: AnyRobot = Robot.UR10
) -> NDArray[np.bool_]:
    """Return whether the arm can reach each position in the desired orientation, shape (n,).

    ``positions_in_base_m`` (n, 3). The function considers only joint positions within the limits of
    ``robot``. The function checks only the position, whereas the gate also checks the straight path to it.
    The orientation comes from ``settings``.
    """
    poses = np.repeat(desired_transform_tcp_to_base(settings)[None], len(positions_in_base_m), axis=0)
    poses[:, :3, 3] = positions_in_base_m
    preferred = np.array(settings.cell.preferred_joint_position_rad)
    solutions = inverse_kinematics(robot).nearest_of_each(poses, preferred)
    has: NDArray[np.bool_] = ~np.isnan(solutions[:, 0])
    return has


def desired_camera(settings: Settings) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return two transforms (4, 4) at the desired pose.

    The first is from the true camera to the base, and the second is from the object to the camera.
    """
    turn = rotation_from_vector(np.array([0.0, 0.0, settings.object.yaw_rad]))
    object_to_base = transform_from(turn, np.array(settings.object.position_in_base_m))
    camera_to_base = product(
        desired_transform_tcp_to_base(settings), transform_camera_to_tcp(settings.camera, calibrated=False)
    )
    return camera_to_base, product(inverse_transform(camera_to_base), object_to_base)


def view_of(settings: Settings) -> DesiredView:
    """Return the true camera's view of the object from the desired pose."""
    object_to_camera = desired_camera(settings)[1]
    return desired_view(np.array(settings.object.polygon_m), object_to_camera, settings.servo.object_kind)
