"""A signal: a name for a value that a trace has at every control tick, with its unit.

Between its ticks a signal keeps its value, stays within bounds, or is not known.  The cell of a tick lasts
until the next tick; the cell of the last tick is the tick itself.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from safety_harness.claims.signals.bounds import lipschitz_bounds
from safety_harness.scenario.units import Dimension
from safety_harness.trace.trace import Trace

Values = NDArray[np.float64]


class Interpolation(Enum):
    """The knowledge of a signal from one tick to the next.

    HELD: the signal keeps its value until the next tick.  BOUNDED: it stays within bounds.  TICKS_ONLY: it is
    not known, and a formula judges the ticks alone.
    """

    HELD = "held"
    BOUNDED = "bounded"
    TICKS_ONLY = "not known"


@dataclass(frozen=True, kw_only=True, eq=False)
class Sampled:
    """A signal along a trace of n ticks, in SI; a truth is 1.0 or 0.0; NaN is unknown, inf a value.

    ``value`` (n,) is the value at each tick; ``low`` and ``high`` (n,) bound it from that tick to the next.
    ``surely`` (n,) is a value that the signal does not exceed at some moment between a tick and the next
    (None: not computed).  ``absent`` is the reason why the run has no such signal, else it is empty.
    ``tried`` (n,) are bounds of a number that is above 0 where the run exercises a claim on the signal (None:
    every tick does).  ``untried`` is the event that did not happen.  For a distance, both are about somebody
    who ``comes`` near to something: each approach counts, and the claim's limit says how near is near.

    In a trace that was measured in part, the signal is not known at the ticks ``lost`` (n,).  Then
    ``value_low`` and ``value_high`` (n,) bound it at the ticks (None: both are ``value``).  At a lost tick
    ``value`` is that of the hands that were measured, or NaN; the signal is at most as large.
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
    """A named signal, and the way to sample it from a trace.

    ``words`` is its name in sentences; ``dimension`` is None for a signal that is true or false.  ``sample``
    computes it from a trace, and reads only the columns ``reads``.  ``off`` returns its error (SI) where
    columns are uncertain: at the ticks, and below and above its bounds between them.  Without ``off``, no
    verdict is given on a trace with an uncertain column.  ``finer`` samples it with closer bounds, for more
    work.  ``place`` is the column whose speed the signal is.  Two signals are equal only if they are the same
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
        """Return 0 and 0, for a signal without a limit."""
        return 0.0, 0.0

    def __str__(self) -> str:
        return f'the signal "{self.words}" alone'


def at_ticks(value: Values) -> Sampled:
    """Return a signal ``value`` (n,) that keeps its value until the next tick, or whose ticks alone count."""
    return Sampled(value=value, low=value, high=value)


def absent(trace: Trace, why: str) -> Sampled:
    """Return a signal that this run does not have."""
    nothing = np.full(len(trace.ticks), np.nan)
    return Sampled(value=nothing, low=nothing, high=nothing, absent=why)


def bounded(value: Values, variation: Values) -> Sampled:
    """Return a signal ``value`` (n,) that changes by at most ``variation`` (n-1,) within each cell."""
    low, high = value.copy(), value.copy()
    low[:-1], high[:-1] = lipschitz_bounds(value[:-1], value[1:], variation, 0.0)
    return Sampled(value=value, low=low, high=high)
