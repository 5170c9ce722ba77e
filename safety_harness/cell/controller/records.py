"""Define the records that the compiled control stack reads and writes.

A record ``PARAMETERS`` never changes during a run. STATE is the memory of the controller in an episode. The
stack receives an OBSERVATION and, after a decision, an ``ANSWER``. The stack returns a ``COMMAND``. For many
episodes, an array of each record type contains one element for each episode.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NewType

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.settings import HAND_SLOTS, HandSensorKind, ObjectKind, Settings
from safety_harness.cell.perception.camera import transform_camera_to_tcp
from safety_harness.cell.perception.moments import MOMENT_COUNT
from safety_harness.cell.robot.description import ArmModel, chain_of
from safety_harness.cell.servoing.control import DesiredView, choice_code
from safety_harness.trace.records import JOINTS, TRACKS_PER_HAND


@lru_cache
def parameters_dtype(joints: int) -> np.dtype[Any]:
    """Return the record type PARAMETERS for an arm with ``joints`` joints."""
    return np.dtype(
        [
            ("control_period_s", np.float64),
            ("chain", chain_of(joints)),
            ("joint_velocity_limit_radps", np.float64, (joints,)),
            ("transform_camera_to_tcp", np.float64, (4, 4)),  # as calibrated, not as mounted
            ("eye_in_hand", np.bool_),
            ("transform_sensor_to_base", np.float64, (4, 4)),  # of a fixed hand sensor
            ("prediction_horizon_s", np.float64),
            ("predicted_elsewhere", np.bool_),  # a predictor of the scenario fills hands and tracks
            ("dense", np.bool_),
            ("choice", np.int64),
            ("desired_area", np.float64),
            ("desired_depth_m", np.float64),
            ("desired_features", np.float64, (6,)),
            ("desired_interaction", np.float64, (6, 6)),
            ("desired_interaction_pinv", np.float64, (6, 6)),
            ("gain_far", np.float64),
            ("gain_near", np.float64),
            ("gain_switch_sse", np.float64),
            ("max_tcp_speed_mps", np.float64),
            ("max_tcp_acceleration_mps2", np.float64),
            ("max_tcp_angular_speed_radps", np.float64),
            ("max_tcp_angular_acceleration_radps2", np.float64),
            ("min_singular_value", np.float64),
            ("critical_distance_m", np.float64),
            ("repulsion_speed_mps", np.float64),
            ("repulsion_acceleration_mps2", np.float64),
            ("arrival_tolerance_m", np.float64),
            ("restart_delay_s", np.float64),
            ("decision_deadline_s", np.float64),
        ],
        align=True,
    )


@lru_cache
def state_dtype(hands: int, joints: int = JOINTS) -> np.dtype[Any]:
    """Return the record type STATE of a controller.

    The record has room for ``joints`` joints, and for TRACKS_PER_HAND tracks for each of ``hands`` hands.
    """
    tracks = TRACKS_PER_HAND * hands
    return np.dtype(
        [
            ("mode", np.int64),
            ("transform_tcp_to_base", np.float64, (4, 4)),  # from the measured joints
            ("link_transforms", np.float64, (joints + 2, 4, 4)),
            ("placed", np.bool_),  # a world has set the transforms for the next observation
            # the image of the object, as last delivered
            ("object_visible", np.bool_),
            ("moments", np.float64, (MOMENT_COUNT,)),
            ("features", np.float64, (6,)),
            ("feature_error", np.float64, (6,)),
            ("sse", np.float64),
            # the hands, as predicted
            ("track_valid", np.uint8, (tracks,)),  # booleans; compiled code cannot nest their arrays
            ("predicted_hand_in_base_m", np.float64, (tracks, 3)),
            ("predicted_distance_m", np.float64),
            ("nearest_track", np.int64),
            ("known_track_ids", np.int64, (tracks,)),  # within the critical distance at the last decision
            # the present motion
            ("trigger", np.int64),
            ("decision_pending", np.bool_),
            ("target_in_base_m", np.float64, (3,)),
            ("clear_since_s", np.float64),  # since this time no hand has been within the critical distance
            ("previous_twist_in_base", np.float64, (6,)),
            ("gain", np.float64),
            ("camera_twist", np.float64, (6,)),
            ("limits", np.int64),
            # scratch arrays of a tick
            ("jacobian", np.float64, (6, joints)),
            ("room", np.float64, (6, 6)),  # for ``joint_velocity_with``
            ("wanted_twist_in_base", np.float64, (6,)),
            ("twist_in_base", np.float64, (6,)),
            ("transform_sensor_to_base", np.float64, (4, 4)),
        ],
        align=True,
    )


@lru_cache
def observation_dtype(hands: int, joints: int = JOINTS) -> np.dtype[Any]:
    """Return the record type OBSERVATION.

    The record has room for ``joints`` joints, and for TRACKS_PER_HAND boxes for each of ``hands`` hands.
    """
    boxes = TRACKS_PER_HAND * hands
    return np.dtype(
        [
            ("time_s", np.float64),
            ("joint_position_rad", np.float64, (joints,)),
            ("joint_velocity_radps", np.float64, (joints,)),
            ("image_new", np.bool_),
            ("object_visible", np.bool_),
            ("moments", np.float64, (MOMENT_COUNT,)),
            ("boxes_new", np.bool_),
            ("boxes_time_s", np.float64),
            ("box_count", np.int64),
            ("boxes", np.float64, (boxes, 5)),
        ],
        align=True,
    )


ANSWER = np.dtype([("stop", np.bool_), ("position_in_base_m", np.float64, (3,))], align=True)


@lru_cache
def command_dtype(joints: int = JOINTS) -> np.dtype[Any]:
    """Return the record type COMMAND for an arm with ``joints`` joints."""
    fields = [("joint_velocity_radps", np.float64, (joints,)), ("protective_stop", np.bool_)]
    return np.dtype(fields, align=True)


COMMAND = command_dtype()

Records = NDArray[np.void]
ParameterRecords = NewType("ParameterRecords", Records)  # (1,) PARAMETERS
FilterRecords = NewType("FilterRecords", Records)  # (1,) FILTER_PARAMETERS
StateRecords = NewType("StateRecords", Records)  # (1,) STATE
TrackRecords = NewType("TrackRecords", Records)  # (tracks,) TRACK
ObservationRecords = NewType("ObservationRecords", Records)  # (1,) OBSERVATION
AnswerRecords = NewType("AnswerRecords", Records)  # (1,) ANSWER
CommandRecords = NewType("CommandRecords", Records)  # (1,) COMMAND
QuestionRecords = NewType("QuestionRecords", Records)  # (1,) QUESTION
FaultRecords = NewType("FaultRecords", Records)  # (n,) FAULT


def overhead_transform_sensor_to_base(settings: Settings) -> NDArray[np.float64]:
    """Return the pose (4, 4) of the fixed hand camera.

    The camera looks straight down. The image's u axis points along -y of the base, and its v axis along -x.
    """
    transform = np.eye(4)
    transform[:3, :3] = [[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]
    transform[:3, 3] = settings.hand_sensor.overhead_position_in_base_m
    return transform


def parameters(settings: Settings, arm: ArmModel, view: DesiredView) -> NDArray[np.void]:
    """Return the record PARAMETERS (1,) for the settings, the arm and the desired view of the object."""
    p = np.zeros(1, parameters_dtype(len(arm.joint_names)))
    p["control_period_s"] = settings.clock.control_period_s
    p["chain"] = arm.chain
    p["joint_velocity_limit_radps"] = arm.velocity_limit_radps
    p["transform_camera_to_tcp"] = transform_camera_to_tcp(settings.camera, calibrated=True)
    p["eye_in_hand"] = settings.hand_sensor.kind is HandSensorKind.EYE_IN_HAND
    p["transform_sensor_to_base"] = overhead_transform_sensor_to_base(settings)
    p["prediction_horizon_s"] = settings.hand_filter.prediction_horizon_s
    p["dense"] = settings.servo.object_kind is ObjectKind.DENSE
    p["choice"] = choice_code(settings.servo.interaction)
    for name in ("area", "depth_m", "features", "interaction", "interaction_pinv"):
        p[f"desired_{name}"] = getattr(view, name)
    for group in (settings.servo, settings.motion, settings.avoidance):
        for name in p.dtype.names or ():
            if hasattr(group, name):
                p[name] = getattr(group, name)
    return p


def initial_state(hand_slots: int = HAND_SLOTS[0], joints: int = JOINTS) -> NDArray[np.void]:
    """Return the record STATE (1,) before the first observation."""
    s = np.zeros(1, state_dtype(hand_slots, joints))
    s["predicted_distance_m"] = np.inf
    s["nearest_track"] = -1
    s["known_track_ids"] = -1
    s["clear_since_s"] = np.nan
    for name in ("moments", "features", "feature_error", "sse", "target_in_base_m"):
        s[name] = np.nan
    return s
