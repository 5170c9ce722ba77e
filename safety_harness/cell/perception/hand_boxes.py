"""Project a hand (a sphere) to its bounding box in an image, and back (section 3.2 of the paper).

A *box* is a float64 array (5,): u_px, v_px of the box's centre, z_m, area_px2, and the aspect ratio
width/height. The depth z_m is the camera's Z coordinate of the surface at that pixel. Pixel centres have
integer coordinates, so an image of w x h pixels covers [-1/2, w - 1/2] x [-1/2, h - 1/2].
"""

from __future__ import annotations

from math import isfinite, nan, sqrt

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import compiled, inlined, njit_no_nrt
from safety_harness.base.geometry.segments import point_segment_distance, segment_segment_distance
from safety_harness.base.settings import DetectorKind, HandSensor
from safety_harness.cell.perception.camera import principal_point_px

BOX_LENGTH = 5  # u, v, z, area, aspect ratio: the measurement of eq. 7


def rendered_principal_point_px(width_px: int, height_px: int) -> tuple[float, float]:
    """Return the principal point (c_u, c_v) of PyBullet's software renderer with a symmetric projection.

    The renderer samples pixel (i, j) at the pixel's lower left corner instead of its centre. The renderer
    then turns the image upside down. The principal point is then (w/2, h/2 - 1), whereas an exact camera has
    ((w - 1)/2, (h - 1)/2).
    """
    return width_px / 2.0, height_px / 2.0 - 1.0


def sensor_principal_point_px(sensor: HandSensor) -> tuple[float, float]:
    """Return the principal point (c_u, c_v) of a sensor's images.

    The images are either exact or rendered.
    """
    if sensor.detector is DetectorKind.RENDERED:
        return rendered_principal_point_px(sensor.width_px, sensor.height_px)
    return principal_point_px(sensor.width_px, sensor.height_px)


@njit_no_nrt
def _front_depth(centre: NDArray[np.float64], radius_m: float, x: float, y: float) -> float:
    """Return the depth [m] at which the ray d = (x, y, 1) enters a sphere, or NaN if the ray misses it.

    The sphere has the centre C = ``centre`` (3,) and the radius r. The depth is the smaller root Z of |Z d -
    C|^2 = r^2. The function computes the depth as (|C|^2 - r^2)/(b + sqrt(b^2 - |d|^2 (|C|^2 - r^2))) with b
    = dot(d, C). A sphere behind the camera also gives NaN.
    """
    ray_squared = x * x + y * y + 1.0
    along = x * centre[0] + y * centre[1] + centre[2]
    centre_squared = centre[0] * centre[0] + centre[1] * centre[1] + centre[2] * centre[2]
    discriminant = along * along - ray_squared * (centre_squared - radius_m * radius_m)
    if not (discriminant >= 0.0 and along > 0.0):
        return nan
    # The smaller root is the product of both roots divided by the larger root; this loses no digits.
    depth_m: float = (centre_squared - radius_m * radius_m) / (along + sqrt(discriminant))
    return depth_m


@njit_no_nrt
def sphere_box(
    centre_in_camera: NDArray[np.float64],  # (3,) [m]
    radius_m: float,
    focal_px: float,
    c_u: float,
    c_v: float,
    box_out: NDArray[np.float64],  # (5,)
) -> bool:
    """Fill ``box_out`` with the bounding box of a sphere in an image.

    The border of the image does not limit the box. The image of a sphere is an ellipse. The planes at the
    ellipse's left and right ends contain the camera's y axis and touch the sphere. So |X - x Z| = r
    sqrt(1 + x^2), which gives

        x = (X Z +- r sqrt(X^2 + Z^2 - r^2)) / (Z^2 - r^2)

    The same equation with Y gives the upper and lower ends. The depth of the box is the depth at which the
    ray through the box's centre enters the sphere.

    Return whether the whole sphere is in front of the camera's plane (Z > r) and all numbers are finite. Z >
    r also means that the camera is outside the sphere. If the result is False, the function does not change
    ``box_out``.
    """
    x_m, y_m, z_m = centre_in_camera[0], centre_in_camera[1], centre_in_camera[2]
    if not (radius_m > 0.0 and z_m > radius_m):
        return False
    tangent_squared = z_m * z_m - radius_m * radius_m
    x, y = x_m * z_m / tangent_squared, y_m * z_m / tangent_squared
    half_width = radius_m * sqrt(x_m * x_m + tangent_squared) / tangent_squared
    half_height = radius_m * sqrt(y_m * y_m + tangent_squared) / tangent_squared
    depth_m = _front_depth(centre_in_camera, radius_m, x, y)
    # Very large numbers may overflow on the way; the caller must not see a half-filled box.
    if not (isfinite(depth_m) and isfinite(half_width) and isfinite(half_height)):
        return False
    box_out[0] = focal_px * x + c_u
    box_out[1] = focal_px * y + c_v
    box_out[2] = depth_m
    box_out[3] = 4.0 * focal_px * focal_px * half_width * half_height
    box_out[4] = half_width / half_height
    return True


@njit_no_nrt
def box_in_image(
    centre_in_camera: NDArray[np.float64],  # (3,) [m]
    radius_m: float,
    focal_px: float,
    c_u: float,
    c_v: float,
    width_px: float,
    height_px: float,
    box: NDArray[np.float64],  # (5,), changed in place
) -> bool:
    """Clip the box of ``sphere_box`` at the border of the image, and return whether the hand is visible.

    A hand is visible if the sphere's *centre* projects into the image, because a detector finds half a hand,
    but not a sliver. The function replaces a visible box by its part within the image, as a detector would
    draw it. This part has a new centre, area and aspect ratio, and the depth of the sphere at the *new*
    centre. A box wholly inside the image stays the same, bit for bit.

    If the hand is not visible, ``box`` does not change. A hand is also not visible if the ray through the new
    centre misses the sphere, because a depth camera would read the background there. The ray can miss the
    sphere only with a field of view above 130 degrees.
    """
    u_centre = focal_px * centre_in_camera[0] / centre_in_camera[2] + c_u
    v_centre = focal_px * centre_in_camera[1] / centre_in_camera[2] + c_v
    # The image reaches half a pixel beyond the centres of its border pixels.
    inside_u = u_centre >= -0.5 and u_centre <= width_px - 0.5
    inside_v = v_centre >= -0.5 and v_centre <= height_px - 0.5
    if not (inside_u and inside_v):
        return False
    half_width, half_height = 0.5 * sqrt(box[3] * box[4]), 0.5 * sqrt(box[3] / box[4])
    left, right = box[0] - half_width, box[0] + half_width
    top, bottom = box[1] - half_height, box[1] + half_height
    # To compute the box again from its edges would round it.
    if left >= -0.5 and right <= width_px - 0.5 and top >= -0.5 and bottom <= height_px - 0.5:
        return True
    left, right = max(left, -0.5), min(right, width_px - 0.5)
    top, bottom = max(top, -0.5), min(bottom, height_px - 0.5)
    u_px, v_px = 0.5 * (left + right), 0.5 * (top + bottom)
    depth_m = _front_depth(centre_in_camera, radius_m, (u_px - c_u) / focal_px, (v_px - c_v) / focal_px)
    if not (isfinite(depth_m) and right > left and bottom > top):
        return False
    box[0], box[1], box[2] = u_px, v_px, depth_m
    box[3] = (right - left) * (bottom - top)
    box[4] = (right - left) / (bottom - top)
    return True


@compiled
def line_of_sight_blocked(
    camera_position: NDArray[np.float64],  # (3,) [m]
    hand_position: NDArray[np.float64],  # (3,) [m]
    hand_radius_m: float,
    capsules: NDArray[np.float64],  # (n, 2, 3) [m]: the two ends of each axis
    capsule_radii_m: NDArray[np.float64],  # (n,)
) -> bool:
    """Return whether a capsule cuts the straight line from the camera to the nearest point of the hand.

    All positions are in the same frame, for example the base frame. The line stands for the whole hand. The
    function ignores a capsule that contains the camera. Such a capsule is the generous hull of the link that
    carries the camera, and the real camera looks past that link.
    """
    dx = camera_position[0] - hand_position[0]
    dy = camera_position[1] - hand_position[1]
    dz = camera_position[2] - hand_position[2]
    distance_m = sqrt(dx * dx + dy * dy + dz * dz)
    if distance_m <= hand_radius_m:
        return False  # nothing fits between
    target = np.empty(3)
    share = hand_radius_m / distance_m
    target[0] = hand_position[0] + share * dx
    target[1] = hand_position[1] + share * dy
    target[2] = hand_position[2] + share * dz
    for i in range(capsules.shape[0]):
        start, end = capsules[i, 0], capsules[i, 1]
        if segment_segment_distance(camera_position, target, start, end) > capsule_radii_m[i]:
            continue
        if point_segment_distance(camera_position, start, end) > capsule_radii_m[i]:
            return True
    return False


@njit_no_nrt
def position_from_box(
    box: NDArray[np.float64],  # (5,)
    focal_px: float,
    c_u: float,
    c_v: float,
    assumed_radius_m: float,
    position_in_camera_out: NDArray[np.float64],  # (3,)
) -> None:
    """Fill ``position_in_camera_out`` with the hand's centre [m].

    The function takes the point at depth z on the ray through (u, v), then goes one radius r deeper:

        (X, Y, Z) = (x, y, 1) (z + r/sqrt(x^2 + y^2 + 1)),   x = (u - c_u)/f,   y = (v - c_v)/f

    The formula is the pinhole conversion of section 3.2. Let a sphere of radius r be at depth Z, at the angle
    theta from the optical axis. The centre of its box is farther out in the image than the projection of the
    sphere's centre. The ray therefore misses the sphere's centre by

        e <= sin(theta) r^2 Z / (Z^2 - r^2)

    The distance of the result from the true centre is sqrt(2 r (r - sqrt(r^2 - e^2))). To first order, this
    distance is e, and it is zero on the axis. Consider the corner of a 640 x 480 image with f = 615 px and r
    = 60 mm. The distance there is about 2.0 mm at Z = 1 m and 6.7 mm at Z = 0.3 m. An error of the assumed
    radius adds to this distance along the ray.
    """
    x, y, z = place_of_pixel(box[0], box[1], box[2], focal_px, c_u, c_v, assumed_radius_m)
    position_in_camera_out[0] = x
    position_in_camera_out[1] = y
    position_in_camera_out[2] = z


@inlined
def place_of_pixel(
    u_px: float, v_px: float, z_m: float, focal_px: float, c_u: float, c_v: float, assumed_radius_m: float
) -> tuple[float, float, float]:
    """Return the position (X, Y, Z) [m] in the camera frame that ``position_from_box`` computes."""
    x, y = (u_px - c_u) / focal_px, (v_px - c_v) / focal_px
    depth_m = z_m + assumed_radius_m / sqrt(x * x + y * y + 1.0)
    return x * depth_m, y * depth_m, depth_m
