"""Apply faults of sensors and joints in both worlds.

Each function returns an integer with a bit for each fault. The bit is set if the fault acts, that is, if it
changes something. For example, a fault that blinds a sensor does not act if there is no hand in view.

A world calls ``mount_camera`` before its cameras take frames. The world calls ``spoil_object_frame`` and
``spoil_hand_frame`` on each new frame, and ``hold_joints`` on the motors' set points. Without faults these
functions change nothing. The noise depends on the frame's number, so a fault never shifts the noise.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import compiled
from safety_harness.base.geometry.arrays import Array3, Array4x4, ArrayN, ArrayNx3
from safety_harness.base.geometry.linear import copy_matrix, copy_vector
from safety_harness.base.geometry.pyramids import segment_pyramid_distance
from safety_harness.base.geometry.rotations import rotation_from_vector
from safety_harness.base.geometry.transforms import compose_into, inverse_transform
from safety_harness.cell.controller.records import FaultRecords
from safety_harness.cell.simulation.cameras import RING, HandFrames, ObjectFrames, SensorRecords
from safety_harness.cell.simulation.exact_views import hand_box, sensor_pose
from safety_harness.cell.simulation.hand_motion import HandRecords
from safety_harness.scenario.fault_table import acting, acts, delay_s
from safety_harness.scenario.faults import FaultKind


@compiled
def mount_camera(faults: FaultRecords, sensors: SensorRecords, time_s: float) -> int:
    """Set the pose of the hand-eye camera at ``time_s``.

    The camera is in its mount, unless a fault has knocked it out.
    """
    s = sensors[0]
    bits = acting(faults, FaultKind.CAMERA_KNOCKED, time_s)
    copy_matrix(s.transform_mount_to_tcp, s.transform_camera_to_tcp)
    if bits == 0:
        return 0
    mounted = np.empty((3, 3))
    for k in range(faults.shape[0]):
        if not acts(faults, k, FaultKind.CAMERA_KNOCKED, time_s):
            continue
        copy_matrix(s.transform_camera_to_tcp[:3, :3], mounted)
        # On the right: the knock is stated in the camera's own frame. Several knocks follow each other.
        turned = rotation_from_vector(faults[k].turned_rad.copy())
        for i in range(3):
            for j in range(3):
                s.transform_camera_to_tcp[i, j] = (
                    mounted[i, 0] * turned[0, j] + mounted[i, 1] * turned[1, j] + mounted[i, 2] * turned[2, j]
                )
            s.transform_camera_to_tcp[i, 3] += faults[k].vector_m[i]
    return bits


@compiled
def spoil_object_frame(
    faults: FaultRecords,
    sensors: SensorRecords,
    frames: ObjectFrames,  # the newest is changed
    polygon_in_base_m: ArrayNx3,
    hands: HandRecords,
    transform_tcp_to_base: Array4x4,
    time_s: float,
) -> int:
    """Apply the faults to the object's newest frame.

    A frozen camera repeats the previous frame.
    """
    s = sensors[0]
    frame = frames[(s.object_frames - 1) % RING]
    bits = 0
    # Hidden before blind: a blind camera acts only on a frame that would still show the object.
    hidden = acting(faults, FaultKind.CAMERA_HIDDEN, time_s)
    if hidden and hides_object(sensors, polygon_in_base_m, hands, transform_tcp_to_base):
        frame.visible = False
        bits |= hidden
    blind = acting(faults, FaultKind.CAMERA_BLIND, time_s) if frame.visible else 0
    if blind:
        frame.visible = False
    # Frozen comes last, because it replaces the frame with all earlier faults.
    frozen = acting(faults, FaultKind.CAMERA_FROZEN, time_s)
    if frozen:
        frame.visible = False
        if s.object_frames > 1:
            earlier = frames[(s.object_frames - 2) % RING]
            frame.visible = earlier.visible
            copy_vector(earlier.moments, frame.moments)
    frame.late_s = delay_s(faults, FaultKind.CAMERA_LATE, time_s)
    return bits | blind | frozen | acting(faults, FaultKind.CAMERA_LATE, time_s)


@compiled
def hides_object(
    sensors: SensorRecords, polygon_in_base_m: ArrayNx3, hands: HandRecords, transform_tcp_to_base: Array4x4
) -> bool:
    """Return whether a part of a hand or forearm is between the camera's lens and a part of the object."""
    s = sensors[0]
    camera_to_base = np.empty((4, 4))
    compose_into(transform_tcp_to_base, s.transform_camera_to_tcp, camera_to_base)
    lens = camera_to_base[:3, 3].copy()
    for k in range(hands.shape[0]):
        if not hands[k].present:
            continue
        hand, elbow = hands[k].position_in_base_m.copy(), hands[k].elbow_in_base_m.copy()
        if segment_pyramid_distance(hand, hand, lens, polygon_in_base_m) < s.hand_radius_m:
            return True
        if segment_pyramid_distance(hand, elbow, lens, polygon_in_base_m) < s.forearm_radius_m:
            return True
    return False


@compiled
def spoil_hand_frame(
    faults: FaultRecords,
    sensors: SensorRecords,
    frames: HandFrames,
    transform_tcp_to_base: Array4x4,
    time_s: float,
) -> int:
    """Apply the faults to the hand sensor's newest frame of boxes.

    First measurement errors shift the hands, then the function adds false hands. Then a blind sensor drops
    all hands. Finally a frozen sensor repeats the previous frame.
    """
    s = sensors[0]
    frame = frames[(s.hand_frames - 1) % RING]
    shifted = acting(faults, FaultKind.HAND_SENSOR_OFF, time_s) if frame.count else 0
    false = acting(faults, FaultKind.FALSE_HAND, time_s)
    bits = shifted
    if shifted or false:
        pose = sensor_pose(sensors, transform_tcp_to_base)
        base_to_sensor = inverse_transform(pose)
        for k in range(faults.shape[0]):
            if acts(faults, k, FaultKind.HAND_SENSOR_OFF, time_s):
                frame.count = shift_boxes(sensors, pose, faults[k].vector_m.copy(), frame.boxes, frame.count)
        for k in range(faults.shape[0]):
            if (
                acts(faults, k, FaultKind.FALSE_HAND, time_s)
                and frame.count < frame.boxes.shape[0]
                and hand_box(sensors, base_to_sensor, faults[k].vector_m.copy(), frame.boxes[frame.count])
            ):
                frame.count += 1
                bits |= 1 << k
    blind = acting(faults, FaultKind.HAND_SENSOR_BLIND, time_s) if frame.count else 0
    if blind:
        frame.count = 0
    seen, frozen = frame.count, acting(faults, FaultKind.HAND_SENSOR_FROZEN, time_s)
    if frozen:
        frame.count = 0
        if s.hand_frames > 1:
            earlier = frames[(s.hand_frames - 2) % RING]
            frame.count = earlier.count
            copy_matrix(earlier.boxes, frame.boxes)
    # An empty frame in place of an empty frame changes nothing, so the fault did not act.
    if seen == 0 and frame.count == 0:
        frozen = 0
    if frame.count:  # a late frame makes no difference if it is empty
        bits |= acting(faults, FaultKind.HAND_SENSOR_LATE, time_s)
    frame.late_s = delay_s(faults, FaultKind.HAND_SENSOR_LATE, time_s)
    return bits | blind | frozen


@compiled
def shift_boxes(
    sensors: SensorRecords,
    transform_sensor_to_base: Array4x4,
    by_in_base_m: Array3,
    boxes: NDArray[np.float64],  # (n, 5), changed in place
    count: int,
) -> int:
    """Shift the hands in ``boxes`` by a measurement error.

    Return the number of hands that remain in front of the sensor. The function moves the point at a box's
    centre and depth by ``by_in_base_m``. The box's size in the image changes with the depth.
    """
    s = sensors[0]
    shift = np.zeros(3)
    for i in range(3):
        for j in range(3):
            shift[i] += transform_sensor_to_base[j, i] * by_in_base_m[j]
    kept = 0
    for k in range(count):
        depth = boxes[k, 2]
        x = (boxes[k, 0] - s.hand_c_u) / s.hand_focal_px * depth + shift[0]
        y = (boxes[k, 1] - s.hand_c_v) / s.hand_focal_px * depth + shift[1]
        z = depth + shift[2]
        # A point behind the sensor has no pixel.
        if not z > 0.0:
            continue
        boxes[kept, 0] = s.hand_focal_px * x / z + s.hand_c_u
        boxes[kept, 1] = s.hand_focal_px * y / z + s.hand_c_v
        boxes[kept, 2] = z
        # The area in the image falls with the square of the depth.
        boxes[kept, 3] = boxes[k, 3] * (depth / z) ** 2
        boxes[kept, 4] = boxes[k, 4]
        kept += 1
    return kept


@compiled
def hold_joints(faults: FaultRecords, velocity_radps: ArrayN, time_s: float) -> int:
    """Set the motors' set points of stuck joints to zero, and return the acting faults as bits."""
    bits = 0
    for k in range(faults.shape[0]):
        if acts(faults, k, FaultKind.JOINT_STUCK, time_s) and velocity_radps[faults[k].joint] != 0.0:
            velocity_radps[faults[k].joint] = 0.0
            bits |= 1 << k
    return bits
