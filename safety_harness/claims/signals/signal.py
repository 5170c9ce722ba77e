"""A signal: a named value with a unit, which a trace has at every control tick.

From one tick to the next, a signal keeps its value, stays within bounds, or is not known. The time from a
tick to the next is the tick's *cell*; the cell of the last tick is the tick itself.
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
    """What is known of a signal from one tick to the next.

    HELD: the signal keeps its value until the next tick. BOUNDED: it stays within bounds. TICKS_ONLY: it is
    not known, so that a formula judges only the ticks.
    """

    HELD = "held"
    BOUNDED = "bounded"
    TICKS_ONLY = "not known"


@dataclass(frozen=True, kw_only=True, eq=False)
class Sampled:
    """A signal's values over a trace of n ticks, in SI; a truth is 1.0 or 0.0, and NaN is unknown.

    ``value`` (n,) is the value at each tick, which may be inf; ``low`` and ``high`` (n,) bound it from that
    tick to the next. Between a tick and the next, the signal certainly falls at some moment to ``surely``
    (n,) or below (None: not computed). ``absent`` is the reason why the run has no such signal, or empty.
    ``tried`` are two bounds (n,) of a number that is above 0 at ticks that exercise a claim on the signal
    (None: every tick does). ``untried`` states what did not happen if no tick does. For a distance, ``comes``
    names who comes near to what. Then each approach counts as one, and the claim's limit determines how near
    is near.

    In a trace that was measured in part, the signal is not wholly known at the ticks ``lost`` (n,). Then
    ``value_low`` and ``value_high`` (n,) bound it at the ticks (None: both are ``value``). At a lost tick,
    ``value`` is that of the measured hands, which the signal cannot exceed, or NaN.
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
    """A named signal, with the functions that sample it from a trace.

    ``words`` is the signal's name in sentences; ``dimension`` is None for a signal that is true or false.
    ``sample`` computes the signal from a trace, and reads only the columns ``reads``. If columns are
    uncertain, ``off`` returns the signal's errors (SI): at the ticks, and below and above its bounds between
    them. Without ``off``, a trace with an uncertain column gets no verdict. ``finer`` samples the signal with
    closer bounds, but takes longer. If the signal is a speed, ``place`` is the column that moves with it. Two
    signals are equal only if they are the same object.
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
        """The least and the largest limit: 0 and 0 for a signal that is compared with none."""
        return 0.0, 0.0

    def __str__(self) -> str:
        return f'the signal "{self.words}" alone'


def at_ticks(value: Values) -> Sampled:
    """Return a signal ``value`` (n,) that is held until the next tick, or of which only the ticks count."""
    return Sampled(value=value, low=value, high=value)


def absent(trace: Trace, why: str) -> Sampled:
    """Return the sampled form of a signal that the run does not have, because of ``why``."""
    nothing = np.full(len(trace.ticks), np.nan)
    return Sampled(value=nothing, low=nothing, high=nothing, absent=why)


def bounded(value: Values, variation: Values) -> Sampled:
    """Return a signal ``value`` (n,) with bounds for changes of at most ``variation`` (n-1,) in the cells."""
    low, high = value.copy(), value.copy()
    low[:-1], high[:-1] = lipschitz_bounds(value[:-1], value[1:], variation, 0.0)
    return Sampled(value=value, low=low, high=high)
