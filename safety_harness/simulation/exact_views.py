"""What the cameras see, exactly: the projected object's moments and the hands' bounding boxes, compiled.

``cell`` holds the ones that work on rendered pixels.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from safety_harness.compiled import compiled
from safety_harness.geometry.linear import copy_matrix
from safety_harness.geometry.transforms import compose_into, inverse_transform
from safety_harness.perception.camera import polygon_inside_image, project
from safety_harness.perception.hand_boxes import box_in_image, line_of_sight_blocked, sphere_box
from safety_harness.perception.moments import point_moments, polygon_moments
from safety_harness.perception.raster import raster_moments
from safety_harness.scenario.model import MAX_HANDS


@compiled
def exact_object(
    sensors: NDArray[np.void],  # (1,) SENSORS
    polygon_in_base_m: NDArray[np.float64],  # (n, 3)
    transform_tcp_to_base: NDArray[np.float64],  # (4, 4)
    moments_out: NDArray[np.float64],  # (31,)
) -> bool:
    """Moments of the projected polygon, in closed form or at pixel centres; False if out of view."""
    s = sensors[0]
    n = polygon_in_base_m.shape[0]
    camera_to_base = np.empty((4, 4))
    compose_into(transform_tcp_to_base, s.transform_camera_to_tcp, camera_to_base)
    base_to_camera = inverse_transform(camera_to_base)
    points, image = np.empty((n, 3)), np.empty((n, 2))
    for k in range(n):
        for i in range(3):
            points[k, i] = base_to_camera[i, 3]
            for j in range(3):
                points[k, i] += base_to_camera[i, j] * polygon_in_base_m[k, j]
    if not project(points, image):
        return False
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
def sensor_pose(
    sensors: NDArray[np.void],  # (1,) SENSORS
    transform_tcp_to_base: NDArray[np.float64],  # (4, 4)
    sensor_to_base_out: NDArray[np.float64],  # (4, 4)
) -> None:
    """The hand sensor's true pose: fixed, or carried by the hand-eye camera."""
    s = sensors[0]
    if s.eye_in_hand:
        compose_into(transform_tcp_to_base, s.transform_camera_to_tcp, sensor_to_base_out)
    else:
        copy_matrix(s.transform_sensor_to_base, sensor_to_base_out)


@compiled
def exact_boxes(
    sensors: NDArray[np.void],  # (1,) SENSORS
    hands: NDArray[np.void],  # (MAX_HANDS,) HAND
    transform_tcp_to_base: NDArray[np.float64],  # (4, 4)
    capsules: NDArray[np.void],  # (n,) CAPSULE
    capsule_endpoints_in_base_m: NDArray[np.float64],  # (n, 2, 3)
    boxes_out: NDArray[np.float64],  # (MAX_DETECTIONS, 5)
) -> int:
    """Bounding boxes of the hands that the sensor sees; returns how many.

    The ideal sensor sees through the robot and beyond the image; it still has to have the hand
    in front of it.
    """
    s = sensors[0]
    pose = np.empty((4, 4))
    sensor_pose(sensors, transform_tcp_to_base, pose)
    base_to_sensor = inverse_transform(pose)
    count = 0
    centre = np.empty(3)
    for k in range(MAX_HANDS):
        if not hands[k].present:
            continue
        for i in range(3):
            centre[i] = base_to_sensor[i, 3]
            for j in range(3):
                centre[i] += base_to_sensor[i, j] * hands[k].position_in_base_m[j]
        box = boxes_out[count]
        if not sphere_box(centre, s.hand_radius_m, s.hand_focal_px, s.hand_c_u, s.hand_c_v, box):
            continue
        if not s.ideal:
            if not box_in_image(
                centre,
                s.hand_radius_m,
                s.hand_focal_px,
                s.hand_c_u,
                s.hand_c_v,
                s.hand_width_px,
                s.hand_height_px,
                box,
            ):
                continue
            if line_of_sight_blocked(
                pose[:3, 3].copy(),
                hands[k].position_in_base_m,
                s.hand_radius_m,
                capsule_endpoints_in_base_m,
                capsules["radius_m"],
            ):
                continue
        count += 1
    return count
