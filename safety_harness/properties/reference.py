"""How far a repulsion has got against how far it had time to get: a point mass as the reference.

The reference begins with the TCP's true position and velocity, and heads for the chosen position
with nine tenths of the repulsion speed and seven tenths of its acceleration, slowing down in time
to stop there.  A system that is set to give way more slowly than 20 mm/s (or 0.1 m/s^2) is
measured by these: anything slower is no giving way beside a hand.  In ticks in which the drives
brake or a joint is at its speed limit, the reference moves as the TCP does.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from safety_harness.compiled import compiled
from safety_harness.robot.description import load_arm
from safety_harness.trace.records import Limit
from safety_harness.trace.trace import Trace

SPEED_SHARE, ACCELERATION_SHARE = 0.9, 0.7
LEAST_SPEED_MPS, LEAST_ACCELERATION_MPS2 = 0.020, 0.1
SLACK_M = 0.002  # how far the TCP may stay behind the reference; one control period's way more, but
SLACK_SHARE = 0.1  # at most this share of the whole way


@dataclass(frozen=True)
class RepulsionProgress:
    """What one repulsion has done of its way.

    ``margin_m`` is the slack less the longest that the TCP was behind the reference, at
    ``worst_tick``; ``behind_m`` is how far it is at the end; ``due_m`` is how far the reference got.
    """

    margin_m: float
    worst_tick: int
    behind_m: float
    due_m: float


def progress(
    trace: Trace, decision: np.void, last: int, before: RepulsionProgress | None
) -> RepulsionProgress:
    """Of the repulsion from ``decision`` to the tick ``last``.

    ``before`` is the progress of the repulsion that this one cuts short because of another hand:
    what was due and what was behind are carried over, so that deciding again and again does not
    take the place of moving.
    """
    first = int(decision["tick"])
    settings, avoidance = trace.scenario.settings, trace.scenario.settings.avoidance
    window = trace.ticks[first : last + 1]
    arm = load_arm(trace.scenario.robot.arm_name)
    at_limit = np.abs(window["demanded_joint_velocity_radps"]) >= 0.999 * arm.velocity_limit_radps
    slowed = (window["limits"] & Limit.JOINT_SPEED != 0) & at_limit.any(axis=1)
    tcp_in_base = np.ascontiguousarray(window["transform_tcp_to_base"][:, :3, 3])
    earlier = trace.ticks["transform_tcp_to_base"][max(first - 1, 0), :3, 3]
    period_s = settings.clock.control_period_s
    behind_m, due_m = _behind(
        tcp_in_base,
        (tcp_in_base[0] - earlier) / period_s,
        decision["chosen_position_in_base_m"].copy(),
        slowed | (window["limits"] & Limit.BRAKING != 0),
        SPEED_SHARE * max(avoidance.repulsion_speed_mps, LEAST_SPEED_MPS),
        ACCELERATION_SHARE * max(avoidance.repulsion_acceleration_mps2, LEAST_ACCELERATION_MPS2),
        period_s,
    )
    if before is not None:
        behind_m, due_m = behind_m + max(before.behind_m, 0.0), due_m + before.due_m
    worst = int(np.argmax(behind_m))  # the first NaN, if there is one
    way_m = float(np.linalg.norm(decision["chosen_position_in_base_m"] - tcp_in_base[0]))
    slack_m = SLACK_M + min(period_s * avoidance.repulsion_speed_mps, SLACK_SHARE * way_m)
    return RepulsionProgress(slack_m - float(behind_m[worst]), first + worst, float(behind_m[-1]), due_m)


@compiled
def _behind(
    tcp_in_base_m: NDArray[np.float64],  # (n, 3)
    velocity_in_base_mps: NDArray[np.float64],  # (3,) at the first
    target_in_base_m: NDArray[np.float64],  # (3,)
    excused: NDArray[np.bool_],  # (n,)
    speed_mps: float,
    acceleration_mps2: float,
    period_s: float,
) -> tuple[NDArray[np.float64], float]:
    """How much farther from the target the TCP is than the reference, each tick, and the latter's way [m]."""
    n = tcp_in_base_m.shape[0]
    behind = np.zeros(n)
    x, v, change = tcp_in_base_m[0].copy(), velocity_in_base_mps.copy(), np.empty(3)
    way = _apart(x, target_in_base_m)
    left = way
    for k in range(n):
        left = _apart(x, target_in_base_m)
        behind[k] = _apart(tcp_in_base_m[k], target_in_base_m) - left
        if k == n - 1:
            break
        if excused[k]:
            for i in range(3):
                step = tcp_in_base_m[k + 1, i] - tcp_in_base_m[k, i]
                x[i] += step
                v[i] = step / period_s
            continue
        speed = min(speed_mps, sqrt(2.0 * acceleration_mps2 * left), left / period_s)
        total = 0.0
        for i in range(3):
            wanted = speed * (target_in_base_m[i] - x[i]) / left if left > 0.0 else 0.0
            change[i] = wanted - v[i]
            total += change[i] * change[i]
        most = acceleration_mps2 * period_s
        share = most / sqrt(total) if total > most * most else 1.0
        for i in range(3):
            v[i] += share * change[i]
            x[i] += v[i] * period_s
    return behind, way - left


@compiled
def _apart(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    return sqrt((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2)
