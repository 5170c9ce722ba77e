"""A signal: a name for something that a trace knows at every control tick, with its unit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from safety_harness.formulas.formula import Comparison, Formula, Relation, Truth
from safety_harness.formulas.quantities import Quantity, formula_error, plain
from safety_harness.properties.base import ENDLESS
from safety_harness.scenario.units import NUMBER, Dimension
from safety_harness.trace.trace import Trace


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
    ``absent`` says why there is no such signal in this run at all, else it is empty.  ``occasions``
    counts how often the run has put a claim on it to the test (None: every tick does), and ``untried``
    says what it is that did not happen if that is 0.
    """

    value: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    absent: str = ""
    occasions: int | None = None
    untried: str = ""


@dataclass(frozen=True, kw_only=True, eq=False)
class Signal:
    """``words`` name it in sentences; ``dimension`` is None for one that is true or false.

    ``sample`` takes it from a trace.  Two signals are the same only if they are one object.
    """

    words: str
    dimension: Dimension | None
    meaning: str
    between: Interpolation
    sample: Callable[[Trace], Sampled]

    def __str__(self) -> str:
        return f'the signal "{self.words}" alone'


@dataclass(frozen=True, kw_only=True, eq=False)
class Flag(Signal):
    """Something that is true or false at each tick.  ``stopped()`` is the formula that it is true."""

    dimension: None = None
    between: Interpolation = Interpolation.HELD

    def __call__(self) -> Formula:
        """That it is true."""
        return Truth(self)


@dataclass(frozen=True, kw_only=True, eq=False)
class Measure(Signal):
    """Something with a value of ``dimension`` at each tick, to be compared with a limit of that kind.

    No run has a value below ``least``, nor one without end unless it is ``endless``.
    """

    dimension: Dimension
    least: float = 0.0
    endless: bool = False

    def impossible(self, sampled: Sampled) -> tuple[int, float] | None:
        """The first tick with a value, or a bound of one, that no run has, and what it is; NaN is unknown."""
        least = self.least
        for side in (sampled.value, sampled.low, sampled.high):
            endless = (np.abs(side) >= ENDLESS) & ~(self.endless & np.isposinf(side))
            wrong = (side < least) | endless
            if wrong.any():
                tick = int(np.argmax(wrong))
                return tick, float(side[tick])
            least = -np.inf  # a bound may be below what it bounds
        return None

    def __call__(self) -> Measure:
        """Itself: ``tcp_speed() < mm_per_s(250)`` and ``tcp_speed < mm_per_s(250)`` are the same."""
        return self

    def __lt__(self, limit: Quantity | float) -> Comparison:
        return self._compare(Relation.BELOW, limit)

    def __le__(self, limit: Quantity | float) -> Comparison:
        return self._compare(Relation.AT_MOST, limit)

    def __gt__(self, limit: Quantity | float) -> Comparison:
        return self._compare(Relation.ABOVE, limit)

    def __ge__(self, limit: Quantity | float) -> Comparison:
        return self._compare(Relation.AT_LEAST, limit)

    def __eq__(self, other: object) -> bool:
        if isinstance(other, Quantity | int | float):
            raise formula_error(f"{self.words} beside a limit with <, <=, > or >=", f"== {other}")
        return self is other

    def __hash__(self) -> int:
        return id(self)

    def _compare(self, relation: Relation, limit: Quantity | float) -> Comparison:
        if isinstance(limit, int | float) and self.dimension is NUMBER:
            limit = plain(limit)
        if not isinstance(limit, Quantity):
            units = f"; allowed units: {', '.join(self.dimension.units)}" if self.dimension.units else ""
            expected = f"{self.words} beside {self.dimension.expected}{units}"
            raise formula_error(expected, str(limit), "quantities are written mm(50), deg_per_s(30), s(0.2)")
        return Comparison(self, relation, limit)
