"""The two kinds of signal.

A measure is a number, which formulas compare with a limit. A flag is true or false.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from safety_harness.claims.formulas.formula import Comparison, Formula, Relation, Truth
from safety_harness.claims.formulas.quantities import Quantity, formula_error, plain
from safety_harness.claims.signals.signal import Interpolation, Sampled, Signal
from safety_harness.scenario.units import NUMBER, Dimension
from safety_harness.trace.records import ENDLESS


@dataclass(frozen=True, kw_only=True, eq=False)
class Flag(Signal):
    """A signal that is true or false at each tick.

    A call of the signal, such as ``stopped()``, returns a formula.
    """

    dimension: None = None
    between: Interpolation = Interpolation.HELD

    def __call__(self) -> Formula:
        """Return a formula that holds while the flag is true."""
        return Truth(self)


@dataclass(frozen=True, kw_only=True, eq=False)
class Measure(Signal):
    """A signal with a value of ``dimension`` at each tick, for comparison with a limit of that dimension.

    In a run, no value is below ``least``, and a value is infinite only if the measure is ``endless``. A limit
    below ``lowest``, or above the largest limit of its dimension, is refused because no run comes near it.
    """

    dimension: Dimension
    least: float = 0.0
    endless: bool = False
    lowest: float = 0.0

    @property
    def limits(self) -> tuple[float, float]:
        """Return the least and the largest limit (SI)."""
        return self.lowest, self.dimension.most_of_limits

    def impossible(self, sampled: Sampled) -> tuple[int, float] | None:
        """Return the first tick with a value or bound that is impossible in a run, and this value or bound.

        Return None if all values and bounds are possible. NaN means unknown, so it is possible. An infinite
        bound is possible between two ticks if motors may saturate there.
        """
        least, unbounded = self.least, np.isneginf(sampled.low)
        for side, unknown in ((sampled.value, np.nan), (sampled.low, -np.inf), (sampled.high, np.inf)):
            endless = (np.abs(side) >= ENDLESS) & ~(self.endless & np.isposinf(side))
            endless &= ~(unbounded & (side == unknown))
            out_of_range = (side < least) | endless
            if out_of_range.any():
                tick = int(np.argmax(out_of_range))
                return tick, float(side[tick])
            least = -np.inf  # a bound may be below what it bounds
        return None

    def __call__(self) -> Measure:
        """Return the measure itself, so that ``tcp_speed()`` and ``tcp_speed`` mean the same in a formula."""
        return self

    def __lt__(self, limit: Quantity | float) -> Comparison:
        return self._compare(Relation.BELOW, limit)

    def __le__(self, limit: Quantity | float) -> Comparison:
        return self._compare(Relation.AT_MOST, limit)

    def __gt__(self, limit: Quantity | float) -> Comparison:
        return self._compare(Relation.ABOVE, limit)

    def __ge__(self, limit: Quantity | float) -> Comparison:
        return self._compare(Relation.AT_LEAST, limit)

    def __eq__(self, value: object) -> bool:
        if isinstance(value, Quantity | int | float):
            raise formula_error(f"{self.words} beside a limit with <, <=, > or >=", f"== {value}")
        return self is value

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
