"""The faults of a scenario as records for compiled code: which act at a moment, and how."""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from safety_harness.compiled import compiled
from safety_harness.scenario.faults import (
    AvoiderLate,
    AvoiderNaN,
    AvoiderSilent,
    CameraBlind,
    CameraFrozen,
    CameraHidden,
    CameraKnocked,
    CameraLate,
    FalseHand,
    Fault,
    HandSensorBlind,
    HandSensorFrozen,
    HandSensorLate,
    HandSensorOff,
    Joint,
    JointStuck,
)

TIME_EPS_S = 1e-9


class FaultKind(IntEnum):
    """What a record does."""

    HAND_SENSOR_BLIND = 0
    HAND_SENSOR_FROZEN = 1
    HAND_SENSOR_LATE = 2
    HAND_SENSOR_OFF = 3
    FALSE_HAND = 4
    CAMERA_BLIND = 5
    CAMERA_FROZEN = 6
    CAMERA_LATE = 7
    CAMERA_KNOCKED = 8
    CAMERA_HIDDEN = 9
    JOINT_STUCK = 10
    AVOIDER_LATE = 11
    AVOIDER_SILENT = 12
    AVOIDER_NAN = 13


KINDS: dict[type[Any], FaultKind] = {
    HandSensorBlind: FaultKind.HAND_SENSOR_BLIND,
    HandSensorFrozen: FaultKind.HAND_SENSOR_FROZEN,
    HandSensorLate: FaultKind.HAND_SENSOR_LATE,
    HandSensorOff: FaultKind.HAND_SENSOR_OFF,
    FalseHand: FaultKind.FALSE_HAND,
    CameraBlind: FaultKind.CAMERA_BLIND,
    CameraFrozen: FaultKind.CAMERA_FROZEN,
    CameraLate: FaultKind.CAMERA_LATE,
    CameraKnocked: FaultKind.CAMERA_KNOCKED,
    CameraHidden: FaultKind.CAMERA_HIDDEN,
    JointStuck: FaultKind.JOINT_STUCK,
    AvoiderLate: FaultKind.AVOIDER_LATE,
    AvoiderSilent: FaultKind.AVOIDER_SILENT,
    AvoiderNaN: FaultKind.AVOIDER_NAN,
}
AVOIDER_KINDS = (FaultKind.AVOIDER_LATE, FaultKind.AVOIDER_SILENT, FaultKind.AVOIDER_NAN)

FAULT = np.dtype(
    [
        ("kind", np.int64),
        ("from_s", np.float64),
        ("end_s", np.float64),
        ("delay_s", np.float64),  # of what is late
        ("vector_m", np.float64, (3,)),  # a false hand's place or an offset in base, a shift in the TCP frame
        ("turned_rad", np.float64, (3,)),  # in the camera frame
        ("joint", np.int64),
    ],
    align=True,
)


def fault_table(faults: Sequence[Fault]) -> NDArray[np.void]:
    """(n,) FAULT; record k is fault k, and bit k of a trace's ``faults``."""
    table = np.zeros(len(faults), FAULT)
    for record, fault in zip(table, faults, strict=True):
        record["kind"] = KINDS[type(fault)]
        record["from_s"], record["end_s"] = fault.from_s, fault.end_s
        if isinstance(fault, HandSensorLate | CameraLate | AvoiderLate):
            record["delay_s"] = fault.delay_s
        elif isinstance(fault, HandSensorOff):
            record["vector_m"] = fault.offset_in_base_m
        elif isinstance(fault, FalseHand):
            record["vector_m"] = fault.position_in_base_m
        elif isinstance(fault, CameraKnocked):
            record["vector_m"], record["turned_rad"] = fault.shifted_in_tcp_m, fault.turned_in_camera_rad
        elif isinstance(fault, JointStuck):
            record["joint"] = list(Joint).index(fault.joint)
    return table


@compiled
def acts(faults: NDArray[np.void], k: int, kind: int, time_s: float) -> bool:
    """Is fault ``k`` (n,) FAULT of that kind, and ``time_s`` within its time?  Its end is not."""
    fault = faults[k]
    return bool(
        fault.kind == kind and fault.from_s - TIME_EPS_S <= time_s and time_s < fault.end_s - TIME_EPS_S
    )


@compiled
def acting(faults: NDArray[np.void], kind: int, time_s: float) -> int:
    """Bits of the faults of that kind that act at ``time_s``; 0 for none."""
    bits = 0
    for k in range(faults.shape[0]):
        if acts(faults, k, kind, time_s):
            bits |= 1 << k
    return bits


@compiled
def delay_s(faults: NDArray[np.void], kind: int, time_s: float) -> float:
    """Sum of what the faults of that kind that act at ``time_s`` are late by."""
    total = 0.0
    for k in range(faults.shape[0]):
        if acts(faults, k, kind, time_s):
            total += faults[k].delay_s
    return total
