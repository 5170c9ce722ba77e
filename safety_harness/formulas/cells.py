"""What is known of a signal between its ticks: held, bounded by ways, or nothing but the ticks.

The cell of a tick lasts until the next one; that of the last tick is the tick.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from safety_harness.formulas.signal import Sampled
from safety_harness.trace.trace import Trace

Values = NDArray[np.float64]
MOVING = 1e-3  # m/s or rad/s: slower is rest, as for the catalogue's limits of speed


def at_ticks(value: Values) -> Sampled:
    """A signal that keeps its value until the next tick, or of which no more is asked.  ``value`` (n,)."""
    return Sampled(value=value, low=value, high=value)


def absent(trace: Trace, why: str) -> Sampled:
    """A signal that there is not in this run."""
    nothing = np.full(len(trace.ticks), np.nan)
    return Sampled(value=nothing, low=nothing, high=nothing, absent=why)


def speeds(at_tick: Values, mean: Values, *, of: str) -> Sampled:
    """Speeds (n, ...) with the mean ones (n-1, ...) from tick to tick; the largest of each row.

    Within a cell each is taken to lie between its least and its largest value at both ends and in
    the mean.  Occasions: the ticks from which on it moves.

    ``at_tick`` (n, ...), ``mean`` (n-1, ...).
    """
    low, high = at_tick.copy(), at_tick.copy()
    low[:-1] = np.minimum(np.minimum(at_tick[:-1], at_tick[1:]), mean)
    high[:-1] = np.maximum(np.maximum(at_tick[:-1], at_tick[1:]), mean)
    value, low, high, mean = (_largest(a) for a in (at_tick, low, high, mean))
    moves = value > MOVING
    moves[:-1] |= mean > MOVING
    count = int(np.count_nonzero(moves))
    return Sampled(value=value, low=low, high=high, occasions=count, untried=f"{of} never moves")


def _largest(values: Values) -> Values:
    """(n,) of each row of (n, ...), of which there may be none."""
    largest: Values = values.max(axis=tuple(range(1, values.ndim)))
    return largest


def bounded(value: Values, way: Values) -> Sampled:
    """A signal (n,) that changes by at most ``way`` (n-1,) within each cell."""
    low, high = value.copy(), value.copy()
    low[:-1], high[:-1] = tent(value, way, 0.0)
    return Sampled(value=value, low=low, high=high)


def tent(value: Values, way: Values, slack: Values | float) -> tuple[Values, Values]:
    """(n-1,) bounds of a signal that has ``value`` (n,) at the ticks and between them goes ``way`` (n-1,).

    After a part x of the way it has left the one end by at most x and is at most way - x from the
    other; ``slack`` is what it may be off by beside that.

    ``slack`` (n-1,).
    """
    first, second = value[:-1], value[1:]
    low = np.minimum(0.5 * (first + second - way), np.minimum(first, second)) - slack
    high = np.maximum(0.5 * (first + second + way), np.maximum(first, second)) + slack
    return low, high


def tcp_way_m(trace: Trace) -> Values:
    """(n-1,) how far the TCP goes within each tick: its largest speed, at the ends or in the mean."""
    speed = trace.ticks["tcp_speed_mps"]
    steps = np.linalg.norm(np.diff(trace.ticks["transform_tcp_to_base"][:, :3, 3], axis=0), axis=1)
    way: Values = np.maximum(np.maximum(speed[:-1], speed[1:]) * np.diff(trace.time_s), steps)
    return way


def turned_rad(trace: Trace) -> Values:
    """(n-1,) by what angle the TCP can turn within each tick: those of all joints together."""
    speed = np.abs(trace.ticks["joint_velocity_radps"])
    steps = np.abs(np.diff(trace.ticks["joint_position_rad"], axis=0))
    most = np.maximum(np.maximum(speed[:-1], speed[1:]) * np.diff(trace.time_s)[:, None], steps)
    turned: Values = most.sum(axis=1)
    return turned


def rises(true: NDArray[np.bool_]) -> int:
    """How often something (n,) begins to be true."""
    return int(np.count_nonzero(np.diff(true.astype(int), prepend=0) == 1))
