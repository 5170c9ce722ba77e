"""What both worlds do in a control tick, compiled: cameras, drives, hands and the truth.

A world calls ``sense``, gives the observation to the controller, then ``drive_on``; it moves the arm in
its own way, and tells ``move_on`` what the joints do now.  The arrays are those of ``WorldRecords``; they
are handed over one by one, for a tuple of them costs more than the steps themselves, and each kind of
record has a type of its own, so that a type checker sees two that are swapped.
"""

from __future__ import annotations

from typing import NewType

import numpy as np
from numpy.typing import NDArray

from safety_harness.compiled import compiled, inlined
from safety_harness.controller.records import CommandRecords, FaultRecords, ObservationRecords
from safety_harness.perception.moments import MOMENT_COUNT
from safety_harness.perception.tracking import MAX_DETECTIONS
from safety_harness.robot.drive import drive_tick
from safety_harness.simulation.exact_views import exact_boxes, exact_object
from safety_harness.simulation.faults import hold_joints, mount_camera, spoil_hand_frame, spoil_object_frame
from safety_harness.simulation.hand_motion import advance_hands
from safety_harness.simulation.sensing import (
    deliver,
    hand_frame_due,
    object_frame_due,
    push_hand_frame,
    push_object_frame,
)
from safety_harness.simulation.truth import fill_truth

Records = NDArray[np.void]
Floats = NDArray[np.float64]
ClockRecords = NewType("ClockRecords", Records)  # (1,) CLOCK
ArmRecords = NewType("ArmRecords", Records)  # (1,) ARM
CapsuleRecords = NewType("CapsuleRecords", Records)  # (n,) CAPSULE
HandRecords = NewType("HandRecords", Records)  # (MAX_HANDS,) HAND
MoveRecords = NewType("MoveRecords", Records)  # (m,) MOVE
SensorRecords = NewType("SensorRecords", Records)  # (1,) SENSORS
ObjectFrames = NewType("ObjectFrames", Records)  # (RING,) OBJECT_FRAME
HandFrames = NewType("HandFrames", Records)  # (RING,) HAND_FRAME
DriveRecords = NewType("DriveRecords", Records)  # (1,) DRIVE
TruthRecords = NewType("TruthRecords", Records)  # (1,) TICK_COMPILED


@inlined
def now_s(clocks: ClockRecords) -> float:
    """The start of the coming control tick: a multiple of the period, never a running sum."""
    return float(clocks[0].tick * clocks[0].control_period_s)


@inlined
def sense(
    clocks: ClockRecords,
    sensors: SensorRecords,
    object_frames: ObjectFrames,
    hand_frames: HandFrames,
    polygon_in_base_m: Floats,  # (m, 3)
    normals: Floats,  # (frames, MAX_DETECTIONS, 3)
    uniforms: Floats,  # (frames, MAX_DETECTIONS)
    hands: HandRecords,
    capsules: CapsuleRecords,
    capsule_endpoints_in_base_m: Floats,  # (n, 2, 3)
    faults: FaultRecords,
    truths: TruthRecords,
    observations: ObservationRecords,
) -> None:
    """Let the exact cameras take what is due, and give the controller what has arrived by now."""
    mount(clocks, sensors, faults)
    if object_frame_due(sensors, now_s(clocks)):
        exact_object_frame(clocks, sensors, object_frames, polygon_in_base_m, hands, faults, truths)
    if hand_frame_due(sensors, now_s(clocks)):
        exact_hand_frame(
            clocks,
            sensors,
            hand_frames,
            normals,
            uniforms,
            hands,
            capsules,
            capsule_endpoints_in_base_m,
            faults,
            truths,
        )
    hand_over(clocks, sensors, object_frames, hand_frames, truths, observations)


@inlined
def mount(clocks: ClockRecords, sensors: SensorRecords, faults: FaultRecords) -> None:
    """Before the cameras look: the hand-eye camera sits where it sits, and the tick's faults begin."""
    clocks[0].acted_faults = mount_camera(faults, sensors, now_s(clocks)) if faults.shape[0] > 0 else 0


@compiled
def exact_object_frame(
    clocks: ClockRecords,
    sensors: SensorRecords,
    object_frames: ObjectFrames,
    polygon_in_base_m: Floats,  # (m, 3)
    hands: HandRecords,
    faults: FaultRecords,
    truths: TruthRecords,
) -> None:
    """Take a frame of the object, in closed form or at pixel centres."""
    moments = np.full(MOMENT_COUNT, np.nan)
    visible = exact_object(sensors, polygon_in_base_m, truths[0].transform_tcp_to_base, moments)
    send_object_frame(
        clocks, sensors, object_frames, polygon_in_base_m, hands, faults, truths, visible, moments
    )


@inlined
def send_object_frame(
    clocks: ClockRecords,
    sensors: SensorRecords,
    object_frames: ObjectFrames,
    polygon_in_base_m: Floats,  # (m, 3)
    hands: HandRecords,
    faults: FaultRecords,
    truths: TruthRecords,
    visible: bool,
    moments: Floats,  # (31,)
) -> None:
    """Put a frame of the object on its way, as the faults leave it."""
    time_s, pose = now_s(clocks), truths[0].transform_tcp_to_base
    push_object_frame(sensors, object_frames, time_s, visible, moments)
    if faults.shape[0] > 0:
        clocks[0].acted_faults |= spoil_object_frame(
            faults, sensors, object_frames, polygon_in_base_m, hands, pose, time_s
        )


@compiled
def exact_hand_frame(
    clocks: ClockRecords,
    sensors: SensorRecords,
    hand_frames: HandFrames,
    normals: Floats,  # (frames, MAX_DETECTIONS, 3)
    uniforms: Floats,  # (frames, MAX_DETECTIONS)
    hands: HandRecords,
    capsules: CapsuleRecords,
    capsule_endpoints_in_base_m: Floats,  # (n, 2, 3)
    faults: FaultRecords,
    truths: TruthRecords,
) -> None:
    """Take a frame of the hands' exact bounding boxes."""
    boxes = np.zeros((MAX_DETECTIONS, 5))
    pose = truths[0].transform_tcp_to_base
    count = exact_boxes(sensors, hands, pose, capsules, capsule_endpoints_in_base_m, boxes)
    send_hand_frame(clocks, sensors, hand_frames, normals, uniforms, faults, truths, boxes, count)


@inlined
def send_hand_frame(
    clocks: ClockRecords,
    sensors: SensorRecords,
    hand_frames: HandFrames,
    normals: Floats,  # (frames, MAX_DETECTIONS, 3)
    uniforms: Floats,  # (frames, MAX_DETECTIONS)
    faults: FaultRecords,
    truths: TruthRecords,
    boxes: Floats,  # (MAX_DETECTIONS, 5)
    count: int,
) -> None:
    """Put a frame of boxes on its way, as noise and the faults leave it."""
    time_s, pose = now_s(clocks), truths[0].transform_tcp_to_base
    push_hand_frame(sensors, hand_frames, normals, uniforms, time_s, boxes, count)
    if faults.shape[0] > 0:
        clocks[0].acted_faults |= spoil_hand_frame(faults, sensors, hand_frames, pose, time_s)


@inlined
def hand_over(
    clocks: ClockRecords,
    sensors: SensorRecords,
    object_frames: ObjectFrames,
    hand_frames: HandFrames,
    truths: TruthRecords,
    observations: ObservationRecords,
) -> None:
    """Give the controller what has arrived by now; encoders are exact."""
    o, truth = observations[0], truths[0]
    deliver(sensors, object_frames, hand_frames, now_s(clocks), observations)
    for i in range(6):
        o.joint_position_rad[i] = truth.joint_position_rad[i]
        o.joint_velocity_radps[i] = truth.joint_velocity_radps[i]


@inlined
def drive_on(
    clocks: ClockRecords,
    drives: DriveRecords,
    faults: FaultRecords,
    truths: TruthRecords,
    commands: CommandRecords,
    commanded_radps: Floats,  # (6,), written
) -> bool:
    """Fill what the motors are told (6,) by a command (1,) COMMAND; True while the brakes act."""
    command, d, time_s = commands[0], drives[0], now_s(clocks)
    braking = drive_tick(
        drives, command.joint_velocity_radps, command.protective_stop, truths[0].tcp_speed_mps, time_s
    )
    for i in range(6):
        commanded_radps[i] = d.setpoint_radps[i]
    if faults.shape[0] > 0:
        clocks[0].acted_faults |= hold_joints(faults, commanded_radps, time_s)
    return bool(braking)


@inlined
def move_on(
    clocks: ClockRecords,
    hands: HandRecords,
    moves: MoveRecords,
    samples: Floats,  # (s, 7)
    arms: ArmRecords,
    capsules: CapsuleRecords,
    capsule_endpoints_in_base_m: Floats,  # (n, 2, 3)
    truths: TruthRecords,
    joint_position_rad: Floats,  # (6,)
    joint_velocity_radps: Floats,  # (6,)
) -> None:
    """A control period later: the hands have moved, the joints (6,) are there; write the truth of then."""
    clock = clocks[0]
    for i in range(3):
        clock.tcp_in_base_m[i] = truths[0].transform_tcp_to_base[i, 3]
    advance_hands(hands, moves, samples, clock.tcp_in_base_m, now_s(clocks), clock.control_period_s)
    clock.tick += 1
    fill_truth(
        arms,
        capsules,
        capsule_endpoints_in_base_m,
        hands,
        joint_position_rad,
        joint_velocity_radps,
        now_s(clocks),
        truths,
    )
