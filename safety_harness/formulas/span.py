"""Windows of time: from when to when, counted from the tick at which a formula is asked."""

from __future__ import annotations

from dataclasses import dataclass

from safety_harness.formulas.quantities import Quantity, formula_error
from safety_harness.scenario.units import TIME

Window = Quantity | tuple[Quantity, Quantity] | None
NOW = Quantity(0.0, TIME, "0 s")


@dataclass(frozen=True)
class Span:
    """A window of time from ``begin`` to ``end``, both counted from now and included."""

    begin: Quantity
    end: Quantity

    def __post_init__(self) -> None:
        for time in (self.begin, self.end):
            if not isinstance(time, Quantity) or time.dimension is not TIME:
                raise formula_error("a time such as s(2), or a pair of them", str(time))
        if not 0.0 <= self.begin.value < self.end.value:
            got = f"{self.begin} to {self.end}"
            raise formula_error("a window from a time of at least 0 s to a later one", got)

    def words(self, from_now: str) -> str:
        """``from_now`` with its end if it begins now, else from when to when."""
        if self.begin.value == 0.0:
            return f"{from_now} {self.end}"
        return f"from {self.begin} to {self.end}"


def span_of(within: Window) -> Span | None:
    """``s(2)``: from now to 2 s; ``(s(0.1), s(0.5))``: from the one to the other."""
    if within is None:
        return None
    begin, end = within if isinstance(within, tuple) else (NOW, within)
    return Span(begin, end)
