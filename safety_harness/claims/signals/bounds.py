"""Bounds of a signal between two ticks, and what uncertainty adds to them, for numbers or for arrays.

Compiled code can call these functions, so that a monitor has the bounds of a log.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba.extending import register_jitable

jitable: Any = register_jitable  # compiled code can call such a function too


@jitable
def tent(first: Any, second: Any, way: Any, slack: Any) -> tuple[Any, Any]:
    """Return bounds of a signal that goes ``way`` from its value ``first`` at a tick to the ``second``.

    After a part x of the way it has left the one end by at most x and is at most way - x from the
    other; ``slack`` is what it may be off by beside that.
    """
    low = np.minimum(0.5 * (first + second - way), np.minimum(first, second)) - slack
    return low, np.maximum(0.5 * (first + second + way), np.maximum(first, second)) + slack


@jitable
def cells(value: Any, way: Any, slack: Any) -> tuple[Any, Any]:
    """Return bounds (n,) of a signal ``value`` (n,) from each tick to the next, by ``tent``.

    The last ones are those of the last tick.  ``way`` (n-1,), and ``slack`` (n-1,) or a number.
    """
    low, high = value.copy(), value.copy()
    low[:-1], high[:-1] = tent(value[:-1], value[1:], way, slack)
    return low, high


@jitable
def or_next(value: Any) -> Any:
    """Return the larger of each tick's value and the next one's, for (n, ...) ticks; NaN where one is."""
    larger = value.copy()
    larger[:-1] = np.maximum(value[:-1], value[1:])
    return larger


@jitable
def speed_cells(at_ticks: Any, mean: Any) -> tuple[Any, Any, Any, Any]:
    """Return the fastest joint's speeds (n,) at the ticks, its bounds to the next tick, and its mean (n-1,).

    From tick to tick a joint's speed lies between the least and the largest of both ends and the mean.
    ``at_ticks`` (n, joints) and ``mean`` (n-1, joints).
    """

    def largest(each: Any) -> Any:
        found = each[:, 0].copy()
        for joint in range(1, each.shape[1]):
            found = np.maximum(found, each[:, joint])
        return found

    low, high = at_ticks.copy(), at_ticks.copy()
    low[:-1] = np.minimum(np.minimum(at_ticks[:-1], at_ticks[1:]), mean)
    high[:-1] = np.maximum(np.maximum(at_ticks[:-1], at_ticks[1:]), mean)
    return largest(at_ticks), largest(low), largest(high), largest(mean)


@jitable
def place_between(at: Any, speed: Any, period_s: float) -> Any:
    """Return by what a place is off between ticks: beside its own, half of what its way is off by.

    ``at`` is by what it is off at a tick, ``speed`` by what its speed is.
    """
    return at + 0.5 * np.maximum(speed * period_s, 2.0 * at)


@jitable
def speed_between(speed: Any, place: Any, period_s: float) -> Any:
    """Return by what a speed is off, its mean over a period among it, by what it and its ``place`` are."""
    return np.maximum(speed, 2.0 * place / period_s)


@jitable
def apart_between(hand: Any, elbow: Any, arm: Any, faster: Any, period_s: float) -> Any:
    """Return by what the distance of a hand from the arm is off, with the bend of joints between ticks.

    ``hand`` and ``elbow`` are by what these are off, ``arm`` by what any point of the arm is, and ``faster``
    by what any is faster.
    """
    return np.maximum(hand, elbow) + arm + period_s / 2.0 * faster


@jitable
def velocity_off(reach_m: Any, turned_rad: Any, faster_radps: Any, rates_radps: Any) -> Any:
    """Return (n,) by what the TCP's velocity is off at ticks whose joints are by ``turned_rad`` and so on.

    u' sum over j of l_j + u sum over j of |q'_j| sum over i of l_max(i, j), as for ``faster_mps``;
    ``reach_m`` (joints,), ``turned_rad`` and ``faster_radps`` (n,), ``rates_radps`` (n, joints).
    """
    farther_m = reach_m * np.arange(1, len(reach_m) + 1) + (reach_m.sum() - np.cumsum(reach_m))
    return faster_radps * reach_m.sum() + turned_rad * (np.abs(rates_radps) * farther_m).sum(axis=1)
