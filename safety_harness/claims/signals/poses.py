"""Compute the TCP's error from the pose at which servoing aims."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.elementary import arctan2, product
from safety_harness.cell.controller.desired import desired_transform_tcp_to_base
from safety_harness.claims.signals.true_motion import true_motion
from safety_harness.trace.trace import Trace, once_a_trace


@once_a_trace
def pose_errors(trace: Trace) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the TCP's distance [m] and angle [rad] from the desired pose at each tick, both (n,)."""
    desired = desired_transform_tcp_to_base(trace.scenario.settings)
    turns = product(desired[:3, :3].T, trace.ticks["transform_tcp_to_base"][:, :3, :3])
    axis = np.stack(
        [turns[:, 2, 1] - turns[:, 1, 2], turns[:, 0, 2] - turns[:, 2, 0], turns[:, 1, 0] - turns[:, 0, 1]]
    )
    cosine = np.trace(turns, axis1=1, axis2=2) - 1.0
    return position_errors_m(trace), arctan2(np.linalg.norm(axis, axis=0), cosine)


@once_a_trace
def position_errors_m(trace: Trace) -> NDArray[np.float64]:
    """Return the distance of the TCP from the desired position at each tick, shape (n,)."""
    desired = desired_transform_tcp_to_base(trace.scenario.settings)
    return np.asarray(np.linalg.norm(true_motion(trace).tcp_m - desired[:3, 3], axis=1))
