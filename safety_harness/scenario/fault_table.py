"""The faults of a scenario as records for compiled code."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import compiled
from safety_harness.scenario.faults import Fault, Joint, JointStuck

TIME_EPS_S = 1e-9  # tolerance for the rounding of a tick's time, at both ends of a fault


FAULT = np.dtype(
    [
        ("kind", np.int64),
        ("from_s", np.float64),
        ("end_s", np.float64),
        ("delay_s", np.float64),  # of a late sensor or answer
        ("vector_m", np.float64, (3,)),  # a false hand's place or an offset in base, a shift in the TCP frame
        ("turned_rad", np.float64, (3,)),  # in the camera frame
        ("joint", np.int64),
    ],
    align=True,
)
_COLUMNS = {
    "delay_s": "delay_s",
    "offset_in_base_m": "vector_m",
    "position_in_base_m": "vector_m",
    "shifted_in_tcp_m": "vector_m",
    "turned_in_camera_rad": "turned_rad",
}


def fault_table(faults: Sequence[Fault]) -> NDArray[np.void]:
    """Return the faults as records of shape (n,) and type FAULT.

    Bit k of the column ``faults`` in a trace stands for record k.
    """
    table = np.zeros(len(faults), FAULT)
    for record, fault in zip(table, faults, strict=True):
        record["kind"] = fault.phrase.kind
        record["from_s"], record["end_s"] = fault.from_s, fault.end_s
        for name, column in _COLUMNS.items():
            record[column] = getattr(fault, name, record[column])
        if isinstance(fault, JointStuck):
            record["joint"] = list(Joint).index(fault.joint)
    return table


@compiled
def acts(faults: NDArray[np.void], k: int, kind: int | np.int64, time_s: float) -> bool:
    """Return whether fault ``k`` has the kind ``kind`` and is active at ``time_s``.

    The end of the fault's interval is excluded. ``faults`` has the shape (n,) and the type FAULT.
    """
    fault = faults[k]
    # A tick's time is rounded, so that a fault at a multiple of the period could miss its tick without
    # TIME_EPS_S.
    return bool(
        fault.kind == kind and fault.from_s - TIME_EPS_S <= time_s and time_s < fault.end_s - TIME_EPS_S
    )


@compiled
def acting(faults: NDArray[np.void], kind: int | np.int64, time_s: float) -> int:
    """Return a bit mask of the faults that have the kind ``kind`` and are active at ``time_s``.

    ``faults`` has the shape (n,) and the type FAULT. Bit k of the result stands for fault k.
    """
    bits = 0
    for k in range(faults.shape[0]):
        if acts(faults, k, kind, time_s):
            bits |= 1 << k
    return bits


@compiled
def delay_s(faults: NDArray[np.void], kind: int | np.int64, time_s: float) -> float:
    """Return the total delay [s] of the faults that have the kind ``kind`` and are active at ``time_s``.

    ``faults`` has the shape (n,) and the type FAULT.
    """
    total = 0.0
    for k in range(faults.shape[0]):
        if acts(faults, k, kind, time_s):
            total += faults[k].delay_s
    return total
