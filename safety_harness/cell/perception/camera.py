"""Model the eye-in-hand camera: a pinhole without distortion, its mount, and its view of the object.

Normalised coordinates are x = X/Z, y = Y/Z. Pixels are u = f x + c_u, v = f y + c_v. The centre of pixel
(0, 0) has the coordinates (0, 0) (docs/reference/conventions.md).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import njit_no_nrt
from safety_harness.base.elementary import product
from safety_harness.base.geometry.rotations import rotation_from_vector
from safety_harness.base.geometry.transforms import transform_from
from safety_harness.base.settings import Camera

NEAR_PLANE_M = 0.01  # a nearer point is out of focus or behind the lens; 10 mm is our choice
BORDER_PX = 1.0  # the image may crop an object that comes nearer to its border


@njit_no_nrt
def principal_point_px(width_px: int, height_px: int) -> tuple[float, float]:
    """Return the middle of the image (c_u, c_v), in coordinates in which pixel centres are integers."""
    return 0.5 * (width_px - 1), 0.5 * (height_px - 1)


def transform_camera_to_tcp(camera: Camera, *, calibrated: bool) -> NDArray[np.float64]:  # (4, 4)
    """Return the camera's mount on the flange, which is either the true or the calibrated mount.

    ``calibrated=False`` gives the true mount T = (R_z(yaw), offset) of ``camera``. ``calibrated=True`` gives
    the result of the hand-eye calibration, which the controller assumes: (R_z(yaw) R(error), offset + error's
    offset). The calibrated mount is the true mount after a rotation and a shift. The calibration error
    contains the rotation vector (camera frame) and the shift (TCP frame).
    """
    rotation = rotation_from_vector(np.array([0.0, 0.0, camera.mount_yaw_rad]))
    offset_in_tcp = np.array(camera.mount_offset_in_tcp_m)
    if calibrated:
        rotation = product(rotation, rotation_from_vector(np.array(camera.calibration_error_rotation_rad)))
        offset_in_tcp = offset_in_tcp + np.array(camera.calibration_error_offset_m)
    return transform_from(rotation, offset_in_tcp)


@njit_no_nrt
def polygon_in_camera(
    polygon_m: NDArray[np.float64],  # (n, 2)
    transform_object_to_camera: NDArray[np.float64],  # (4, 4)
    out: NDArray[np.float64],  # (n, 3)
) -> None:
    """Fill ``out`` with the vertices of a flat object in the camera frame [m].

    A vertex (x, y) has the position R (x, y, 0) + t in this frame. Here (R, t) is
    ``transform_object_to_camera``.
    """
    t = transform_object_to_camera
    for k in range(polygon_m.shape[0]):
        for row in range(3):
            out[k, row] = t[row, 0] * polygon_m[k, 0] + t[row, 1] * polygon_m[k, 1] + t[row, 3]


@njit_no_nrt
def object_plane(
    transform_object_to_camera: NDArray[np.float64],  # (4, 4)
    out: NDArray[np.float64],  # (3,)
) -> bool:
    """Fill ``out`` with the coefficients (A, B, C) [1/m] of the object's plane in the camera frame.

    The plane has the equation 1/Z = A x + B y + C.

    A point X of the plane fulfils dot(n, X) = dot(n, p), in which n is the plane's normal and p a point of
    the plane. Division by Z dot(n, p) gives the equation. Return False if the plane goes through the centre
    of projection. The camera then sees the plane as a line.
    """
    t = transform_object_to_camera
    # The third column of t is the plane's normal n, so this is dot(n, p). It is 0 if the camera sees the
    # plane edge-on.
    distance_m = t[0, 2] * t[0, 3] + t[1, 2] * t[1, 3] + t[2, 2] * t[2, 3]
    for k in range(3):
        out[k] = t[k, 2] / distance_m
    return bool(np.isfinite(out[0]) and np.isfinite(out[1]) and np.isfinite(out[2]))


@njit_no_nrt
def project(
    points_in_camera: NDArray[np.float64],  # (n, 3)
    normalised_out: NDArray[np.float64],  # (n, 2)
) -> bool:
    """Project points by x = X/Z, y = Y/Z.

    Return False unless every point is beyond the near plane.
    """
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
    """Return whether every vertex is at least one pixel inside the image's border.

    A vertex is at u = f x + c_u, v = f y + c_v. Suppose that the border cuts a triangle along a line parallel
    to a side. The triangle that remains may be similar to the whole triangle. The invariants gamma and delta
    are then the same for both, so this test is necessary. A NaN counts as outside.
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
