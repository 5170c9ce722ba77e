"""A signal is a named value with a unit, which a trace has at every control tick.

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
    """The knowledge about a signal from one tick to the next.

    HELD: the signal keeps its value until the next tick. BOUNDED: the signal stays within bounds. TICKS_ONLY:
    the signal is unknown between the ticks, so a formula judges only the ticks.
    """

    HELD = "held"
    BOUNDED = "bounded"
    TICKS_ONLY = "not known"


@dataclass(frozen=True, kw_only=True, eq=False)
class Sampled:
    """The values of a signal over a trace of n ticks, in SI units.

    True and false are 1.0 and 0.0, and NaN means unknown. ``value`` (n,) is the value at each tick, which may
    be inf. ``low`` (n,) and ``high`` (n,) are its bounds from that tick to the next. At some moment between a
    tick and the next, the signal is certainly at most ``surely`` (n,). None means that this was not computed.
    ``absent`` is the reason why the run does not have the signal, or an empty text if the run has it.
    ``tried`` has two bounds (n,) of a number. A tick exercises a claim on the signal if this number is above
    0. None means that every tick exercises such a claim. ``untried`` states the missing event if no tick
    exercises such a claim. If the signal is a distance, ``comes`` has two texts: the first describes the body
    that comes near, and the second describes the target. In this case, each approach exercises the claim
    once, and the claim's limit determines when a body is near.

    In a partly measured trace, ``lost`` (n,) marks the ticks at which the signal is not wholly known. Then
    ``value_low`` (n,) and ``value_high`` (n,) are bounds of the value at the ticks. None means that both are
    ``value``. At a lost tick, ``value`` is NaN or the value for the measured hands only. In the second case,
    the value is an upper bound of the signal.
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
    """A named signal, with the functions that compute it from a trace.

    ``words`` is the signal's name in sentences; ``dimension`` is None for a signal that is true or false.
    ``sample`` computes the signal from a trace, and reads only the columns ``reads``. If columns are
    uncertain, ``off`` returns three errors of the signal (SI): the error at the ticks, the error of the lower
    bound between the ticks, and the error of the upper bound. Without ``off``, a trace with an uncertain
    column gets no conclusive verdict. ``finer`` computes closer bounds of the signal, but takes longer. If
    the signal is a speed, ``place`` is the column of the position that changes with this speed. Two signals
    are equal only if they are the same object.
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
        """The least and the largest limit; both are 0 for a signal that is not compared with a limit."""
        return 0.0, 0.0

    def __str__(self) -> str:
        return f'the signal "{self.words}" alone'


def at_ticks(value: Values) -> Sampled:
    """Return a signal that keeps its ``value`` (n,) until the next tick, or is known only at the ticks."""
    return Sampled(value=value, low=value, high=value)


def absent(trace: Trace, why: str) -> Sampled:
    """Return the samples of a signal that the run does not have.

    ``why`` is the reason.
    """
    nothing = np.full(len(trace.ticks), np.nan)
    return Sampled(value=nothing, low=nothing, high=nothing, absent=why)


def bounded(value: Values, variation: Values) -> Sampled:
    """Return a signal ``value`` (n,) with bounds between the ticks.

    In each cell, the signal changes by at most ``variation`` (n-1,).
    """
    low, high = value.copy(), value.copy()
    low[:-1], high[:-1] = lipschitz_bounds(value[:-1], value[1:], variation, 0.0)
    return Sampled(value=value, low=low, high=high)
