"""What the cameras deliver: frames at their rate, late by their latency, with their noise.

A frame is taken at the first control tick at or after its due time, and delivered at the first
tick at or after that plus the latency; one that a fault holds back holds back those behind it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from safety_harness.compiled import inlined
from safety_harness.geometry.linear import copy_matrix, copy_vector
from safety_harness.simulation.cameras import RING

TIME_EPS_S = 1e-9


@inlined
def take_due(time_s: float, period_s: float, due_s: float) -> tuple[bool, float]:
    """Is a frame due at ``time_s``, and when is the one after it?"""
    if period_s <= 0.0:
        return True, time_s
    if time_s < due_s - TIME_EPS_S:
        return False, due_s
    return True, (np.floor((time_s + TIME_EPS_S) / period_s) + 1.0) * period_s


@inlined
def object_frame_due(sensors: NDArray[np.void], time_s: float) -> bool:
    """Whether the object's camera takes a frame at this tick; asking advances its clock.

    ``sensors`` (1,) SENSORS.
    """
    s = sensors[0]
    due, s.object_due_s = take_due(time_s, s.object_period_s, s.object_due_s)
    return due


@inlined
def hand_frame_due(sensors: NDArray[np.void], time_s: float) -> bool:
    """Whether the hand sensor takes a frame at this tick; asking advances its clock.

    ``sensors`` (1,) SENSORS.
    """
    s = sensors[0]
    due, s.hand_due_s = take_due(time_s, s.hand_period_s, s.hand_due_s)
    return due


@inlined
def push_object_frame(
    sensors: NDArray[np.void],  # (1,) SENSORS
    frames: NDArray[np.void],  # (RING,) of the kind
    time_s: float,
    visible: bool,
    moments: NDArray[np.float64],  # (31,)
) -> None:
    """Put a frame of the object on its way."""
    s = sensors[0]
    frame = frames[s.object_frames % RING]
    frame.time_s, frame.late_s = time_s, 0.0
    frame.visible = visible
    copy_vector(moments, frame.moments)
    s.object_frames += 1


@inlined
def push_hand_frame(
    sensors: NDArray[np.void],  # (1,) SENSORS
    frames: NDArray[np.void],  # (RING,) of the kind
    normals: NDArray[np.float64],  # (frames, MAX_DETECTIONS, 3)
    uniforms: NDArray[np.float64],  # (frames, MAX_DETECTIONS)
    time_s: float,
    boxes: NDArray[np.float64],  # (MAX_DETECTIONS, 5)
    count: int,
) -> None:
    """Put a frame of boxes on its way: some hands are missed, the others get pixel and depth noise.

    Depth noise grows with the square of the depth, as a stereo camera's does.
    """
    s = sensors[0]
    frame = frames[s.hand_frames % RING]
    frame.time_s, frame.late_s = time_s, 0.0
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


@inlined
def deliver(
    sensors: NDArray[np.void],  # (1,) SENSORS
    object_frames: NDArray[np.void],  # (RING,) OBJECT_FRAME
    hand_frames: NDArray[np.void],  # (RING,) HAND_FRAME
    time_s: float,
    observations: NDArray[np.void],  # (1,) OBSERVATION
) -> None:
    """Hand over what has arrived by ``time_s``; with several at once, the newest."""
    s, o = sensors[0], observations[0]
    o.time_s = time_s
    o.image_new = False
    while s.object_delivered < s.object_frames:
        frame = object_frames[s.object_delivered % RING]
        if frame.time_s + s.object_latency_s + frame.late_s > time_s + TIME_EPS_S:
            break
        o.image_new = True
        o.object_visible = frame.visible
        copy_vector(frame.moments, o.moments)
        s.object_delivered += 1
    o.boxes_new = False
    while s.hand_delivered < s.hand_frames:
        hand_frame = hand_frames[s.hand_delivered % RING]
        if hand_frame.time_s + s.hand_latency_s + hand_frame.late_s > time_s + TIME_EPS_S:
            break
        o.boxes_new = True
        o.boxes_time_s = hand_frame.time_s
        o.box_count = hand_frame.count
        copy_matrix(hand_frame.boxes, o.boxes)
        s.hand_delivered += 1
