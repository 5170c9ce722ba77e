"""Judge separately the onset, the direction, the speed and the end of a repulsion.

Each judgement has the finest resolution at which the twelve harmless changes of
``tests/claims/properties/harmless.py`` raise no alarm, in both worlds. If the scenario states a dead time and
a lag of its drives, the motion may begin later by this time, counted in whole cycles. The cone of the
direction is then wider by the angle through which the arm turns in that time.
"""

from __future__ import annotations

from math import ceil, inf, radians

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.elementary import arctan2, length, product, sin
from safety_harness.claims.properties.giving_way import (
    LEAST_ACCELERATION_MPS2,
    LEAST_SPEED_MPS,
    LEAST_WAY_M,
    Finding,
    Shares,
    arrival_claimed,
    excused_in,
    last_tick,
    velocity_at,
)
from safety_harness.claims.properties.positions import gone_towards
from safety_harness.scenario.robots import OwnRobot
from safety_harness.trace.records import Limit
from safety_harness.trace.trace import Trace

OFF_RAD = radians(1.0)  # half the angle of the cone; a late drive widens it, up to MOST_OFF_RAD
LEVER_M = 0.5  # radius about which an arm turns: the least that raises no alarm
MOST_OFF_RAD = radians(5.0)
SHORT_M = 0.001  # beyond the arrival tolerance
PACE = Shares(speed=0.95, acceleration=0.9)
BEGUN_SHARE = 0.25  # of the velocity change allowed in a tick; drives that lag begin with less
ASIDE_MPS = 0.001  # a TCP with a slower motion across the way need not turn
Vector = NDArray[np.float64]  # (3,)


def way_gone(
    trace: Trace, number: int, target_in_base_m: Vector, cycles: int, where: str
) -> tuple[dict[str, list[Finding]], bool]:
    """Judge the repulsion of decision ``number`` against the straight way to a target.

    ``where`` describes the target in the findings. The target is ``target_in_base_m`` (3,). The results are
    the findings, each under the name of its part, and whether the repulsion had time for a way of 10 mm.
    """
    period_s = trace.scenario.settings.clock.control_period_s
    allowed = cycles + sum(ceil(one_s / period_s - 1e-9) for one_s in _delays_s(trace))
    done = gone_towards(trace, number, target_in_base_m, allowed, PACE)
    if done is None:
        return {}, False
    first, last = int(trace.decisions[number]["tick"]), last_tick(trace, number)
    behind = Finding(done.margin_m, float(trace.time_s[done.worst_tick]), f"its pace on the way to {where}")
    findings = {
        "onset": _onset(trace, first, last, target_in_base_m, allowed),
        "direction": _direction(trace, first + allowed, last, target_in_base_m, where),
        "speed": [behind],
        "end": _end(trace, number, last, target_in_base_m, where),
    }
    return findings, bool(done.due_m >= LEAST_WAY_M)


def _delays_s(trace: Trace) -> tuple[float, ...]:
    """Return the dead time [s] and the lag [s] that the scenario states for the drives."""
    robot = trace.scenario.robot
    drives = robot.drives if isinstance(robot, OwnRobot) else None
    return () if drives is None else (drives.dead_time_s, drives.lag_s)


def _change(trace: Trace, tick: int, target_in_base_m: Vector) -> tuple[Vector, float, float]:
    """Return the needed velocity change (3,), the change allowed in one tick, and the lateral speed."""
    avoidance, period_s = trace.scenario.settings.avoidance, trace.scenario.settings.clock.control_period_s
    displacement = target_in_base_m - trace.ticks["transform_tcp_to_base"][tick, :3, 3]
    along, velocity = displacement / max(length(displacement), 1e-9), velocity_at(trace, tick)
    change = max(avoidance.repulsion_speed_mps, LEAST_SPEED_MPS) * along - velocity
    step_mps = max(avoidance.repulsion_acceleration_mps2, LEAST_ACCELERATION_MPS2) * period_s
    return change, step_mps, length(velocity - product(velocity, along) * along)


def _onset(trace: Trace, first: int, last: int, target_in_base_m: Vector, allowed: int) -> list[Finding]:
    """Return a finding on how many ticks pass before the TCP's velocity changes as needed.

    The ticks are converted to a distance.
    """
    change, step_mps, _ = _change(trace, first, target_in_base_m)
    most_mps = length(change)
    if most_mps < 0.1 * step_mps or last - first <= allowed:
        return []
    settings = trace.scenario.settings
    steps = np.diff(trace.ticks["transform_tcp_to_base"][first : last + 1, :3, 3], axis=0)
    velocities = np.vstack([velocity_at(trace, first), steps / settings.clock.control_period_s])
    gained_mps = product(np.diff(velocities, axis=0), change) / most_mps
    begun = np.flatnonzero(gained_mps >= BEGUN_SHARE * min(step_mps, most_mps))
    late = int(begun[0]) if len(begun) else last - first
    if excused_in(trace, first, first + late).any():
        return []
    each_m = settings.clock.control_period_s * max(settings.avoidance.repulsion_speed_mps, LEAST_SPEED_MPS)
    text = f"began {late} cycles after the decision, {allowed} allowed"
    return [Finding((allowed - late) * each_m, float(trace.time_s[first + late]), text)]


def _direction(trace: Trace, start: int, last: int, target_in_base_m: Vector, where: str) -> list[Finding]:
    """Return a finding on how far [m] the TCP leaves the cone to the target.

    The cone applies once the TCP has both moved by 10 mm and turned to the target.
    """
    tcp_in_base = trace.ticks["transform_tcp_to_base"][start : last + 1, :3, 3]
    change, step_mps, aside_mps = _change(trace, start, target_in_base_m)
    turning = ceil(min(len(tcp_in_base), length(change) / (PACE.acceleration * step_mps)))
    gone = np.flatnonzero(np.linalg.norm(tcp_in_base - tcp_in_base[0], axis=1) >= LEAST_WAY_M)
    braked = np.flatnonzero(trace.ticks["limits"][start : last + 1] & Limit.BRAKING)
    apex = max([*gone[:1], turning if aside_mps > ASIDE_MPS else 0, *braked[-1:] + 1])
    if len(gone) == 0 or apex >= len(tcp_in_base):
        return []
    chord, bearing = tcp_in_base[apex:] - tcp_in_base[apex], target_in_base_m - tcp_in_base[apex]
    length_m = np.linalg.norm(chord, axis=1)
    along_m = product(chord, bearing) / max(length(bearing), 1e-9)
    aside_m = np.sqrt(np.maximum(length_m * length_m - along_m * along_m, 0.0))
    # The arm has turned by the time that a late demand moves it.
    late_m = max(trace.scenario.settings.avoidance.repulsion_speed_mps, LEAST_SPEED_MPS) * sum(
        _delays_s(trace)
    )
    off_rad = min(OFF_RAD + late_m / LEVER_M, MOST_OFF_RAD)
    # A point behind the apex is off by its whole distance from the apex.
    left_m = np.where(
        length_m >= LEAST_WAY_M, sin(off_rad) * length_m - aside_m + np.minimum(along_m, 0.0), inf
    )
    worst = int(np.argmin(left_m))
    if left_m[worst] == inf:
        return []
    off_deg = float(np.degrees(arctan2(aside_m[worst], along_m[worst])))
    text = f"{off_deg:.1f} deg off its way to {where}"
    return [Finding(float(left_m[worst]), float(trace.time_s[start + apex + worst]), text)]


def _end(trace: Trace, number: int, last: int, target_in_base_m: Vector, where: str) -> list[Finding]:
    """Return a finding on the TCP's distance from ``where`` when the controller ends the repulsion."""
    if not arrival_claimed(trace, number, last):
        return []
    tcp_in_base = trace.ticks["transform_tcp_to_base"][last, :3, 3]
    off_m = length(tcp_in_base - target_in_base_m)
    allowed_m = trace.scenario.settings.avoidance.arrival_tolerance_m + SHORT_M
    return [Finding(allowed_m - off_m, float(trace.time_s[last]), f"ended {off_m * 1e3:.1f} mm from {where}")]
