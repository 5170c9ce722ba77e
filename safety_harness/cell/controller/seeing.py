"""Compute a user controller's view from an observation, and the command from the controller's action."""

from __future__ import annotations

from typing import NamedTuple, NewType

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import compiled, njit_no_nrt
from safety_harness.base.geometry.linear import copy_matrix, copy_vector
from safety_harness.base.geometry.transforms import compose_into
from safety_harness.base.settings import Settings
from safety_harness.cell.controller.records import (
    CommandRecords,
    FilterRecords,
    ObservationRecords,
    ParameterRecords,
    StateRecords,
    TrackRecords,
    command_dtype,
    initial_state,
    parameters,
)
from safety_harness.cell.controller.stack import (
    STANDSTILL_RADPS,
    clip_joints,
    command_arm,
    see_hands,
    see_object,
)
from safety_harness.cell.perception.hand_boxes import position_from_box
from safety_harness.cell.perception.hand_filter import filter_parameters
from safety_harness.cell.perception.tracking import no_tracks
from safety_harness.cell.robot.description import ArmModel
from safety_harness.cell.robot.kinematics import forward_kinematics, geometric_jacobian
from safety_harness.cell.servoing.control import DesiredView
from safety_harness.seams.rows import seen_dtype
from safety_harness.trace.records import Limit, Mode

SERVOING, PROTECTIVE_STOP = int(Mode.SERVOING), int(Mode.PROTECTIVE_STOP)
JOINT_SPEED = int(Limit.JOINT_SPEED)


SeenRecords = NewType("SeenRecords", NDArray[np.void])  # (1,) SEEN


class DrivenRecords(NamedTuple):
    """All records that connect the observations of an episode to the commands of a user's controller."""

    parameters: ParameterRecords  # (1,) PARAMETERS
    filter_parameters: FilterRecords  # (1,) FILTER_PARAMETERS
    state: StateRecords  # (1,) STATE
    tracks: TrackRecords  # (tracks,) TRACK
    seen: SeenRecords  # (1,) SEEN
    command: CommandRecords  # (1,) COMMAND


_NOTHING = DesiredView(  # for a controller that does not see the object
    dense=True,
    features=np.full(6, np.nan),
    area=np.nan,
    depth_m=np.nan,
    moments=np.full(31, np.nan),
    plane=np.full(3, np.nan),
    interaction=np.full((6, 6), np.nan),
    interaction_pinv=np.full((6, 6), np.nan),
    condition_number=np.nan,
)


def driven_records(
    settings: Settings, arm: ArmModel, view: DesiredView | None, hand_slots: int
) -> DrivenRecords:
    """Return the records at the start of an episode, when the views are empty and there is no stop.

    Args:
        settings: The settings.
        arm: The arm.
        view: The desired view, which is necessary only if the controller sees the object.
        hand_slots: The scenario's number of hands.

    """
    joints = len(arm.joint_names)
    records = DrivenRecords(
        ParameterRecords(parameters(settings, arm, view or _NOTHING).copy()),
        FilterRecords(filter_parameters(settings.hand_filter, settings.hand_sensor).copy()),
        StateRecords(initial_state(hand_slots, joints)),
        TrackRecords(no_tracks(hand_slots)),
        SeenRecords(np.zeros(1, seen_dtype(hand_slots, joints))),
        CommandRecords(np.zeros(1, command_dtype(joints))),
    )
    records.state["clear_since_s"] = -np.inf
    records.seen["boxes_time_s"] = np.nan
    return records


@njit_no_nrt
def see(
    parameters: ParameterRecords,
    filter_parameters: FilterRecords,
    states: StateRecords,
    tracks: TrackRecords,
    observations: ObservationRecords,
    seen: SeenRecords,
    objects: bool,
    predicts: bool,
) -> None:
    """Fill ``seen`` from the newest observation.

    ``objects`` and ``predicts`` select whether to fill the object and the predicted hands.
    """
    p, s, o = parameters[0], states[0], observations[0]
    forward_kinematics(p.chain, o.joint_position_rad, s.link_transforms)
    copy_matrix(s.link_transforms[p.chain.joint_axes.shape[0] + 1], s.transform_tcp_to_base)
    if objects:
        see_object(parameters, states, observations)
    if predicts:
        see_hands(parameters, filter_parameters, states, tracks, observations)
    show(parameters, filter_parameters, states, tracks, observations, seen, o.boxes_new, objects, predicts)


@njit_no_nrt
def show(
    parameters: ParameterRecords,
    filter_parameters: FilterRecords,
    states: StateRecords,
    tracks: TrackRecords,
    observations: ObservationRecords,
    seen: SeenRecords,
    hands: bool,
    objects: bool,
    predicts: bool,
) -> None:
    """Fill ``seen`` from the control stack's perception.

    ``hands``, ``objects`` and ``predicts`` select which optional parts to fill. The measured hands come from
    the sensor's last frame.
    """
    p, s, o, out = parameters[0], states[0], observations[0], seen[0]
    out.time_s = o.time_s
    copy_vector(o.joint_position_rad, out.joint_position_rad)
    copy_vector(o.joint_velocity_radps, out.joint_velocity_radps)
    copy_matrix(s.transform_tcp_to_base, out.transform_tcp_to_base)
    for i in range(3):
        out.tcp_position_in_base_m[i] = s.transform_tcp_to_base[i, 3]
    if p.eye_in_hand:
        compose_into(s.transform_tcp_to_base, p.transform_camera_to_tcp, out.transform_sensor_to_base)
    else:
        copy_matrix(p.transform_sensor_to_base, out.transform_sensor_to_base)
    out.boxes_new = o.boxes_new
    if hands:
        measured_hands(filter_parameters, observations, seen)
    if objects:
        out.object_new = o.image_new
        out.object_visible = s.object_visible
        copy_vector(s.features, out.features)
        copy_vector(s.feature_error, out.feature_error)
    if predicts:
        for i in range(tracks.shape[0]):
            out.tracked[i] = tracks[i].id if s.track_valid[i] else 0
            if s.track_valid[i]:
                out.last_seen_s[i] = tracks[i].last_seen_s
                copy_vector(s.predicted_hand_in_base_m[i], out.predicted[i])
                spread_of_track(filter_parameters, tracks, i, o.time_s + p.prediction_horizon_s, seen)


@compiled
def measured_hands(
    filter_parameters: FilterRecords, observations: ObservationRecords, seen: SeenRecords
) -> None:
    """Fill ``seen`` with the boxes of a new frame and the hands' centres in the base frame.

    The sensor's present pose gives the positions of the centres.
    """
    f, o, out = filter_parameters[0], observations[0], seen[0]
    out.boxes_time_s = o.boxes_time_s
    out.box_count = out.hand_count = o.box_count
    in_sensor = np.empty(3)
    for k in range(o.box_count):
        for i in range(5):
            out.boxes[k, i] = o.boxes[k, i]
        position_from_box(o.boxes[k], f.focal_px, f.c_u, f.c_v, f.assumed_radius_m, in_sensor)
        for i in range(3):
            out.hands[k, i] = out.transform_sensor_to_base[i, 3]
            for j in range(3):
                out.hands[k, i] += out.transform_sensor_to_base[i, j] * in_sensor[j]


@compiled
def spread_of_track(
    filter_parameters: FilterRecords, tracks: TrackRecords, number: int, at_s: float, seen: SeenRecords
) -> None:
    """Fill a track's velocity and the covariance of its position and velocity, both at the time ``at_s``.

    The velocity (3,) and the covariance (6, 6) are in the base frame. The sensor's pose is (R, t), and the
    hand's position is p = R g(u, v, z) + t. Let A be the Jacobian of g. Then p' = R A (u', v', z') and, to
    first order,

        cov = J diag-pairs J^T,   J = R [[A, 0], [0, A]]

    The filter has pairs of a value and its rate. Here diag-pairs is the block-diagonal matrix of the pairs'
    covariances at ``at_s``. These covariances include the growth by the filter's process noise.
    """
    f, t, out = filter_parameters[0], tracks[number], seen[0]
    dt = at_s - t.time_s
    u, v, z = t.mean[0] + dt * t.mean[5], t.mean[1] + dt * t.mean[6], t.mean[2] + dt * t.mean[7]
    if not z > 0.0:  # use the present position, as ``predict_positions`` does
        u, v, z = t.mean[0], t.mean[1], t.mean[2]
    x, y = (u - f.c_u) / f.focal_px, (v - f.c_v) / f.focal_px
    norm = np.sqrt(x * x + y * y + 1.0)
    depth = z + f.assumed_radius_m / norm
    slope = -f.assumed_radius_m / (norm * norm * norm) / f.focal_px  # times x or y: slope of the depth
    a, ra = np.zeros((3, 3)), np.zeros((3, 3))
    a[0, 0], a[0, 1], a[0, 2] = depth / f.focal_px + x * slope * x, x * slope * y, x
    a[1, 0], a[1, 1], a[1, 2] = y * slope * x, depth / f.focal_px + y * slope * y, y
    a[2, 0], a[2, 1], a[2, 2] = slope * x, slope * y, 1.0
    for i in range(3):
        for j in range(3):
            for k in range(3):
                ra[i, j] += out.transform_sensor_to_base[i, k] * a[k, j]
    for i in range(3):
        out.predicted_velocity[number, i] = 0.0
        for j in range(3):
            out.predicted_velocity[number, i] += ra[i, j] * t.mean[5 + j]
    squared = dt * dt
    for i in range(6):
        for j in range(6):
            out.predicted_covariance[number, i, j] = 0.0
    for m in range(3):
        noise = f.acceleration_variance[m]
        value, mixed, rate = t.pair_covariance[m, 0], t.pair_covariance[m, 1], t.pair_covariance[m, 2]
        value += dt * (2.0 * mixed + dt * rate) + 0.25 * squared * squared * noise
        mixed += dt * rate + 0.5 * squared * dt * noise
        rate += squared * noise
        for i in range(3):
            for j in range(3):
                both = ra[i, m] * ra[j, m]
                out.predicted_covariance[number, i, j] += both * value
                out.predicted_covariance[number, i, 3 + j] += both * mixed
                out.predicted_covariance[number, 3 + i, j] += both * mixed
                out.predicted_covariance[number, 3 + i, 3 + j] += both * rate


@njit_no_nrt
def obey(
    parameters: ParameterRecords,
    states: StateRecords,
    observations: ObservationRecords,
    wanted: NDArray[np.float64],  # (6,) twist of the TCP in base, or (n,) of the joints
    by_joints: bool,
    stop: bool,
    commands: CommandRecords,
) -> bool:
    """Fill the command for an action, within the limits.

    Return False if the action is not finite. An action that is not finite changes no record. A stop lasts
    until the arm is at rest and the restart delay has passed since the last demand for a stop. Until then the
    drives ignore all other commands.
    """
    p, s, o, command = parameters[0], states[0], observations[0], commands[0]
    joints = command.joint_velocity_radps.shape[0]
    for i in range(wanted.shape[0]):
        # Tested before any record changes, so that the caller can refuse the action.
        if not np.isfinite(wanted[i]):
            return False
    still = True
    for i in range(joints):
        still = still and abs(o.joint_velocity_radps[i]) < STANDSTILL_RADPS
    s.limits = 0
    s.gain = 0.0
    if stop:
        s.mode = PROTECTIVE_STOP
        s.clear_since_s = o.time_s
    # 1e-9 s, because times of ticks are rounded products.
    elif s.mode == PROTECTIVE_STOP and still and o.time_s - s.clear_since_s >= p.restart_delay_s - 1e-9:
        s.mode = SERVOING
    geometric_jacobian(p.chain.joint_axes, s.link_transforms, s.jacobian)
    if not by_joints or s.mode == PROTECTIVE_STOP:
        for i in range(6):
            s.wanted_twist_in_base[i] = 0.0 if s.mode == PROTECTIVE_STOP else wanted[i]
        command_arm(
            parameters, states, observations, p.max_tcp_speed_mps, p.max_tcp_acceleration_mps2, commands
        )
        return True
    # One factor for all joints, so that the direction of the motion remains.
    scale = 1.0
    for i in range(joints):
        if abs(wanted[i]) > p.joint_velocity_limit_radps[i]:
            scale = min(scale, p.joint_velocity_limit_radps[i] / abs(wanted[i]))
    if scale < 1.0:
        s.limits |= JOINT_SPEED
    command.protective_stop = False
    for i in range(joints):
        command.joint_velocity_radps[i] = scale * wanted[i]
    clip_joints(parameters, command.joint_velocity_radps)
    for i in range(6):
        # The next twist of the TCP must start from this motion, or its acceleration limit would be wrong.
        s.previous_twist_in_base[i] = 0.0
        for j in range(joints):
            s.previous_twist_in_base[i] += s.jacobian[i, j] * command.joint_velocity_radps[j]
    return True
