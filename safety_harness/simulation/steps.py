"""What both worlds do in a control tick, compiled: cameras, drives, hands and the truth.

A world calls ``sense``, gives the observation to the controller, then ``drive_on``; it moves the arm in
its own way, and tells ``move_on`` what the joints do now.  The arrays are those of ``WorldRecords``; they
are handed over one by one, for a tuple of them costs more than the steps themselves.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from safety_harness.compiled import compiled, inlined
from safety_harness.perception.moments import MOMENT_COUNT
from safety_harness.perception.tracking import MAX_DETECTIONS
from safety_harness.robot.drive import drive_tick
from safety_harness.simulation.exact_views import exact_boxes, exact_object
from safety_harness.simulation.faults import (
    hold_joints,
    mount_camera,
    spoil_hand_frame,
    spoil_object_frame,
)
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


@inlined
def now_s(clocks: Records) -> float:
    """The start of the coming control tick: a multiple of the period, never a running sum."""
    return float(clocks[0].tick * clocks[0].control_period_s)


@inlined
def sense(
    clocks: Records,
    sensors: Records,
    object_frames: Records,
    hand_frames: Records,
    polygon_in_base_m: Floats,
    normals: Floats,
    uniforms: Floats,
    hands: Records,
    placed: Floats,
    capsule_radius_m: Floats,
    faults: Records,
    truths: Records,
    observations: Records,
) -> None:
    """Let the exact cameras take what is due, and give the controller what has arrived by now."""
    mount(clocks, sensors, faults)
    if object_frame_due(sensors, now_s(clocks)):
        exact_object_frame(clocks, sensors, object_frames, polygon_in_base_m, hands, faults, truths)
    if hand_frame_due(sensors, now_s(clocks)):
        exact_hand_frame(
            clocks, sensors, hand_frames, normals, uniforms, hands, placed, capsule_radius_m, faults, truths
        )
    hand_over(clocks, sensors, object_frames, hand_frames, truths, observations)


@inlined
def mount(clocks: Records, sensors: Records, faults: Records) -> None:
    """Before the cameras look: the hand-eye camera sits where it sits, and the tick's faults begin."""
    clocks[0].acted_faults = mount_camera(faults, sensors, now_s(clocks)) if faults.shape[0] > 0 else 0


@compiled
def exact_object_frame(
    clocks: Records,
    sensors: Records,
    object_frames: Records,
    polygon_in_base_m: Floats,
    hands: Records,
    faults: Records,
    truths: Records,
) -> None:
    """Take a frame of the object, in closed form or at pixel centres."""
    moments = np.full(MOMENT_COUNT, np.nan)
    visible = exact_object(sensors, polygon_in_base_m, truths[0].transform_tcp_to_base, moments)
    send_object_frame(
        clocks, sensors, object_frames, polygon_in_base_m, hands, faults, truths, visible, moments
    )


@inlined
def send_object_frame(
    clocks: Records,
    sensors: Records,
    object_frames: Records,
    polygon_in_base_m: Floats,
    hands: Records,
    faults: Records,
    truths: Records,
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
    clocks: Records,
    sensors: Records,
    hand_frames: Records,
    normals: Floats,
    uniforms: Floats,
    hands: Records,
    placed: Floats,
    capsule_radius_m: Floats,
    faults: Records,
    truths: Records,
) -> None:
    """Take a frame of the hands' exact bounding boxes."""
    boxes = np.zeros((MAX_DETECTIONS, 5))
    pose = truths[0].transform_tcp_to_base
    count = exact_boxes(sensors, hands, pose, placed, capsule_radius_m, boxes)
    send_hand_frame(clocks, sensors, hand_frames, normals, uniforms, faults, truths, boxes, count)


@inlined
def send_hand_frame(
    clocks: Records,
    sensors: Records,
    hand_frames: Records,
    normals: Floats,
    uniforms: Floats,
    faults: Records,
    truths: Records,
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
    clocks: Records,
    sensors: Records,
    object_frames: Records,
    hand_frames: Records,
    truths: Records,
    observations: Records,
) -> None:
    """Give the controller what has arrived by now; encoders are exact."""
    o, truth = observations[0], truths[0]
    deliver(sensors, object_frames, hand_frames, now_s(clocks), observations)
    for i in range(6):
        o.joint_position_rad[i] = truth.joint_position_rad[i]
        o.joint_velocity_radps[i] = truth.joint_velocity_radps[i]


@inlined
def drive_on(
    clocks: Records,
    drives: Records,
    faults: Records,
    truths: Records,
    commands: Records,
    commanded_radps: Floats,
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
    clocks: Records,
    hands: Records,
    moves: Records,
    samples: Floats,
    arms: Records,
    capsule_link: NDArray[np.int64],
    capsule_start_in_link: Floats,
    capsule_end_in_link: Floats,
    capsule_radius_m: Floats,
    placed: Floats,
    truths: Records,
    joint_position_rad: Floats,
    joint_velocity_radps: Floats,
) -> None:
    """A control period later: the hands have moved, the joints (6,) are there; write the truth of then."""
    clock = clocks[0]
    for i in range(3):
        clock.tcp_in_base_m[i] = truths[0].transform_tcp_to_base[i, 3]
    advance_hands(hands, moves, samples, clock.tcp_in_base_m, now_s(clocks), clock.control_period_s)
    clock.tick += 1
    fill_truth(
        arms,
        capsule_link,
        capsule_start_in_link,
        capsule_end_in_link,
        capsule_radius_m,
        placed,
        hands,
        joint_position_rad,
        joint_velocity_radps,
        now_s(clocks),
        truths,
    )
