"""The arm's drives: they follow a demanded joint velocity, and a protective stop takes time.

Both worlds put this between the controller's command and their motors.  A protective stop is the
robot's own: for the reaction time the drives go on with the velocity they had, then they brake
uniformly to zero within T_s(v) = base + slope v, v being the TCP speed when braking begins.  Once
begun it is carried through to standstill, whatever the controller asks for meanwhile.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NewType

import numpy as np
from numpy.typing import NDArray

from safety_harness.compiled import compiled
from safety_harness.geometry.arrays import ArrayN
from safety_harness.geometry.linear import copy_vector
from safety_harness.settings import Settings


@lru_cache
def drive_dtype(joints: int) -> np.dtype[Any]:
    """DRIVE of an arm with so many joints."""
    return np.dtype(
        [
            ("control_period_s", np.float64),
            ("reaction_time_s", np.float64),
            ("stop_time_base_s", np.float64),
            ("stop_time_per_speed_s2pm", np.float64),
            ("setpoint_radps", np.float64, (joints,)),  # what the drives were told last
            ("stopping", np.bool_),
            ("requested_at_s", np.float64),
            ("braking", np.bool_),  # the reaction time is over
            ("braking_from_s", np.float64),
            ("stop_time_s", np.float64),
            ("braking_from_radps", np.float64, (joints,)),
        ],
        align=True,
    )


DriveRecords = NewType("DriveRecords", NDArray[np.void])  # (1,) DRIVE


def drive(settings: Settings, joints: int) -> DriveRecords:
    """Drives of so many joints, at rest."""
    drives = np.zeros(1, drive_dtype(joints))
    drives["control_period_s"] = settings.clock.control_period_s
    for name in ("reaction_time_s", "stop_time_base_s", "stop_time_per_speed_s2pm"):
        drives[name] = getattr(settings.braking, name)
    return DriveRecords(drives)


@compiled
def drive_tick(
    drives: DriveRecords, demanded_radps: ArrayN, protective_stop: bool, tcp_speed_mps: float, time_s: float
) -> bool:
    """Set ``setpoint_radps`` for the tick that begins at ``time_s``; True while braking acts.

    While braking q' = q'_b max(0, 1 - (t + dt/2 - t_b)/T_s), with q'_b [rad/s] the set point when braking
    began at t_b = t_requested + T_r, and T_s = base + slope v of the TCP's speed v then.  The set point of a
    braking tick is the ramp's value at the middle of the tick, so that the distance covered is the integral
    of the ramp.
    """
    d = drives[0]
    if protective_stop and not d.stopping:
        d.stopping = True
        d.braking = False
        d.requested_at_s = time_s
    if not d.stopping:
        copy_vector(demanded_radps, d.setpoint_radps)
        return False
    if not d.braking and time_s >= d.requested_at_s + d.reaction_time_s - 1e-9:
        d.braking = True
        d.braking_from_s = time_s
        d.stop_time_s = d.stop_time_base_s + d.stop_time_per_speed_s2pm * tcp_speed_mps
        copy_vector(d.setpoint_radps, d.braking_from_radps)
    if d.braking:
        left = 1.0 - (time_s + 0.5 * d.control_period_s - d.braking_from_s) / d.stop_time_s
        if left <= 0.0 and not protective_stop and not np.any(d.setpoint_radps):
            # At standstill and released: this tick obeys.  The controller takes its demand for done, and
            # one tick later the arm would start with twice the step.
            d.stopping = False
            copy_vector(demanded_radps, d.setpoint_radps)
            return False
        for i in range(d.setpoint_radps.shape[0]):
            d.setpoint_radps[i] = d.braking_from_radps[i] * max(left, 0.0)
    return True
