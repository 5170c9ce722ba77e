"""The layout of a trace: one record for each control tick, and one for each decision.

Compiled code fills these records in place, so they are numpy structured types with fixed shapes. The number
of hand slots and of joints is part of a tick's type. Compiled code reads every size from the type of its
record, so that numba's cache keeps different sizes apart. Field names state frames and units; ``_in_base_``
means the robot's base frame.
"""

from __future__ import annotations

from enum import IntEnum, IntFlag
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.settings import HAND_SLOTS

JOINTS = 6  # of the shipped arms
TRACKS_PER_HAND = 2  # and boxes in a frame, which also hold false hands and hands that left
FAULT_CHARACTERS = 240  # of the reason for a failed answer
ENDLESS = 1e100  # from here on, a number is treated as infinite, since its square overflows


class Mode(IntEnum):
    """The present activity of the controller (the state table of docs/reference/controller.md)."""

    SERVOING = 0
    REPULSING = 1
    PROTECTIVE_STOP = 2
    OBJECT_LOST = 3


class Limit(IntFlag):
    """The limits that changed a tick's command."""

    NONE = 0
    TCP_SPEED = 1
    TCP_ACCELERATION = 2
    JOINT_SPEED = 4
    SINGULARITY = 8
    BRAKING = 16
    SHIELD = 32
    SAFETY_FILTER = 64


class Trigger(IntEnum):
    """The reason for a question to the avoider."""

    HAND_ENTERED = 0  # while servoing, lost or released: a predicted hand is within the distance
    HAND_STILL_THERE = 1  # on arrival at the repulsive position
    ANOTHER_HAND = 2  # while moving: a hand that was unknown at the last decision


class DecisionOutcome(IntEnum):
    """The result of a decision: the arm's next action."""

    PROPOSED = 0  # the avoider's own position
    OPPOSITE = 1  # the opposite pose, because the proposed one failed a check
    STOP = 2  # neither can be reached


class Check(IntFlag):
    """The checks that a candidate position may fail."""

    NONE = 0
    NOT_FINITE = 1  # the avoider raised, or returned NaN or a wrong shape
    UNREACHABLE = 2  # no inverse kinematics within the joint limits
    PATH_UNREACHABLE = 4  # the end can be reached, the straight way there cannot
    TABLE = 8  # the TCP's way ends below the table
    UNCERTAIN = 16  # the spread is above the avoider's threshold
    NEAR_REACH_LIMIT = 32  # reachable, but close to the limit of reach
    TOWARDS_A_HAND = 64  # the straight way does not lead away from every predicted hand
    ROBOT_ITSELF = 128  # on the way the wrist comes too near to base, shoulder or upper arm
    LATE = 256  # no answer within the decision deadline, in simulated time
    OBSTACLE = 512  # on the way the arm comes too near to an obstacle of the cell
    OUTSIDE_REGION = 1024  # the question is outside the region that the scenario's gate demands


@lru_cache
def tick_dtype(hands: int, joints: int = JOINTS) -> np.dtype[Any]:
    """Return the type of a tick for ``hands`` hand slots and ``joints`` joints.

    Args:
        hands: The number of hand slots, which must be in HAND_SLOTS. The tick has TRACKS_PER_HAND tracks for
            each hand slot.
        joints: The number of the arm's joints.

    """
    tracks = TRACKS_PER_HAND * hands
    return np.dtype(
        [
            ("time_s", np.float64),
            # truth: the world at this instant
            ("joint_position_rad", np.float64, (joints,)),
            ("joint_velocity_radps", np.float64, (joints,)),
            ("transform_tcp_to_base", np.float64, (4, 4)),
            ("tcp_speed_mps", np.float64),
            ("hand_present", np.bool_, (hands,)),
            ("hand_position_in_base_m", np.float64, (hands, 3)),
            ("elbow_position_in_base_m", np.float64, (hands, 3)),
            ("hand_distance_m", np.float64, (hands,)),  # surface to surface; +inf when absent
            ("hand_distance_capsule", np.int64, (hands,)),  # index of the nearest robot capsule
            # what the controller perceived
            ("object_visible", np.bool_),
            ("features", np.float64, (6,)),  # x_n, y_n, a_n [m], gamma, delta [-], alpha [rad]
            ("feature_error", np.float64, (6,)),  # f - f*, alpha wrapped
            ("sse", np.float64),  # eq. 15 as |f - f*|^2
            ("track_valid", np.bool_, (tracks,)),
            ("predicted_hand_in_base_m", np.float64, (tracks, 3)),
            ("predicted_distance_m", np.float64),  # nearest predicted hand to TCP; +inf without one
            # what it did
            ("mode", np.int64),
            ("gain", np.float64),
            ("camera_twist", np.float64, (6,)),  # v, w of the camera in its own frame, as demanded
            ("demanded_joint_velocity_radps", np.float64, (joints,)),
            ("limits", np.int64),  # Limit flags
            ("faults", np.int64),  # bit k: fault k of the scenario acted at this tick
            ("decision", np.int64),  # index of the decision made at this tick, or -1
        ],
        align=True,
    )


TICK = tick_dtype(HAND_SLOTS[0])  # for scenarios with at most HAND_SLOTS[0] hands


@lru_cache
def _compiled(dtype: np.dtype[Any]) -> np.dtype[Any]:
    fields = [(name, *(field[0].subdtype or (field[0], ()))) for name, field in (dtype.fields or {}).items()]
    return np.dtype(
        [(name, np.uint8 if kind == np.bool_ and shape else kind, shape) for name, kind, shape in fields],
        align=True,
    )


def as_compiled(ticks: NDArray[np.void]) -> NDArray[np.void]:
    """Return the ticks (n,) in the form that compiled code needs, as a view of the same bytes.

    In the view, arrays of booleans within a record are ``uint8``, because compiled code cannot handle them.
    """
    return ticks.view(_compiled(ticks.dtype))


@lru_cache
def columns(dtype: np.dtype[Any]) -> dict[str, slice]:
    """Return the position of each floating-point field in a tick.

    Positions are counted in float64 numbers from the beginning of the tick.
    """
    return {
        name: slice(field[1] // 8, (field[1] + field[0].itemsize) // 8)
        for name, field in (dtype.fields or {}).items()
        if field[0].base == np.float64
    }


def as_numbers(ticks: NDArray[np.void]) -> NDArray[np.float64]:
    """Return the bytes of the ticks (n,) as an array (n, c) of float64.

    Only the ``columns`` are meaningful numbers.
    """
    return np.ascontiguousarray(ticks).view(np.float64).reshape(len(ticks), ticks.dtype.itemsize // 8)


@lru_cache
def decision_dtype(joints: int = JOINTS) -> np.dtype[Any]:
    """Return the type of a decision for an arm with ``joints`` joints."""
    return np.dtype(
        [
            ("tick", np.int64),  # at which its answer counts
            ("time_s", np.float64),
            ("asked_tick", np.int64),  # at which the avoider was asked
            (
                "decision_time_s",
                np.float64,
            ),  # its cost in simulated time, without any fault; 0: not modelled
            ("trigger", np.int64),
            ("seed", np.int64),
            ("hand_position_in_base_m", np.float64, (3,)),  # nearest predicted hand when the answer counts
            ("tcp_position_in_base_m", np.float64, (3,)),
            ("joint_position_rad", np.float64, (joints,)),
            ("proposed_position_in_base_m", np.float64, (3,)),  # the avoider's answer
            ("proposed_spread_m", np.float64, (3,)),
            ("spread_threshold_m", np.float64),  # the avoider's own; NaN for one without
            ("opposite_position_in_base_m", np.float64, (3,)),
            ("chosen_position_in_base_m", np.float64, (3,)),  # NaN when stopped
            ("outcome", np.int64),
            ("proposed_failed", np.int64),  # Check flags
            ("opposite_failed", np.int64),  # Check flags
            ("fault", np.str_, FAULT_CHARACTERS),  # why the avoider gave no usable answer; empty if it did
        ],
        align=True,
    )


DECISION = decision_dtype()


@lru_cache
def filtered_dtype(joints: int = JOINTS) -> np.dtype[Any]:
    """Return the record type FILTERED.

    A record contains the command that the controller wanted, before a safety filter changed it. ``held`` is
    true if the filter passed the command while an earlier stop by the filter still lasted.
    """
    fields = [("wanted_radps", np.float64, (joints,)), ("wanted_stop", np.bool_), ("held", np.bool_)]
    return np.dtype(fields, align=True)


@lru_cache
def predicted_dtype(hands: int) -> np.dtype[Any]:
    """Return the record type PREDICTED.

    For each track of a tick, a record contains a set. According to a predictor, the hand is in this set. A
    set is an ellipsoid (h - p)' S^-1 (h - p) <= 1 around the predicted position p, with S in ``shape_m2``. If
    ``box`` is true, the set is a box along the base's axes, and S has the squares of its half widths.
    """
    tracks = TRACKS_PER_HAND * hands
    fields = [("shape_m2", np.float64, (tracks, 3, 3)), ("box", np.bool_, (tracks,))]
    return np.dtype(fields, align=True)


# What a scenario's shield did in a tick: the share of the wanted speed that it allowed, and the capsule
# nearest to the hand that caused this share; -1 without such a hand, or before the first frame.
INTERVENTION = np.dtype(
    [("scale", np.float64), ("capsule", np.int64)], align=True
)  # all that old traces have


@lru_cache
def intervention_dtype(hands: int, joints: int = JOINTS) -> np.dtype[Any]:
    """Return the record type INTERVENTION with further fields.

    These fields are the hands that the shield used, and the shield's command to the drives.

    Args:
        hands: The number of hand slots. The record has room for TRACKS_PER_HAND boxes for each hand slot.
        joints: The number of the arm's joints.

    """
    boxes = TRACKS_PER_HAND * hands
    return np.dtype(
        [
            ("scale", np.float64),
            ("capsule", np.int64),
            ("taken_s", np.float64),  # the time stamp of the frame used; -inf: no frame yet
            ("count", np.int64),
            ("hand_in_base_m", np.float64, (boxes, 3)),
            ("sent_radps", np.float64, (joints,)),
        ],
        align=True,
    )
