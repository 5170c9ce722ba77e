"""Bounds of a signal between two ticks, and what uncertainty adds to them: of numbers, or of arrays of them.

Compiled code takes them as they are, so that a monitor has the bounds of a log.
"""

from __future__ import annotations

from typing import Any

import numpy as np


def tent(first: Any, second: Any, way: Any, slack: Any) -> tuple[Any, Any]:
    """Return bounds of a signal that goes ``way`` from its value ``first`` at a tick to the ``second``.

    After a part x of the way it has left the one end by at most x and is at most way - x from the
    other; ``slack`` is what it may be off by beside that.
    """
    low = np.minimum(0.5 * (first + second - way), np.minimum(first, second)) - slack
    return low, np.maximum(0.5 * (first + second + way), np.maximum(first, second)) + slack


def place_between(at: Any, speed: Any, period_s: float) -> Any:
    """Return by what a place is off between ticks: beside its own, half of what its way is off by.

    ``at`` is by what it is off at a tick, ``speed`` by what its speed is.
    """
    return at + 0.5 * np.maximum(speed * period_s, 2.0 * at)


def speed_between(speed: Any, place: Any, period_s: float) -> Any:
    """Return by what a speed is off, its mean over a period among it, by what it and its ``place`` are."""
    return np.maximum(speed, 2.0 * place / period_s)


def apart_between(hand: Any, elbow: Any, arm: Any, faster: Any, period_s: float) -> Any:
    """Return by what the distance of a hand from the arm is off, with the bend of joints between ticks.

    ``hand`` and ``elbow`` are by what these are off, ``arm`` by what any point of the arm is, and ``faster``
    by what any is faster.
    """
    return np.maximum(hand, elbow) + arm + period_s / 2.0 * faster


def velocity_off(reach_m: Any, turned_rad: Any, faster_radps: Any, rates_radps: Any) -> Any:
    """Return (n,) by what the TCP's velocity is off at ticks whose joints are by ``turned_rad`` and so on.

    u' sum over j of l_j + u sum over j of |q'_j| sum over i of l_max(i, j), as for ``faster_mps``;
    ``reach_m`` (joints,), ``turned_rad`` and ``faster_radps`` (n,), ``rates_radps`` (n, joints).
    """
    joints = np.arange(len(reach_m))
    farther_m = reach_m[np.maximum.outer(joints, joints)].sum(axis=1)
    return faster_radps * reach_m.sum() + turned_rad * (np.abs(rates_radps) @ farther_m)
