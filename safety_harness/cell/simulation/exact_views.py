"""Compute the exact views of the cameras: the projected object's moments and the hands' boxes.

The module ``cell`` has the functions for rendered pixels.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import compiled, njit_no_nrt
from safety_harness.base.geometry.arrays import Array3, Array4x4, Array5, Array31, ArrayNx2x3, ArrayNx3
from safety_harness.base.geometry.linear import copy_matrix
from safety_harness.base.geometry.transforms import compose_into, invert_into
from safety_harness.cell.perception.camera import NEAR_PLANE_M, polygon_inside_image
from safety_harness.cell.perception.hand_boxes import box_in_image, line_of_sight_blocked, sphere_box
from safety_harness.cell.perception.moments import point_moments, polygon_moments
from safety_harness.cell.perception.raster import raster_moments
from safety_harness.cell.robot.distance import CapsuleRecords
from safety_harness.cell.simulation.cameras import SensorRecords
from safety_harness.cell.simulation.hand_motion import HandRecords


@compiled
def exact_object(
    sensors: SensorRecords, polygon_in_base_m: ArrayNx3, transform_tcp_to_base: Array4x4, moments_out: Array31
) -> bool:
    """Fill ``moments_out`` with the moments of the projected polygon.

    Return False if the polygon is not in view. The camera's record states whether to compute the moments in
    closed form or as sums over pixels. ``polygon_in_base_m`` (n, 3).
    """
    s = sensors[0]
    n = polygon_in_base_m.shape[0]
    base_to_camera = s.transform_base_to_camera
    # The true pose of the camera, with a knocked mount; the controller assumes the calibrated one.
    compose_into(transform_tcp_to_base, s.transform_camera_to_tcp, s.transform_camera_to_base)
    invert_into(s.transform_camera_to_base, base_to_camera)
    image = np.empty((n, 2))
    for k in range(n):
        x, y, z = base_to_camera[0, 3], base_to_camera[1, 3], base_to_camera[2, 3]
        for j in range(3):
            x += base_to_camera[0, j] * polygon_in_base_m[k, j]
            y += base_to_camera[1, j] * polygon_in_base_m[k, j]
            z += base_to_camera[2, j] * polygon_in_base_m[k, j]
        if not z > NEAR_PLANE_M:  # as ``project``
            return False
        image[k, 0], image[k, 1] = x / z, y / z
    if not polygon_inside_image(image, s.object_focal_px, s.object_width_px, s.object_height_px):
        return False
    if not s.object_dense:
        return point_moments(image, moments_out)
    if s.object_raster:
        return (
            raster_moments(image, s.object_focal_px, s.object_width_px, s.object_height_px, moments_out) > 0
        )
    return polygon_moments(image, moments_out)


@compiled
def sensor_pose(sensors: SensorRecords, transform_tcp_to_base: Array4x4) -> Array4x4:
    """Return the true pose (sensor to base) of the hand sensor.

    The sensor is either fixed or the hand-eye camera.
    """
    pose = np.empty((4, 4))
    put_sensor_pose(sensors, transform_tcp_to_base, pose)
    return pose


@njit_no_nrt
def put_sensor_pose(sensors: SensorRecords, transform_tcp_to_base: Array4x4, pose_out: Array4x4) -> None:
    """Fill ``pose_out`` (4, 4) with the pose of ``sensor_pose``."""
    s = sensors[0]
    if s.eye_in_hand:
        compose_into(transform_tcp_to_base, s.transform_camera_to_tcp, pose_out)
    else:
        copy_matrix(s.transform_sensor_to_base, pose_out)


@njit_no_nrt
def hand_box(
    sensors: SensorRecords,
    transform_base_to_sensor: Array4x4,
    position_in_base_m: Array3,
    box_out: Array5,
) -> bool:
    """Fill ``box_out`` with the box of a hand, without regard to occlusion.

    Return False if the hand is out of view. The ideal sensor also sees hands beyond the image's border, but
    only in front of the sensor.
    """
    s = sensors[0]
    centre = s.hand_in_sensor
    for i in range(3):
        centre[i] = transform_base_to_sensor[i, 3]
        for j in range(3):
            centre[i] += transform_base_to_sensor[i, j] * position_in_base_m[j]
    if not sphere_box(centre, s.hand_radius_m, s.hand_focal_px, s.hand_c_u, s.hand_c_v, box_out):
        return False
    return bool(
        s.ideal
        or box_in_image(
            centre,
            s.hand_radius_m,
            s.hand_focal_px,
            s.hand_c_u,
            s.hand_c_v,
            s.hand_width_px,
            s.hand_height_px,
            box_out,
        )
    )


@njit_no_nrt
def exact_boxes(
    sensors: SensorRecords,
    hands: HandRecords,
    transform_tcp_to_base: Array4x4,
    capsules: CapsuleRecords,
    capsule_endpoints_in_base_m: ArrayNx2x3,
    boxes_out: NDArray[np.float64],  # (n, 5), n at least the number of hands
) -> int:
    """Fill ``boxes_out`` with the bounding boxes of the visible hands, and return the number of boxes.

    The ideal sensor sees through the robot.
    """
    s = sensors[0]
    pose, base_to_sensor = s.transform_hand_sensor_to_base, s.transform_base_to_hand_sensor
    put_sensor_pose(sensors, transform_tcp_to_base, pose)
    invert_into(pose, base_to_sensor)
    count = 0
    for k in range(hands.shape[0]):
        if not hands[k].present:
            continue
        position = hands[k].position_in_base_m
        if not hand_box(sensors, base_to_sensor, position, boxes_out[count]):
            continue
        # Occlusion is tested last, because it needs every capsule.
        if not s.ideal and _blocked(sensors, position, capsules, capsule_endpoints_in_base_m):
            continue
        count += 1
    return count


@compiled
def _blocked(
    sensors: SensorRecords,
    position_in_base_m: Array3,
    capsules: CapsuleRecords,
    capsule_endpoints_in_base_m: ArrayNx2x3,
) -> bool:
    """Return whether a part of the arm is between the hand sensor and a hand."""
    s = sensors[0]
    eye = s.transform_hand_sensor_to_base[:3, 3].copy()
    return line_of_sight_blocked(
        eye, position_in_base_m, s.hand_radius_m, capsule_endpoints_in_base_m, capsules["radius_m"]
    )
