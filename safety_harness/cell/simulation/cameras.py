"""Define the cameras of an episode: their records, their noise, and the frames that are not yet delivered."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple, NewType

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.elementary import cos, product, sin
from safety_harness.base.exceptions import SettingsError
from safety_harness.base.geometry.arrays import Array4x4
from safety_harness.base.normals import standard_normal
from safety_harness.base.seeds import Branch, generator
from safety_harness.base.settings import HAND_SLOTS, HandSensorKind, ImageSource, Object, ObjectKind, Settings
from safety_harness.cell.perception.camera import transform_camera_to_tcp
from safety_harness.cell.perception.hand_boxes import sensor_principal_point_px
from safety_harness.cell.perception.moments import MOMENT_COUNT
from safety_harness.trace.records import TRACKS_PER_HAND

RING = 64  # taken but undelivered frames at a time

SENSORS = np.dtype(
    [
        ("transform_mount_to_tcp", np.float64, (4, 4)),  # the true mount
        ("transform_camera_to_tcp", np.float64, (4, 4)),  # at present, in the mount or knocked out of it
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
        ("forearm_radius_m", np.float64),
        ("hand_period_s", np.float64),
        ("hand_latency_s", np.float64),
        ("hand_frames", np.int64),
        ("hand_delivered", np.int64),
        ("hand_due_s", np.float64),
        ("pixel_noise_px", np.float64),
        ("depth_noise_per_m", np.float64),
        ("dropout_probability", np.float64),
        # for the computation of a frame
        ("transform_camera_to_base", np.float64, (4, 4)),
        ("transform_base_to_camera", np.float64, (4, 4)),
        ("transform_hand_sensor_to_base", np.float64, (4, 4)),
        ("transform_base_to_hand_sensor", np.float64, (4, 4)),
        ("hand_in_sensor", np.float64, (3,)),
    ],
    align=True,
)

OBJECT_FRAME = np.dtype(
    [
        ("time_s", np.float64),
        ("late_s", np.float64),  # beyond the latency
        ("visible", np.bool_),
        ("moments", np.float64, (MOMENT_COUNT,)),
    ],
    align=True,
)


@lru_cache
def hand_frame_dtype(hands: int) -> np.dtype[Any]:
    """Return the record type HAND_FRAME, with TRACKS_PER_HAND boxes for each of ``hands`` hands."""
    boxes = TRACKS_PER_HAND * hands
    return np.dtype(
        [
            ("time_s", np.float64),
            ("late_s", np.float64),  # beyond the latency
            ("count", np.int64),
            ("boxes", np.float64, (boxes, 5)),
        ],
        align=True,
    )


SensorRecords = NewType("SensorRecords", NDArray[np.void])  # (1,) SENSORS
ObjectFrames = NewType("ObjectFrames", NDArray[np.void])  # (RING,) OBJECT_FRAME
HandFrames = NewType("HandFrames", NDArray[np.void])  # (RING,) HAND_FRAME


class Sensors(NamedTuple):
    """The cameras of an episode and the frames that they have not yet delivered."""

    state: SensorRecords
    object_frames: ObjectFrames
    hand_frames: HandFrames
    polygon_in_base_m: NDArray[np.float64]  # (n, 3)
    normals: NDArray[np.float64]  # (frames, boxes, 3): u, v, depth
    uniforms: NDArray[np.float64]  # (frames, boxes): missed detections


def object_polygon_in_base(settings: Settings) -> NDArray[np.float64]:
    """Return the vertices (n, 3) of the object on its plane, in the base frame [m]."""
    return _polygon_in_base(settings.object).copy()


@lru_cache(maxsize=16)
def _polygon_in_base(shape: Object) -> NDArray[np.float64]:
    """Return the vertices (n, 3) of ``object_polygon_in_base``, cached for each object."""
    c, s = cos(shape.yaw_rad), sin(shape.yaw_rad)
    polygon = np.array(shape.polygon_m)
    flat = product(polygon, np.array([[c, s], [-s, c]]))
    return np.column_stack([flat, np.zeros(len(flat))]) + shape.position_in_base_m


def sensors(
    settings: Settings,
    seed: int,
    ticks: int,
    transform_sensor_to_base: Array4x4,
    hand_slots: int = HAND_SLOTS[0],
) -> Sensors:
    """Return the cameras before their first frame.

    The result contains the noise of every frame and detection.

    Args:
        settings: The settings of cameras and object.
        seed: The scenario's seed.
        ticks: The number of ticks, which limits the number of frames with noise.
        transform_sensor_to_base: The pose (4, 4) of a fixed hand sensor.
        hand_slots: The scenario's number of hands.

    """
    hand = settings.hand_sensor
    state = SensorRecords(camera_state(settings).copy())
    state["transform_sensor_to_base"] = transform_sensor_to_base
    noisy = hand.pixel_noise_px > 0.0 or hand.depth_noise_per_m > 0.0 or hand.dropout_probability > 0.0
    boxes = TRACKS_PER_HAND * hand_slots
    normals, uniforms = np.zeros((1, boxes, 3)), np.zeros((1, boxes))
    if noisy:  # in streams of four boxes, so that hand_slots does not change the noise of the first four
        streams = [generator(seed, Branch.HAND_SENSOR_NOISE, k) for k in range(boxes // 2)]
        normals = np.hstack([standard_normal(noise, (ticks + 1, 4, 3)) for noise in streams[::2]])
        uniforms = np.hstack([misses.random((ticks + 1, 4)) for misses in streams[1::2]])
    return Sensors(
        state,
        ObjectFrames(np.zeros(RING, OBJECT_FRAME)),
        HandFrames(np.zeros(RING, hand_frame_dtype(hand_slots))),
        object_polygon_in_base(settings),
        normals,
        uniforms,
    )


@lru_cache(maxsize=16)  # many episodes differ only in their hands and starts
def camera_state(settings: Settings) -> SensorRecords:
    """Return the read-only record SENSORS (1,) before the first frame.

    The record does not contain the pose of a fixed sensor.
    """
    state = np.zeros(1, SENSORS)
    camera, hand = settings.camera, settings.hand_sensor
    state["transform_mount_to_tcp"] = transform_camera_to_tcp(camera, calibrated=False)
    state["transform_camera_to_tcp"] = state["transform_mount_to_tcp"]
    state["object_focal_px"] = camera.focal_px
    state["object_width_px"], state["object_height_px"] = camera.width_px, camera.height_px
    state["object_raster"] = camera.source is ImageSource.RASTER
    state["object_dense"] = settings.servo.object_kind is ObjectKind.DENSE
    state["object_period_s"], state["object_latency_s"] = _timing(
        "camera", camera.rate_hz, camera.latency_s, settings
    )
    state["ideal"] = hand.kind in (HandSensorKind.IDEAL, HandSensorKind.SURROUND)
    state["eye_in_hand"] = hand.kind is HandSensorKind.EYE_IN_HAND
    state["hand_focal_px"] = hand.focal_px
    state["hand_width_px"], state["hand_height_px"] = hand.width_px, hand.height_px
    state["hand_c_u"], state["hand_c_v"] = sensor_principal_point_px(hand)
    state["hand_radius_m"] = settings.hand.radius_m
    state["forearm_radius_m"] = settings.hand.forearm_radius_m
    state["hand_period_s"], state["hand_latency_s"] = _timing(
        "hand sensor", hand.rate_hz, hand.latency_s, settings
    )
    state["pixel_noise_px"] = hand.pixel_noise_px
    state["depth_noise_per_m"] = hand.depth_noise_per_m
    state["dropout_probability"] = hand.dropout_probability
    state.setflags(write=False)
    return SensorRecords(state)


def _timing(field: str, rate_hz: float | None, latency_s: float, settings: Settings) -> tuple[float, float]:
    """Return the period and the latency [s] of a camera.

    Raise ``SettingsError`` if the ring cannot hold all undelivered frames.
    """
    period_s = 0.0 if rate_hz is None else 1.0 / rate_hz
    under_way = latency_s / max(period_s, settings.clock.control_period_s) + 2.0
    if under_way > RING:
        expected = f"at most {RING - 2} frames under way at a time"
        got = f"{latency_s:g} s, which is {under_way - 2.0:.0f} frames"
        raise SettingsError.of_option(f"{field}.latency", expected, got)
    return period_s, latency_s
