"""A signal: a name for something that a trace knows at every control tick, with its unit.

Between its ticks it is held, bounded by ways, or nothing is known of it.  The cell of a tick lasts until
the next one; that of the last tick is the tick.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from safety_harness.claims.signals.bounds import tent
from safety_harness.scenario.units import Dimension
from safety_harness.trace.trace import Trace

Values = NDArray[np.float64]


class Interpolation(Enum):
    """What is known of a signal from one tick to the next.

    HELD: it keeps its value until the next tick.  BOUNDED: it stays within bounds.  TICKS_ONLY: nothing,
    and a formula speaks of the ticks alone.
    """

    HELD = "held"
    BOUNDED = "bounded"
    TICKS_ONLY = "not known"


@dataclass(frozen=True, kw_only=True, eq=False)
class Sampled:
    """A signal along a trace of n ticks, in SI; a truth is 1.0 or 0.0; NaN is unknown, inf a value.

    ``value`` (n,) at each tick; ``low`` and ``high`` (n,) bound it from that tick to the next one.
    ``surely`` (n,): between that tick and the next it is at most that at least once (None: nobody asked).
    ``absent`` says why there is no such signal in this run at all, else it is empty.  ``tried`` (n,) are
    bounds of a number, above 0 where the run puts a claim on it to the test (None: every tick does), and
    ``untried`` says what it is that did not happen.  Of a distance both are of somebody who ``comes`` near to
    something: it counts as often as that begins, and its limit says how near is near.

    Of a trace that was measured in part, ``lost`` (n,) are the ticks at which it is not known, and
    ``value_low`` and ``value_high`` (n,) bound it at the ticks (None: it is ``value``).  ``value`` at a lost
    tick is of the hands that were measured, NaN without one; it is at most that.
    """

    value: Values
    low: Values
    high: Values
    absent: str = ""
    tried: tuple[Values, Values] | None = None
    comes: tuple[str, str] | None = None
    untried: str = ""
    value_low: Values | None = None
    value_high: Values | None = None
    lost: NDArray[np.bool_] | None = None
    surely: Values | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Signal:
    """``words`` name it in sentences; ``dimension`` is None for one that is true or false.

    ``sample`` takes it from a trace, of which it ``reads`` these columns and no others.  ``off`` says by how
    much it may be off as they are uncertain (SI), at the ticks, and below and above its bounds between them;
    without it nothing is said of a trace in which any is.  ``finer`` takes it with closer bounds, for more
    work.  ``place`` is the column of which it is the speed.  Two signals are the same only if they are one
    object.
    """

    words: str
    dimension: Dimension | None
    meaning: str
    between: Interpolation
    sample: Callable[[Trace], Sampled]
    reads: tuple[str, ...]
    off: Callable[[Trace], tuple[float, float, float]] | None = None
    finer: Callable[[Trace], Sampled] | None = None
    place: str = ""

    @property
    def limits(self) -> tuple[float, float]:
        """Of what has no limit: none."""
        return 0.0, 0.0

    def __str__(self) -> str:
        return f'the signal "{self.words}" alone'


def at_ticks(value: Values) -> Sampled:
    """A signal that keeps its value until the next tick, or of which no more is asked.  ``value`` (n,)."""
    return Sampled(value=value, low=value, high=value)


def absent(trace: Trace, why: str) -> Sampled:
    """A signal that there is not in this run."""
    nothing = np.full(len(trace.ticks), np.nan)
    return Sampled(value=nothing, low=nothing, high=nothing, absent=why)


def bounded(value: Values, way: Values) -> Sampled:
    """A signal ``value`` (n,) that changes by at most ``way`` (n-1,) within each cell."""
    low, high = value.copy(), value.copy()
    low[:-1], high[:-1] = tent(value[:-1], value[1:], way, 0.0)
    return Sampled(value=value, low=low, high=high)
