"""What both worlds do in a control tick, compiled: cameras, drives, hands and the truth.

A world calls ``sense``, gives the observation to the controller, then ``drive_on``; it moves the arm in
its own way, and tells ``move_on`` what the joints do now.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from safety_harness.compiled import compiled
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
from safety_harness.simulation.records import WorldRecords
from safety_harness.simulation.sensing import (
    deliver,
    hand_frame_due,
    object_frame_due,
    push_hand_frame,
    push_object_frame,
)
from safety_harness.simulation.truth import fill_truth


@compiled
def now_s(w: WorldRecords) -> float:
    """The start of the coming control tick: a multiple of the period, never a running sum."""
    return float(w.clock[0].tick * w.clock[0].control_period_s)


@compiled
def mount(w: WorldRecords) -> None:
    """Before the cameras look: the hand-eye camera sits where it sits, and the tick's faults begin."""
    w.clock[0].acted_faults = mount_camera(w.faults, w.sensors, now_s(w))


@compiled
def object_is_due(w: WorldRecords) -> bool:
    """Whether the object's camera takes a frame now; asking advances its clock."""
    return object_frame_due(w.sensors, now_s(w))


@compiled
def hands_are_due(w: WorldRecords) -> bool:
    """Whether the hand sensor takes a frame now; asking advances its clock."""
    return hand_frame_due(w.sensors, now_s(w))


@compiled
def exact_object_frame(w: WorldRecords) -> None:
    """Take a frame of the object, in closed form or at pixel centres."""
    moments = np.full(MOMENT_COUNT, np.nan)
    pose = w.truth[0].transform_tcp_to_base
    send_object_frame(w, exact_object(w.sensors, w.polygon_in_base_m, pose, moments), moments)


@compiled
def exact_hand_frame(w: WorldRecords) -> None:
    """Take a frame of the hands' exact bounding boxes."""
    boxes = np.zeros((MAX_DETECTIONS, 5))
    pose = w.truth[0].transform_tcp_to_base
    count = exact_boxes(w.sensors, w.hands, pose, w.placed, w.capsule_radius_m, boxes)
    send_hand_frame(w, boxes, count)


@compiled
def send_object_frame(w: WorldRecords, visible: bool, moments: NDArray[np.float64]) -> None:
    """Put a frame of the object on its way, as the faults leave it."""
    time_s, pose = now_s(w), w.truth[0].transform_tcp_to_base
    push_object_frame(w.sensors, w.object_frames, time_s, visible, moments)
    w.clock[0].acted_faults |= spoil_object_frame(
        w.faults, w.sensors, w.object_frames, w.polygon_in_base_m, w.hands, pose, time_s
    )


@compiled
def send_hand_frame(w: WorldRecords, boxes: NDArray[np.float64], count: int) -> None:
    """Put a frame of boxes (MAX_DETECTIONS, 5) on its way, as noise and the faults leave it."""
    time_s, pose = now_s(w), w.truth[0].transform_tcp_to_base
    push_hand_frame(w.sensors, w.hand_frames, w.normals, w.uniforms, time_s, boxes, count)
    w.clock[0].acted_faults |= spoil_hand_frame(w.faults, w.sensors, w.hand_frames, pose, time_s)


@compiled
def hand_over(w: WorldRecords) -> None:
    """Give the controller what has arrived by now; encoders are exact."""
    deliver(w.sensors, w.object_frames, w.hand_frames, now_s(w), w.observation)
    for i in range(6):
        w.observation[0].joint_position_rad[i] = w.truth[0].joint_position_rad[i]
        w.observation[0].joint_velocity_radps[i] = w.truth[0].joint_velocity_radps[i]


@compiled
def sense(w: WorldRecords) -> None:
    """All of the above, where nothing is rendered."""
    mount(w)
    if object_is_due(w):
        exact_object_frame(w)
    if hands_are_due(w):
        exact_hand_frame(w)
    hand_over(w)


@compiled
def drive_on(w: WorldRecords, commands: NDArray[np.void], told_radps: NDArray[np.float64]) -> bool:
    """Fill what the motors are told (6,) by a command (1,) COMMAND; True while the brakes act."""
    command = commands[0]
    braking = drive_tick(
        w.drives, command.joint_velocity_radps, command.protective_stop, w.truth[0].tcp_speed_mps, now_s(w)
    )
    for i in range(6):
        told_radps[i] = w.drives[0].setpoint_radps[i]
    w.clock[0].acted_faults |= hold_joints(w.faults, told_radps, now_s(w))
    return braking


@compiled
def move_on(
    w: WorldRecords, joint_position_rad: NDArray[np.float64], joint_velocity_radps: NDArray[np.float64]
) -> None:
    """A control period later: the hands have moved, the joints (6,) are there."""
    tcp_in_base_m = w.truth[0].transform_tcp_to_base[:3, 3].copy()
    advance_hands(w.hands, w.moves, w.samples, tcp_in_base_m, now_s(w), w.clock[0].control_period_s)
    w.clock[0].tick += 1
    observe_truth(w, joint_position_rad, joint_velocity_radps)


@compiled
def observe_truth(
    w: WorldRecords, joint_position_rad: NDArray[np.float64], joint_velocity_radps: NDArray[np.float64]
) -> None:
    """Write the truth of now, which follows from the joints (6,) and the hands."""
    fill_truth(
        w.arm,
        w.capsule_link,
        w.capsule_start_in_link,
        w.capsule_end_in_link,
        w.capsule_radius_m,
        w.placed,
        w.hands,
        joint_position_rad,
        joint_velocity_radps,
        now_s(w),
        w.truth,
    )
