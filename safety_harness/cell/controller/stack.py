"""Run the compiled control stack.

``begin_tick`` processes the observation, and ``finish_tick`` computes the command. Between the two functions,
the caller makes a decision if one is necessary. The module ``controller`` makes these decisions one by one,
or in a batch for many episodes. Both worlds use exactly these two functions. The page
docs/reference/controller.md contains the table of states.
"""

from __future__ import annotations

import numpy as np

from safety_harness.base.compiled import inlined, njit_no_nrt
from safety_harness.base.geometry.arrays import Array3, ArrayN
from safety_harness.base.geometry.linear import copy_matrix, copy_vector
from safety_harness.base.geometry.transforms import compose_into
from safety_harness.cell.controller.motion import approach_twist, servo_twist, shaped
from safety_harness.cell.controller.records import (
    AnswerRecords,
    CommandRecords,
    FilterRecords,
    ObservationRecords,
    ParameterRecords,
    StateRecords,
    TrackRecords,
)
from safety_harness.cell.perception.tracking import advance_tracks, predict_positions
from safety_harness.cell.robot.kinematics import forward_kinematics, geometric_jacobian, joint_velocity_with
from safety_harness.cell.servoing.features import feature_error, features
from safety_harness.trace.records import Limit, Mode, Trigger

SERVOING = int(Mode.SERVOING)
REPULSING = int(Mode.REPULSING)
PROTECTIVE_STOP = int(Mode.PROTECTIVE_STOP)
OBJECT_LOST = int(Mode.OBJECT_LOST)
HAND_ENTERED = int(Trigger.HAND_ENTERED)
HAND_STILL_THERE = int(Trigger.HAND_STILL_THERE)
ANOTHER_HAND = int(Trigger.ANOTHER_HAND)
LIMIT_JOINT_SPEED = int(Limit.JOINT_SPEED)
LIMIT_SINGULARITY = int(Limit.SINGULARITY)
# A choice: a single joint at this rate moves a point 1 m away at 1 mm/s.
STANDSTILL_RADPS = 1e-3


@njit_no_nrt
def begin_tick(
    parameters: ParameterRecords,  # (1,) PARAMETERS
    filter_parameters: FilterRecords,  # (1,) FILTER_PARAMETERS
    states: StateRecords,  # (1,) STATE
    tracks: TrackRecords,  # (tracks,) TRACK
    observations: ObservationRecords,  # (1,) OBSERVATION
) -> bool:
    """Read an observation and update the state.

    Return True if ``finish_tick`` needs a decision.
    """
    p, s, o = parameters[0], states[0], observations[0]
    # The kinematic world may already have put its own, equal transforms here.
    if not s.placed:
        forward_kinematics(p.chain, o.joint_position_rad, s.link_transforms)
    s.placed = False
    copy_matrix(s.link_transforms[p.chain.joint_axes.shape[0] + 1], s.transform_tcp_to_base)
    see_object(parameters, states, observations)
    see_hands(parameters, filter_parameters, states, tracks, observations)
    s.limits = 0
    s.decision_pending = decide_mode(parameters, states, tracks, observations)
    if s.decision_pending:
        remember_hands(parameters, states, tracks)
    return bool(s.decision_pending)


@njit_no_nrt
def see_object(parameters: ParameterRecords, states: StateRecords, observations: ObservationRecords) -> None:
    """If there is a new image, compute the features f (eqs. 3 to 5), e = f - f* and |e|^2 (eq. 15)."""
    p, s, o = parameters[0], states[0], observations[0]
    if not o.image_new:
        return
    s.object_visible = o.object_visible
    if not o.object_visible:
        for i in range(6):
            s.features[i] = s.feature_error[i] = np.nan
        s.sse = np.nan
        return
    copy_vector(o.moments, s.moments)
    finite = features(s.moments, p.desired_area, p.desired_depth_m, p.dense, s.features)
    s.sse = feature_error(s.features, p.desired_features, s.feature_error)
    # Moments may be finite while a feature is not; servoing on it would command NaN.
    if not (finite and np.isfinite(s.sse)):
        s.object_visible = False


@njit_no_nrt
def see_hands(
    parameters: ParameterRecords,
    filter_parameters: FilterRecords,
    states: StateRecords,
    tracks: TrackRecords,
    observations: ObservationRecords,
) -> None:
    """Filter the boxes (eqs. 7, 8), predict each hand at now + horizon, and find the hand nearest to the TCP.

    The sensor's pose is fixed or, for the camera on the flange, T_tcp_to_base T_camera_to_tcp. If the
    scenario has a predictor, the predictor has already written the positions. The function then only finds
    the nearest hand.
    """
    p, s, o = parameters[0], states[0], observations[0]
    if o.boxes_new and not p.predicted_elsewhere:
        advance_tracks(tracks, o.boxes, o.box_count, o.boxes_time_s, filter_parameters)
    if p.eye_in_hand:
        compose_into(s.transform_tcp_to_base, p.transform_camera_to_tcp, s.transform_sensor_to_base)
    else:
        copy_matrix(p.transform_sensor_to_base, s.transform_sensor_to_base)
    if not p.predicted_elsewhere:
        predict_positions(
            tracks,
            o.time_s + p.prediction_horizon_s,
            filter_parameters,
            s.transform_sensor_to_base,
            s.predicted_hand_in_base_m,
            s.track_valid,
        )
    s.predicted_distance_m = np.inf
    s.nearest_track = -1
    for i in range(tracks.shape[0]):
        if s.track_valid[i]:
            distance = distance_to_tcp_m(states, s.predicted_hand_in_base_m[i])
            # a NaN must not stay hidden, so it counts as the nearest
            if not (distance >= s.predicted_distance_m or np.isnan(s.predicted_distance_m)):
                s.predicted_distance_m = distance
                s.nearest_track = i
        else:
            for j in range(3):
                s.predicted_hand_in_base_m[i, j] = np.nan


@inlined
def hand_inside(parameters: ParameterRecords, states: StateRecords, track: int) -> bool:
    """Return whether a tracked hand is within the critical distance, |h - t| < d_crit.

    A NaN gives True.
    """
    way_m = distance_to_tcp_m(states, states[0].predicted_hand_in_base_m[track])
    return not way_m >= parameters[0].critical_distance_m


@inlined
def distance_to_tcp_m(states: StateRecords, position_in_base_m: Array3) -> float:
    """Return the distance [m] of ``position_in_base_m`` (3,) from the TCP."""
    s = states[0]
    total = 0.0
    for i in range(3):
        difference = position_in_base_m[i] - s.transform_tcp_to_base[i, 3]
        total += difference * difference
    return float(np.sqrt(total))


@njit_no_nrt
def decide_mode(
    parameters: ParameterRecords, states: StateRecords, tracks: TrackRecords, observations: ObservationRecords
) -> bool:
    """Make the transitions that need no decision.

    If a decision is necessary, set the trigger and return True. The page docs/reference/controller.md lists
    all transitions in a table.
    """
    p, s, o = parameters[0], states[0], observations[0]
    inside = s.nearest_track >= 0 and hand_inside(parameters, states, s.nearest_track)
    if inside:
        # NaN keeps the comparison with the restart delay false while a hand is inside.
        s.clear_since_s = np.nan
    elif np.isnan(s.clear_since_s):
        s.clear_since_s = o.time_s

    if s.mode == PROTECTIVE_STOP:
        still = True
        for i in range(o.joint_velocity_radps.shape[0]):
            still = still and abs(o.joint_velocity_radps[i]) < STANDSTILL_RADPS
        if still and o.time_s - s.clear_since_s >= p.restart_delay_s - 1e-9:
            s.mode = SERVOING
    if s.mode == REPULSING:
        if distance_to_tcp_m(states, s.target_in_base_m) <= p.arrival_tolerance_m:
            if inside:
                s.trigger = HAND_STILL_THERE
                return True
            s.mode = SERVOING
        elif inside and unknown_hand_inside(parameters, states, tracks):
            s.trigger = ANOTHER_HAND
            return True
    # The last test, so that a stop or a retreat that ends in this tick can cause a decision at once.
    if s.mode == SERVOING or s.mode == OBJECT_LOST:
        if inside:
            s.trigger = HAND_ENTERED
            return True
        s.mode = SERVOING if s.object_visible else OBJECT_LOST
    return False


@njit_no_nrt
def unknown_hand_inside(parameters: ParameterRecords, states: StateRecords, tracks: TrackRecords) -> bool:
    """Return whether a hand is within the critical distance now, but was not at the last decision."""
    s = states[0]
    for i in range(tracks.shape[0]):
        if s.track_valid[i] and hand_inside(parameters, states, i):
            known = False
            for j in range(tracks.shape[0]):
                known = known or s.known_track_ids[j] == tracks[i].id
            if not known:
                return True
    return False


@njit_no_nrt
def remember_hands(parameters: ParameterRecords, states: StateRecords, tracks: TrackRecords) -> None:
    """Store which hands are within the critical distance at the time of a decision."""
    s = states[0]
    for i in range(tracks.shape[0]):
        is_inside = s.track_valid[i] and hand_inside(parameters, states, i)
        s.known_track_ids[i] = tracks[i].id if is_inside else -1


@njit_no_nrt
def finish_tick(
    parameters: ParameterRecords,  # (1,) PARAMETERS
    states: StateRecords,  # (1,) STATE
    observations: ObservationRecords,  # (1,) OBSERVATION
    answers: AnswerRecords,  # (1,) ANSWER; read only if a decision is pending
    commands: CommandRecords,  # (1,) COMMAND
) -> None:
    """Act on the answer if a decision is pending, and command the arm for this tick.

    The wanted twist comes from eq. 1 or from the path to the repulsive position, or it is zero.
    """
    p, s, answer = parameters[0], states[0], answers[0]
    if s.decision_pending:
        s.decision_pending = False
        if answer.stop:
            s.mode = PROTECTIVE_STOP
        else:
            s.mode = REPULSING
            copy_vector(answer.position_in_base_m, s.target_in_base_m)

    wanted = s.wanted_twist_in_base
    geometric_jacobian(p.chain.joint_axes, s.link_transforms, s.jacobian)
    for i in range(6):
        wanted[i] = s.camera_twist[i] = 0.0
    s.gain = 0.0
    acceleration = p.max_tcp_acceleration_mps2
    speed = p.max_tcp_speed_mps
    if s.mode == SERVOING:
        servo_twist(parameters, states, wanted)
    elif s.mode == REPULSING:
        acceleration = p.repulsion_acceleration_mps2
        speed = p.repulsion_speed_mps
        approach_twist(parameters, states, wanted)
    command_arm(parameters, states, observations, speed, acceleration, commands)


@inlined
def clip_joints(parameters: ParameterRecords, rates_radps: ArrayN) -> None:
    """Clip joint speeds to their limits.

    Rounding may leave a scaled speed slightly above its limit.
    """
    limit_radps = parameters[0].joint_velocity_limit_radps
    for i in range(rates_radps.shape[0]):
        if abs(rates_radps[i]) > limit_radps[i]:
            rates_radps[i] = np.copysign(limit_radps[i], rates_radps[i])


@inlined
def command_arm(
    parameters: ParameterRecords,
    states: StateRecords,
    observations: ObservationRecords,
    speed_mps: float,
    acceleration_mps2: float,
    commands: CommandRecords,
) -> None:
    """Command the joint velocities q' for the wanted twist.

    The function ``shaped`` limits the twist (v, w). With the present Jacobian J, the joint velocities are

        q' = k J^-1 (v, w),   k = min(1, min_i limit_i/|q'_i|),

    The factor k slows all joints down if one joint reaches its limit, so that the TCP keeps its direction.
    ``clip_joints`` removes any excess that rounding causes. Near a singularity (``joint_velocity``) the
    function commands a protective stop.
    """
    p, s, o, command = parameters[0], states[0], observations[0], commands[0]
    jacobian, wanted, twist = s.jacobian, s.wanted_twist_in_base, s.twist_in_base
    s.limits |= shaped(parameters, s.previous_twist_in_base, wanted, speed_mps, acceleration_mps2, twist)
    if not joint_velocity_with(jacobian, twist, p.min_singular_value, s.room, command.joint_velocity_radps):
        s.limits |= LIMIT_SINGULARITY
        if s.mode != PROTECTIVE_STOP and not np.isnan(s.clear_since_s):
            s.clear_since_s = o.time_s  # the restart delay counts from this stop
        s.mode = PROTECTIVE_STOP
    joints, scale = command.joint_velocity_radps.shape[0], 1.0
    for i in range(joints):
        rate = abs(command.joint_velocity_radps[i])
        if rate > p.joint_velocity_limit_radps[i]:
            scale = min(scale, p.joint_velocity_limit_radps[i] / rate)
    if scale < 1.0:
        s.limits |= LIMIT_JOINT_SPEED
    command.protective_stop = s.mode == PROTECTIVE_STOP
    for i in range(joints):
        command.joint_velocity_radps[i] *= scale
    clip_joints(parameters, command.joint_velocity_radps)
    for i in range(6):
        # during a stop the drives decide: continue from the arm's real motion
        total = scale * twist[i]
        if command.protective_stop:
            total = 0.0
            for j in range(joints):
                total += jacobian[i, j] * o.joint_velocity_radps[j]
        s.previous_twist_in_base[i] = total
