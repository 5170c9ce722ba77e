"""Model the arm's drives, which follow a demanded joint velocity and need time for a protective stop.

Both worlds put the drives between the controller's command and the motors. The robot performs a protective
stop by itself. During the reaction time the drives keep their velocity. After the reaction time, the drives
brake uniformly to zero within T_s(v) = base + slope v, where v is the TCP speed when braking begins. A stop
that has begun ends only at standstill, whatever the controller commands meanwhile.

Drives with a ``DriveModel`` follow a demand after a dead time and with a lag. If a joint's torque would
exceed its limit, a single factor scales back the change of all set points, also while braking. Drives with a
lag or a torque limit change their velocity during a control period, not at its start. The motors then get the
period's mean velocity.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import ceil
from typing import Any, NewType

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import compiled, inlined, njit_no_nrt
from safety_harness.base.elementary import expm1
from safety_harness.base.geometry.arrays import ArrayN, ArrayNx3, ArrayNx4x4
from safety_harness.base.geometry.linear import copy_vector
from safety_harness.base.settings import Settings
from safety_harness.cell.robot.dynamics import joint_torques, masses_dtype, torque_share

MOST_DELAY_TICKS = 100  # the longest dead time, in control periods of the shortest length


@dataclass(frozen=True, eq=False, kw_only=True)
class DriveModel:
    """The dynamics with which drives follow a demand.

    ``lag_s`` is the time constant of the lag. ``torque_limit_nm`` (n,) limits the torque only if ``masses``
    is given. Otherwise the torque is unlimited.
    """

    dead_time_s: float = 0.0
    lag_s: float = 0.0
    torque_limit_nm: NDArray[np.float64] | None = None
    masses: np.void | None = None  # one of ``masses_dtype``


@lru_cache
def drive_dtype(joints: int) -> np.dtype[Any]:
    """Return the record type DRIVE of an arm with ``joints`` joints."""
    return np.dtype(
        [
            ("control_period_s", np.float64),
            ("reaction_time_s", np.float64),
            ("stop_time_base_s", np.float64),
            ("stop_time_per_speed_s2pm", np.float64),
            ("setpoint_radps", np.float64, (joints,)),  # the last set point of the drives
            ("stopping", np.bool_),
            ("requested_at_s", np.float64),
            ("braking", np.bool_),  # the reaction time is over
            ("braking_from_s", np.float64),
            ("stop_time_s", np.float64),
            ("braking_from_radps", np.float64, (joints,)),
            # of a ``DriveModel``
            ("delay_ticks", np.int64),
            ("oldest", np.int64),
            ("delayed_radps", np.float64, (MOST_DELAY_TICKS, joints)),  # demands within the dead time: a ring
            ("lag_share", np.float64),  # share of the way to a demand in a tick
            ("gradual", np.bool_),  # the set point is reached at the end of the tick, not at its start
            ("limited", np.bool_),
            ("before_radps", np.float64, (joints,)),  # the set point of the previous tick
            ("torque_limit_nm", np.float64, (joints,)),
            ("masses", masses_dtype(joints)),
        ],
        align=True,
    )


def delay_ticks(dead_time_s: float, period_s: float) -> int:
    """Return the number of control periods in ``dead_time_s``, rounded up.

    A control period lasts ``period_s``.
    """
    return ceil(dead_time_s / period_s - 1e-9)  # 1e-9, because 0.07 / 0.01 is above 7 in float64


def settled_s(model: DriveModel | None, period_s: float) -> float:
    """Return the time [s] after which drives follow a constant demand, or 0 without a model.

    After this time, the remaining error of a lag is less than a thousandth of the change. The drives follow
    in this time only if the torques suffice for the change.
    """
    if model is None:
        return 0.0
    gradual = model.lag_s > 0.0 or model.masses is not None
    # exp(-7) is 0.0009: after seven time constants, less than a thousandth of the change remains.
    return delay_ticks(model.dead_time_s, period_s) * period_s + 7.0 * model.lag_s + gradual * period_s


DriveRecords = NewType("DriveRecords", NDArray[np.void])  # (1,) DRIVE


def drive(settings: Settings, joints: int, model: DriveModel | None = None) -> DriveRecords:
    """Return a record DRIVE (1,) at rest.

    Args:
        settings: The settings, with the clock and the braking times.
        joints: The number of joints.
        model: The dynamics of the drives. None means that the drives follow a demand at once.

    """
    drives = np.zeros(1, drive_dtype(joints))
    drives["control_period_s"] = settings.clock.control_period_s
    for name in ("reaction_time_s", "stop_time_base_s", "stop_time_per_speed_s2pm"):
        drives[name] = getattr(settings.braking, name)
    drives["lag_share"] = 1.0
    if model is not None:
        period_s = settings.clock.control_period_s
        drives["delay_ticks"] = delay_ticks(model.dead_time_s, period_s)
        drives["lag_share"] = -expm1(-period_s / model.lag_s) if model.lag_s > 0.0 else 1.0
        drives["gradual"] = model.lag_s > 0.0 or model.masses is not None
        if model.masses is not None:
            drives["limited"] = True
            drives["torque_limit_nm"], drives["masses"] = model.torque_limit_nm, model.masses
    return DriveRecords(drives)


@njit_no_nrt
def drive_tick(
    drives: DriveRecords, demanded_radps: ArrayN, protective_stop: bool, tcp_speed_mps: float, time_s: float
) -> bool:
    """Fill the drives' field ``setpoint_radps`` for the tick that begins at ``time_s``.

    Return True during a protective stop. The set point of a braking tick is q' = q'_b max(0, 1 - (t + dt/2 -
    t_b)/T_s). Here q'_b [rad/s] is the set point when braking began, at t_b = t_requested + T_r with the
    reaction time T_r. The braking time is T_s = base + slope v, in which v is the TCP's speed at t_b. The set
    point is the value of this ramp at the middle of the tick, t + dt/2. So the covered distance is the
    integral of the ramp.
    """
    d = drives[0]
    copy_vector(d.setpoint_radps, d.before_radps)
    if protective_stop and not d.stopping:
        d.stopping = True
        for row in range(d.delay_ticks):  # the stop discards demands within the dead time
            for i in range(d.setpoint_radps.shape[0]):
                d.delayed_radps[row, i] = 0.0
        d.braking = False
        d.requested_at_s = time_s
    if not d.stopping:
        _follow(drives, demanded_radps)
        return False
    # 1e-9 s, because the time of a tick is a rounded product.
    if not d.braking and time_s >= d.requested_at_s + d.reaction_time_s - 1e-9:
        d.braking = True
        d.braking_from_s = time_s
        d.stop_time_s = d.stop_time_base_s + d.stop_time_per_speed_s2pm * tcp_speed_mps
        copy_vector(d.setpoint_radps, d.braking_from_radps)
    if d.braking:
        left = 1.0 - (time_s + 0.5 * d.control_period_s - d.braking_from_s) / d.stop_time_s
        if left <= 0.0 and not protective_stop and _stand_still(drives):
            # At standstill and released: this tick obeys.  The controller assumes that the drives execute
            # its demand.  If they obeyed one tick later, the arm would start with twice the step.
            d.stopping = False
            _follow(drives, demanded_radps)
            return False
        for i in range(d.setpoint_radps.shape[0]):
            d.setpoint_radps[i] = d.braking_from_radps[i] * max(left, 0.0)
    return True


@inlined
def _stand_still(drives: DriveRecords) -> bool:
    """Return whether every set point is zero."""
    stand, setpoint_radps = True, drives[0].setpoint_radps
    for i in range(setpoint_radps.shape[0]):
        stand = stand and setpoint_radps[i] == 0.0
    return stand


@inlined
def _follow(drives: DriveRecords, demanded_radps: ArrayN) -> None:
    """Set ``setpoint_radps`` to u + (1 - exp(-dt/T)) (d - u).

    Here u is the last set point, and d is the demand that is one dead time old. A first-order lag with the
    time constant T reaches this value within the tick dt.
    """
    d = drives[0]
    # The ring holds one demand per tick of dead time: read the oldest, then put the new one in its place.
    row = d.oldest
    for i in range(d.setpoint_radps.shape[0]):
        demand = demanded_radps[i]
        if d.delay_ticks > 0:
            demand = d.delayed_radps[row, i]
            d.delayed_radps[row, i] = demanded_radps[i]
        if d.lag_share < 1.0:
            demand = d.setpoint_radps[i] + d.lag_share * (demand - d.setpoint_radps[i])
        d.setpoint_radps[i] = demand
    if d.delay_ticks > 0:
        d.oldest = (row + 1) % d.delay_ticks


@inlined
def tell_motors(drives: DriveRecords, commanded_radps: ArrayN) -> None:
    """Fill ``commanded_radps`` (n,) with the set points for the motors.

    If the set points change gradually, the function uses their mean over the tick.
    """
    d = drives[0]
    for i in range(commanded_radps.shape[0]):
        setpoint = d.setpoint_radps[i]
        commanded_radps[i] = 0.5 * (d.before_radps[i] + setpoint) if d.gradual else setpoint


@compiled
def limit_torques(drives: DriveRecords, joint_axes: ArrayNx3, transforms: ArrayNx4x4) -> None:
    """Scale back the change of ``setpoint_radps`` in this tick, so that the torque of every joint suffices.

    A single factor for all joints keeps the direction of the change. The torque that keeps the arm in its
    present motion has priority. If this torque alone exceeds a limit, the function makes only a change that
    brings the torque back within the limit. ``transforms`` (n + 2, 4, 4) are the result of
    ``forward_kinematics`` for the arm's position, and ``joint_axes`` has the shape (n, 3).
    """
    d = drives[0]
    n = joint_axes.shape[0]
    change, bias, wanted = np.zeros(n), np.empty(n), np.empty(n)
    # The first call, without acceleration, gives the torque that keeps the present motion; the second adds
    # the change. Torque is linear in acceleration, so one factor between the two suffices.
    joint_torques(joint_axes, transforms, d.masses, d.before_radps, change, bias)
    for i in range(n):
        change[i] = (d.setpoint_radps[i] - d.before_radps[i]) / d.control_period_s
    joint_torques(joint_axes, transforms, d.masses, d.before_radps, change, wanted)
    share = torque_share(bias, wanted, d.torque_limit_nm)
    if share < 1.0:
        for i in range(n):
            d.setpoint_radps[i] = d.before_radps[i] + share * (d.setpoint_radps[i] - d.before_radps[i])
