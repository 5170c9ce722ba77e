"""What many properties ask of the same trace: where arm and hands truly were, as compiled code wants it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from safety_harness.trace.trace import Trace, history, once_a_trace


@dataclass(frozen=True, eq=False)
class TrueMotion:
    """Of each of n ticks; positions in the base frame [m].  Nobody writes to these arrays.

    ``joints_rad`` and ``rates_radps`` (n, 6), ``tcp_m`` (n, 3), ``hands_m`` (n, hands, 2, 3): hand and
    elbow, ``present`` (n, hands), ``nearest_m`` (n,): the least hand distance, surface to surface.
    """

    joints_rad: NDArray[np.float64]
    rates_radps: NDArray[np.float64]
    tcp_m: NDArray[np.float64]
    hands_m: NDArray[np.float64]
    present: NDArray[np.bool_]
    nearest_m: NDArray[np.float64]


@once_a_trace
def true_motion(trace: Trace) -> TrueMotion:
    """The true motion of arm and hands in a trace."""
    ticks = trace.ticks
    hands_m = np.empty((*ticks["hand_present"].shape, 2, 3))
    hands_m[:, :, 0], hands_m[:, :, 1] = ticks["hand_position_in_base_m"], ticks["elbow_position_in_base_m"]
    return TrueMotion(
        joints_rad=ticks["joint_position_rad"].copy(),
        rates_radps=ticks["joint_velocity_radps"].copy(),
        tcp_m=ticks["transform_tcp_to_base"][:, :3, 3].copy(),
        hands_m=hands_m,
        present=ticks["hand_present"].copy(),
        nearest_m=history(trace, "hand_distance_m").min(axis=1),
    )


@once_a_trace
def nearest_hand_m(trace: Trace) -> NDArray[np.float64]:
    """(n,) distance of the nearest true hand's centre from the TCP; infinite without one."""
    tcp_in_base = history(trace, "transform_tcp_to_base")[:, None, :3, 3]
    present = history(trace, "hand_present")[..., None]
    hands = np.where(present, history(trace, "hand_position_in_base_m"), np.inf)
    nearest: NDArray[np.float64] = np.linalg.norm(hands - tcp_in_base, axis=2).min(axis=1)
    return nearest
