"""Compute the parts of a control tick that both worlds share: cameras, drives, hands and the truth.

A world calls ``sense``, gives the observation to the controller, then calls ``drive_on``. The world moves the
arm in its own way and passes the new joint state to ``move_on``. The functions take the arrays of
``WorldRecords``, in the order of that class. The arrays are separate arguments, because a tuple costs more
time than the steps themselves. Each kind of record has a type of its own, so that a type checker notices two
swapped arguments.

A camera takes a frame at the first control tick at or after the frame's due time. The camera delivers the
frame at the first tick at or after this tick plus the latency. If a fault delays a frame, the later frames
wait too.
"""

from __future__ import annotations

from typing import NewType

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import inlined
from safety_harness.base.geometry.arrays import Array31, ArrayN, ArrayNx2x3, ArrayNx3
from safety_harness.base.geometry.linear import copy_matrix, copy_vector
from safety_harness.cell.controller.records import CommandRecords, FaultRecords, ObservationRecords
from safety_harness.cell.perception.moments import MOMENT_COUNT
from safety_harness.cell.robot.distance import CapsuleRecords
from safety_harness.cell.robot.drive import DriveRecords, drive_tick, limit_torques, tell_motors
from safety_harness.cell.simulation.cameras import RING, HandFrames, ObjectFrames, SensorRecords
from safety_harness.cell.simulation.exact_views import exact_boxes, exact_object
from safety_harness.cell.simulation.faults import (
    hold_joints,
    mount_camera,
    spoil_hand_frame,
    spoil_object_frame,
)
from safety_harness.cell.simulation.hand_motion import HandRecords, MoveRecords, advance_hands
from safety_harness.cell.simulation.truth import fill_truth
from safety_harness.scenario.fault_table import TIME_EPS_S

Records = NDArray[np.void]
Floats = NDArray[np.float64]
ClockRecords = NewType("ClockRecords", Records)  # (1,) CLOCK
ArmRecords = NewType("ArmRecords", Records)  # (1,) ARM
TruthRecords = NewType("TruthRecords", Records)  # (1,) of a tick ``as_compiled``


@inlined
def now_s(clocks: ClockRecords) -> float:
    """Return the start [s] of the coming control tick.

    This time is a multiple of the period, not a running sum.
    """
    return float(clocks[0].tick * clocks[0].control_period_s)


@inlined
def sense(
    truths: TruthRecords,
    hands: HandRecords,
    capsules: CapsuleRecords,
    capsule_endpoints_in_base_m: ArrayNx2x3,
    clocks: ClockRecords,
    faults: FaultRecords,
    observations: ObservationRecords,
    sensors: SensorRecords,
    object_frames: ObjectFrames,
    hand_frames: HandFrames,
    polygon_in_base_m: ArrayNx3,
    normals: Floats,  # (frames, boxes, 3)
    uniforms: Floats,  # (frames, boxes)
) -> None:
    """Let the exact cameras take each frame that is due.

    Then give the controller each frame that has arrived.
    """
    mount(clocks, faults, sensors)
    pose = truths[0].transform_tcp_to_base
    if object_frame_due(clocks, sensors):
        moments = object_frames[sensors[0].object_frames % RING].moments  # filled in place, without a copy
        for i in range(MOMENT_COUNT):
            moments[i] = np.nan
        visible = exact_object(sensors, polygon_in_base_m, pose, moments)
        send_object_frame(
            truths, hands, clocks, faults, sensors, object_frames, polygon_in_base_m, visible, moments
        )
    if hand_frame_due(clocks, sensors):
        boxes = hand_frames[sensors[0].hand_frames % RING].boxes
        count = exact_boxes(sensors, hands, pose, capsules, capsule_endpoints_in_base_m, boxes)
        send_hand_frame(truths, clocks, faults, sensors, hand_frames, normals, uniforms, boxes, count)
    hand_over(truths, clocks, observations, sensors, object_frames, hand_frames)


@inlined
def mount(clocks: ClockRecords, faults: FaultRecords, sensors: SensorRecords) -> None:
    """Set the pose of the hand-eye camera before the cameras take frames.

    The function also sets the first bits of the tick's faults.
    """
    clocks[0].acted_faults = mount_camera(faults, sensors, now_s(clocks)) if faults.shape[0] > 0 else 0


@inlined
def object_frame_due(clocks: ClockRecords, sensors: SensorRecords) -> bool:
    """Return whether the object's camera takes a frame at this tick.

    If it does, set the next due time.
    """
    s = sensors[0]
    due, s.object_due_s = take_due(now_s(clocks), s.object_period_s, s.object_due_s)
    return due


@inlined
def hand_frame_due(clocks: ClockRecords, sensors: SensorRecords) -> bool:
    """Return whether the hand sensor takes a frame at this tick.

    If it does, set the next due time.
    """
    s = sensors[0]
    due, s.hand_due_s = take_due(now_s(clocks), s.hand_period_s, s.hand_due_s)
    return due


@inlined
def take_due(time_s: float, period_s: float, due_s: float) -> tuple[bool, float]:
    """Return whether a frame is due at ``time_s``, and the due time of the next frame."""
    if period_s <= 0.0:
        return True, time_s
    if time_s < due_s - TIME_EPS_S:
        return False, due_s
    # The next multiple of the period after now: rounding never accumulates, and a missed frame stays missed.
    return True, (np.floor((time_s + TIME_EPS_S) / period_s) + 1.0) * period_s


@inlined
def send_object_frame(
    truths: TruthRecords,
    hands: HandRecords,
    clocks: ClockRecords,
    faults: FaultRecords,
    sensors: SensorRecords,
    object_frames: ObjectFrames,
    polygon_in_base_m: ArrayNx3,
    visible: bool,
    moments: Array31,
) -> None:
    """Store a new frame of the object for later delivery.

    The function applies the faults to the frame.
    """
    s, time_s = sensors[0], now_s(clocks)
    frame = object_frames[s.object_frames % RING]
    frame.time_s, frame.late_s = time_s, 0.0
    frame.visible = visible
    copy_vector(moments, frame.moments)
    s.object_frames += 1
    if faults.shape[0] > 0:
        pose = truths[0].transform_tcp_to_base
        clocks[0].acted_faults |= spoil_object_frame(
            faults, sensors, object_frames, polygon_in_base_m, hands, pose, time_s
        )


@inlined
def send_hand_frame(
    truths: TruthRecords,
    clocks: ClockRecords,
    faults: FaultRecords,
    sensors: SensorRecords,
    hand_frames: HandFrames,
    normals: Floats,  # (frames, boxes, 3)
    uniforms: Floats,  # (frames, boxes)
    boxes: Floats,  # (n, 5)
    count: int,
) -> None:
    """Store a new frame of boxes for later delivery.

    The function applies noise and faults to the frame. ``boxes`` may be the frame's own array. The sensor
    misses some hands. The other boxes get pixel and depth noise. The depth noise grows with the square of the
    depth, as in a stereo camera.
    """
    s, time_s = sensors[0], now_s(clocks)
    frame = hand_frames[s.hand_frames % RING]
    frame.time_s, frame.late_s = time_s, 0.0
    kept = 0
    # Noise belongs to the frame's and the box's number. A missed hand therefore does not shift the noise of
    # another.
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
    if faults.shape[0] > 0:
        pose = truths[0].transform_tcp_to_base
        clocks[0].acted_faults |= spoil_hand_frame(faults, sensors, hand_frames, pose, time_s)


@inlined
def hand_over(
    truths: TruthRecords,
    clocks: ClockRecords,
    observations: ObservationRecords,
    sensors: SensorRecords,
    object_frames: ObjectFrames,
    hand_frames: HandFrames,
) -> None:
    """Give the controller the newest frames that have arrived by now, and the exact joint state."""
    s, o, truth, time_s = sensors[0], observations[0], truths[0], now_s(clocks)
    o.time_s = time_s
    o.image_new = False
    # Several frames may arrive at once after a delay; the controller gets the newest.
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
    copy_vector(truth.joint_position_rad, o.joint_position_rad)
    copy_vector(truth.joint_velocity_radps, o.joint_velocity_radps)


@inlined
def drive_on(
    drives: DriveRecords,
    arms: ArmRecords,
    truths: TruthRecords,
    clocks: ClockRecords,
    faults: FaultRecords,
    commands: CommandRecords,
    commanded_radps: ArrayN,
) -> bool:
    """Fill the motors' set points ``commanded_radps`` from a command.

    Return True while the brakes act.
    """
    command, time_s = commands[0], now_s(clocks)
    braking = drive_tick(
        drives, command.joint_velocity_radps, command.protective_stop, truths[0].tcp_speed_mps, time_s
    )
    # The torque limit changes the set points, so it comes before the motors read them. A stuck joint
    # overrides both.
    if drives[0].limited:
        limit_torques(drives, arms[0].chain.joint_axes, arms[0].link_transforms)
    tell_motors(drives, commanded_radps)
    if faults.shape[0] > 0:
        clocks[0].acted_faults |= hold_joints(faults, commanded_radps, time_s)
    return bool(braking)


@inlined
def move_on(
    moves: MoveRecords,
    samples: Floats,  # (s, 7)
    arms: ArmRecords,
    truths: TruthRecords,
    hands: HandRecords,
    capsules: CapsuleRecords,
    capsule_endpoints_in_base_m: ArrayNx2x3,
    clocks: ClockRecords,
    joints_rad: ArrayN,
    joints_radps: ArrayN,
) -> None:
    """Move the hands for a control period, and write the truth at the end of the period.

    The joint state at the end is an argument.
    """
    clock = clocks[0]
    for i in range(3):
        clock.tcp_in_base_m[i] = truths[0].transform_tcp_to_base[i, 3]
    # The hands aim at the TCP of the period's start, so they move before the truth of its end is written.
    advance_hands(hands, moves, samples, clock.tcp_in_base_m, now_s(clocks), clock.control_period_s)
    clock.tick += 1
    fill_truth(
        arms, truths, hands, capsules, capsule_endpoints_in_base_m, joints_rad, joints_radps, now_s(clocks)
    )
