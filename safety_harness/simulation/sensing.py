"""What the cameras deliver: frames at their rate, late by their latency, with their noise.

The exact image sources are compiled here; ``image_sources`` holds the ones that work on pixels.
A frame is taken at the first control tick at or after its due time, and delivered at the first
tick at or after that plus the latency.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from safety_harness.compiled import compiled
from safety_harness.exceptions import Place, SettingsError
from safety_harness.geometry.transforms import compose_into, inverse_transform
from safety_harness.perception.camera import (
    polygon_inside_image,
    project,
    transform_camera_to_tcp,
)
from safety_harness.perception.hand_boxes import (
    box_in_image,
    line_of_sight_blocked,
    sensor_principal_point_px,
    sphere_box,
)
from safety_harness.perception.moments import point_moments, polygon_moments
from safety_harness.perception.raster import raster_moments
from safety_harness.perception.tracking import MAX_DETECTIONS
from safety_harness.scenario.model import MAX_HANDS
from safety_harness.seeds import Branch, generator
from safety_harness.settings import HandSensorKind, ImageSource, ObjectKind, Settings

MOMENTS = 31
RING = 64  # frames under way at a time
TIME_EPS_S = 1e-9

SENSORS = np.dtype(
    [
        ("transform_camera_to_tcp", np.float64, (4, 4)),  # the true mount
        ("object_focal_px", np.float64),
        ("object_width_px", np.int64),
        ("object_height_px", np.int64),
        ("object_raster", np.bool_),
        ("object_dense", np.bool_),
        ("object_period_s", np.float64),  # 0: every tick
        ("object_latency_s", np.float64),
        ("object_frames", np.int64),  # taken so far
        ("object_delivered", np.int64),
        ("object_due_s", np.float64),
        ("ideal", np.bool_),
        ("eye_in_hand", np.bool_),
        ("transform_sensor_to_base", np.float64, (4, 4)),
        ("hand_focal_px", np.float64),
        ("hand_width_px", np.float64),
        ("hand_height_px", np.float64),
        ("hand_c_u", np.float64),
        ("hand_c_v", np.float64),
        ("hand_radius_m", np.float64),
        ("hand_period_s", np.float64),
        ("hand_latency_s", np.float64),
        ("hand_frames", np.int64),
        ("hand_delivered", np.int64),
        ("hand_due_s", np.float64),
        ("pixel_noise_px", np.float64),
        ("depth_noise_per_m", np.float64),
        ("dropout_probability", np.float64),
    ],
    align=True,
)

OBJECT_FRAME = np.dtype(
    [("time_s", np.float64), ("visible", np.bool_), ("moments", np.float64, (MOMENTS,))], align=True
)
HAND_FRAME = np.dtype(
    [("time_s", np.float64), ("count", np.int64), ("boxes", np.float64, (MAX_DETECTIONS, 5))], align=True
)


@dataclass(frozen=True, eq=False)
class Sensors:
    """One episode's cameras: ``state`` (1,) SENSORS and the frames that are under way."""

    state: NDArray[np.void]
    object_frames: NDArray[np.void]  # (RING,)
    hand_frames: NDArray[np.void]  # (RING,)
    polygon_in_base_m: NDArray[np.float64]  # (n, 3)
    normals: NDArray[np.float64]  # (frames, MAX_DETECTIONS, 3): u, v, depth
    uniforms: NDArray[np.float64]  # (frames, MAX_DETECTIONS): dropout


def object_polygon_in_base(settings: Settings) -> NDArray[np.float64]:
    """(n, 3) vertices of the object on its plane."""
    cell = settings.cell
    c, s = np.cos(cell.object_yaw_rad), np.sin(cell.object_yaw_rad)
    polygon = np.array(cell.object_polygon_m)
    flat = polygon @ np.array([[c, s], [-s, c]])
    return np.column_stack([flat, np.zeros(len(flat))]) + cell.object_position_in_base_m


def sensors(
    settings: Settings, seed: int, ticks: int, transform_sensor_to_base: NDArray[np.float64]
) -> Sensors:
    """The cameras before their first frame.  Noise is drawn beforehand, by frame and detection."""
    state = np.zeros(1, SENSORS)
    camera, hand = settings.camera, settings.hand_sensor
    state["transform_camera_to_tcp"] = transform_camera_to_tcp(camera, calibrated=False)
    state["object_focal_px"] = camera.focal_px
    state["object_width_px"], state["object_height_px"] = camera.width_px, camera.height_px
    state["object_raster"] = camera.source is ImageSource.RASTER
    state["object_dense"] = settings.servo.object_kind is ObjectKind.DENSE
    state["object_period_s"], state["object_latency_s"] = _timing(
        "camera", camera.rate_hz, camera.latency_s, settings
    )
    state["ideal"] = hand.kind is HandSensorKind.IDEAL
    state["eye_in_hand"] = hand.kind is HandSensorKind.EYE_IN_HAND
    state["transform_sensor_to_base"] = transform_sensor_to_base
    state["hand_focal_px"] = hand.focal_px
    state["hand_width_px"], state["hand_height_px"] = hand.width_px, hand.height_px
    state["hand_c_u"], state["hand_c_v"] = sensor_principal_point_px(hand)
    state["hand_radius_m"] = settings.hand.radius_m
    state["hand_period_s"], state["hand_latency_s"] = _timing(
        "hand sensor", hand.rate_hz, hand.latency_s, settings
    )
    state["pixel_noise_px"] = hand.pixel_noise_px
    state["depth_noise_per_m"] = hand.depth_noise_per_m
    state["dropout_probability"] = hand.dropout_probability
    noise, dropout = (generator(seed, Branch.HAND_SENSOR_NOISE, k) for k in range(2))
    noisy = hand.pixel_noise_px > 0.0 or hand.depth_noise_per_m > 0.0 or hand.dropout_probability > 0.0
    frames = ticks + 1 if noisy else 1
    return Sensors(
        state,
        np.zeros(RING, OBJECT_FRAME),
        np.zeros(RING, HAND_FRAME),
        object_polygon_in_base(settings),
        noise.standard_normal((frames, MAX_DETECTIONS, 3)),
        dropout.random((frames, MAX_DETECTIONS)),
    )


def _timing(field: str, rate_hz: float | None, latency_s: float, settings: Settings) -> tuple[float, float]:
    """(period, latency) in seconds; refuses more frames under way than the ring holds."""
    period_s = 0.0 if rate_hz is None else 1.0 / rate_hz
    under_way = latency_s / max(period_s, settings.clock.control_period_s) + 2.0
    if under_way > RING:
        raise SettingsError(
            place=Place(field=f"{field}: latency"),
            expected=f"at most {RING - 2} frames under way at a time",
            got=f"{latency_s:g} s, which is {under_way - 2.0:.0f} frames",
        )
    return period_s, latency_s


@compiled
def take_due(time_s: float, period_s: float, due_s: float) -> tuple[bool, float]:
    """Is a frame due at ``time_s``, and when is the one after it?"""
    if period_s <= 0.0:
        return True, time_s
    if time_s < due_s - TIME_EPS_S:
        return False, due_s
    return True, (np.floor((time_s + TIME_EPS_S) / period_s) + 1.0) * period_s


@compiled
def object_frame_due(sensors: NDArray[np.void], time_s: float) -> bool:
    """Whether the object's camera takes a frame at this tick; asking advances its clock."""
    s = sensors[0]
    due, s.object_due_s = take_due(time_s, s.object_period_s, s.object_due_s)
    return due


@compiled
def hand_frame_due(sensors: NDArray[np.void], time_s: float) -> bool:
    """Whether the hand sensor takes a frame at this tick; asking advances its clock."""
    s = sensors[0]
    due, s.hand_due_s = take_due(time_s, s.hand_period_s, s.hand_due_s)
    return due


@compiled
def push_object_frame(
    sensors: NDArray[np.void],
    frames: NDArray[np.void],
    time_s: float,
    visible: bool,
    moments: NDArray[np.float64],
) -> None:
    """Put a frame of the object on its way."""
    s = sensors[0]
    frame = frames[s.object_frames % RING]
    frame.time_s = time_s
    frame.visible = visible
    frame.moments[:] = moments
    s.object_frames += 1


@compiled
def push_hand_frame(
    sensors: NDArray[np.void],
    frames: NDArray[np.void],
    normals: NDArray[np.float64],
    uniforms: NDArray[np.float64],
    time_s: float,
    boxes: NDArray[np.float64],  # (MAX_DETECTIONS, 5)
    count: int,
) -> None:
    """Put a frame of boxes on its way: some drop out, the others get pixel and depth noise.

    Depth noise grows with the square of the depth, as a stereo camera's does.
    """
    s = sensors[0]
    frame = frames[s.hand_frames % RING]
    frame.time_s = time_s
    kept = 0
    row = s.hand_frames % normals.shape[0]
    for k in range(count):
        if s.dropout_probability > 0.0 and uniforms[row, k] < s.dropout_probability:
            continue
        for i in range(5):
            frame.boxes[kept, i] = boxes[k, i]
        frame.boxes[kept, 0] += s.pixel_noise_px * normals[row, k, 0]
        frame.boxes[kept, 1] += s.pixel_noise_px * normals[row, k, 1]
        frame.boxes[kept, 2] += s.depth_noise_per_m * boxes[k, 2] * boxes[k, 2] * normals[row, k, 2]
        kept += 1
    frame.count = kept
    s.hand_frames += 1


@compiled
def exact_object(
    sensors: NDArray[np.void],
    polygon_in_base_m: NDArray[np.float64],  # (n, 3)
    transform_tcp_to_base: NDArray[np.float64],
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
    sensors: NDArray[np.void],
    transform_tcp_to_base: NDArray[np.float64],
    sensor_to_base_out: NDArray[np.float64],
) -> None:
    """The hand sensor's true pose: fixed, or carried by the hand-eye camera."""
    s = sensors[0]
    if s.eye_in_hand:
        compose_into(transform_tcp_to_base, s.transform_camera_to_tcp, sensor_to_base_out)
    else:
        sensor_to_base_out[:, :] = s.transform_sensor_to_base


@compiled
def exact_boxes(
    sensors: NDArray[np.void],
    hands: NDArray[np.void],  # (MAX_HANDS,) HAND
    transform_tcp_to_base: NDArray[np.float64],
    capsules_in_base_m: NDArray[np.float64],  # (n, 2, 3)
    capsule_radius_m: NDArray[np.float64],  # (n,)
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
                capsules_in_base_m,
                capsule_radius_m,
            ):
                continue
        count += 1
    return count


@compiled
def deliver(
    sensors: NDArray[np.void],
    object_frames: NDArray[np.void],
    hand_frames: NDArray[np.void],
    time_s: float,
    observations: NDArray[np.void],  # (1,) OBSERVATION
) -> None:
    """Hand over what has arrived by ``time_s``; with several at once, the newest."""
    s, o = sensors[0], observations[0]
    o.time_s = time_s
    o.image_new = False
    while s.object_delivered < s.object_frames:
        frame = object_frames[s.object_delivered % RING]
        if frame.time_s + s.object_latency_s > time_s + TIME_EPS_S:
            break
        o.image_new = True
        o.object_visible = frame.visible
        o.moments[:] = frame.moments
        s.object_delivered += 1
    o.boxes_new = False
    while s.hand_delivered < s.hand_frames:
        hand_frame = hand_frames[s.hand_delivered % RING]
        if hand_frame.time_s + s.hand_latency_s > time_s + TIME_EPS_S:
            break
        o.boxes_new = True
        o.boxes_time_s = hand_frame.time_s
        o.box_count = hand_frame.count
        o.boxes[:, :] = hand_frame.boxes
        s.hand_delivered += 1
