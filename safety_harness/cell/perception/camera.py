"""The eye-in-hand camera: a pinhole without distortion, its mount, and what it sees of the object.

Normalised coordinates are x = X/Z, y = Y/Z; pixels are u = f x + c_u, v = f y + c_v, and the centre
of pixel (0, 0) has the coordinates (0, 0) (docs/conventions.md).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import njit_no_nrt
from safety_harness.base.geometry.rotations import rotation_from_vector
from safety_harness.base.geometry.transforms import transform_from
from safety_harness.base.settings import Camera

NEAR_PLANE_M = 0.01  # nothing nearer than this is in focus, or in front of the lens at all
BORDER_PX = 1.0  # an object that reaches this far into the border may be cropped


@njit_no_nrt
def principal_point_px(width_px: int, height_px: int) -> tuple[float, float]:
    """(c_u, c_v): the middle of the image, where pixel centres are integers."""
    return 0.5 * (width_px - 1), 0.5 * (height_px - 1)


def transform_camera_to_tcp(camera: Camera, *, calibrated: bool) -> NDArray[np.float64]:  # (4, 4)
    """The camera's mount on the flange: T = (R_z(yaw), offset), or (R_z(yaw) R(error), offset + error's).

    ``calibrated=False`` is the true mount.  ``calibrated=True`` is the result of the hand-eye
    calibration, the one that the controller believes: the true mount turned by the error's
    rotation vector (camera frame) and shifted by its offset (TCP frame).
    """
    rotation = rotation_from_vector(np.array([0.0, 0.0, camera.mount_yaw_rad]))
    offset_in_tcp = np.array(camera.mount_offset_in_tcp_m)
    if calibrated:
        rotation = rotation @ rotation_from_vector(np.array(camera.calibration_error_rotation_rad))
        offset_in_tcp = offset_in_tcp + np.array(camera.calibration_error_offset_m)
    return transform_from(rotation, offset_in_tcp)


@njit_no_nrt
def polygon_in_camera(
    polygon_m: NDArray[np.float64],  # (n, 2)
    transform_object_to_camera: NDArray[np.float64],  # (4, 4)
    out: NDArray[np.float64],  # (n, 3)
) -> None:
    """The vertices of a flat object in the camera frame [m]: R (x, y, 0) + t of the transform (R, t)."""
    t = transform_object_to_camera
    for k in range(polygon_m.shape[0]):
        for row in range(3):
            out[k, row] = t[row, 0] * polygon_m[k, 0] + t[row, 1] * polygon_m[k, 1] + t[row, 3]


@njit_no_nrt
def object_plane(
    transform_object_to_camera: NDArray[np.float64],  # (4, 4)
    out: NDArray[np.float64],  # (3,)
) -> bool:
    """(A, B, C) of the object's plane 1/Z = A x + B y + C [1/m] in the camera frame.

    With the plane's normal n and a point p of it, n . X = n . p; divide by Z n . p.
    False if the plane goes through the centre of projection (it is then seen as a line).
    """
    t = transform_object_to_camera
    distance_m = t[0, 2] * t[0, 3] + t[1, 2] * t[1, 3] + t[2, 2] * t[2, 3]
    for k in range(3):
        out[k] = t[k, 2] / distance_m
    return bool(np.isfinite(out[0]) and np.isfinite(out[1]) and np.isfinite(out[2]))


@njit_no_nrt
def project(
    points_in_camera: NDArray[np.float64],  # (n, 3)
    normalised_out: NDArray[np.float64],  # (n, 2)
) -> bool:
    """Perspective projection x = X/Z, y = Y/Z; False if a point is not beyond the near plane."""
    for k in range(points_in_camera.shape[0]):
        depth_m = points_in_camera[k, 2]
        if not depth_m > NEAR_PLANE_M:  # also for NaN
            return False
        normalised_out[k, 0] = points_in_camera[k, 0] / depth_m
        normalised_out[k, 1] = points_in_camera[k, 1] / depth_m
    return True


@njit_no_nrt
def polygon_inside_image(
    normalised: NDArray[np.float64],  # (n, 2) x, y
    focal_px: float,
    width_px: int,
    height_px: int,
) -> bool:
    """True if every vertex, at u = f x + c_u, v = f y + c_v, is a pixel or more inside the image's border.

    A triangle that the border crops parallel to a side is a similar triangle, which the invariants
    gamma and delta do not notice: this test has to.  NaN is outside.
    """
    c_u, c_v = principal_point_px(width_px, height_px)
    for k in range(normalised.shape[0]):
        u = focal_px * normalised[k, 0] + c_u
        v = focal_px * normalised[k, 1] + c_v
        inside = (
            u >= BORDER_PX
            and u <= width_px - 1 - BORDER_PX
            and v >= BORDER_PX
            and v <= height_px - 1 - BORDER_PX
        )
        if not inside:
            return False
    return True
