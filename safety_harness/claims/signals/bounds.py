"""Compute bounds of a signal between two ticks, and the errors of these bounds, for numbers or arrays.

Compiled code can call these functions, so that a monitor computes the same bounds as a log.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from numba.extending import register_jitable

Function = TypeVar("Function", bound=Callable[..., Any])
jitable: Callable[[Function], Function] = register_jitable  # compiled code can call such a function too


@jitable
def lipschitz_bounds(first: Any, second: Any, variation: Any, slack: Any) -> tuple[Any, Any]:
    """Return bounds of a signal that changes from ``first`` to ``second``.

    The signal's path between the two values has a length of at most ``variation``. At a distance x along this
    path, the signal differs from ``first`` by at most x, and from ``second`` by at most ``variation`` - x.
    ``slack`` is an additional error of the signal, which widens the bounds.
    """
    low = np.minimum(0.5 * (first + second - variation), np.minimum(first, second)) - slack
    return low, np.maximum(0.5 * (first + second + variation), np.maximum(first, second)) + slack


@jitable
def cells(value: Any, variation: Any, slack: Any) -> tuple[Any, Any]:
    """Return bounds (n,) of a signal ``value`` (n,) from each tick to the next, by ``lipschitz_bounds``.

    The last bounds are those at the last tick itself. ``variation`` is (n-1,), and ``slack`` is (n-1,) or a
    number.
    """
    low, high = value.copy(), value.copy()
    low[:-1], high[:-1] = lipschitz_bounds(value[:-1], value[1:], variation, slack)
    return low, high


@jitable
def or_next(value: Any) -> Any:
    """Return the larger of each tick's ``value`` (n, ...) and the next tick's value.

    The result is NaN if either value is NaN.
    """
    larger = value.copy()
    larger[:-1] = np.maximum(value[:-1], value[1:])
    return larger


@jitable
def speed_cell(first: Any, second: Any, mean: Any) -> tuple[Any, Any]:
    """Return bounds of a joint's speed between two ticks.

    They follow from the speeds at both ticks and the mean speed between them.
    """
    return np.minimum(np.minimum(first, second), mean), np.maximum(np.maximum(first, second), mean)


def speed_cells(at_ticks: Any, mean: Any) -> tuple[Any, Any, Any, Any]:
    """Return the fastest joint's speed at the ticks, its two bounds to the next tick, and its mean.

    The first three have the shape (n,), and the mean has the shape (n-1,). ``at_ticks`` is (n, joints), and
    ``mean`` is (n-1, joints).
    """

    def largest(each: Any) -> Any:
        most = each[:, 0].copy()
        for joint in range(1, each.shape[1]):
            most = np.maximum(most, each[:, joint])
        return most

    low, high = at_ticks.copy(), at_ticks.copy()
    low[:-1], high[:-1] = speed_cell(at_ticks[:-1], at_ticks[1:], mean)
    return largest(at_ticks), largest(low), largest(high), largest(mean)


@jitable
def place_between(at: Any, speed: Any, period_s: float) -> Any:
    """Return the error of a position between ticks.

    It is the error at the ticks, plus half of the error of the distance moved. ``at`` is the error of the
    position at a tick, and ``speed`` is the error of the speed.
    """
    return at + 0.5 * np.maximum(speed * period_s, 2.0 * at)


@jitable
def speed_between(speed: Any, place: Any, period_s: float) -> Any:
    """Return the larger of two errors: the error of a speed, and the error of the mean speed over a period.

    The mean speed's error follows from the error ``place`` of the positions.
    """
    return np.maximum(speed, 2.0 * place / period_s)


@jitable
def apart_between(hand: Any, elbow: Any, arm: Any, faster: Any, period_s: float) -> Any:
    """Return the largest error, between ticks, of the distance from a hand to the arm.

    The error includes the deviation of the joints from linear motion.

    Args:
        hand: The error of the hand's position.
        elbow: The error of the elbow's position.
        arm: The largest position error of any point of the arm.
        faster: The largest speed error of any point of the arm.
        period_s: The control period.

    """
    return np.maximum(hand, elbow) + arm + period_s / 2.0 * faster


@jitable
def velocity_off(reach_m: Any, turned_rad: Any, faster_radps: Any, rates_radps: Any) -> Any:
    """Return the error (n,) [m/s] of the TCP's velocity at each tick.

    It is u' sum over j of l_j + u sum over j of |q'_j| sum over i of l_max(i, j), as in ``faster_mps``.

    Args:
        reach_m: The lengths (joints,) of the chains of links that the joints move.
        turned_rad: The error u (n,) of the joints' positions.
        faster_radps: The error u' (n,) of the joints' speeds.
        rates_radps: The speeds q' (n, joints) of the joints.

    """
    farther_m = reach_m * np.arange(1, len(reach_m) + 1) + (reach_m.sum() - np.cumsum(reach_m))
    return faster_radps * reach_m.sum() + turned_rad * (np.abs(rates_radps) * farther_m).sum(axis=1)
