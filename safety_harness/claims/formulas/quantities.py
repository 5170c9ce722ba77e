"""Quantities with units for the limits of formulas: ``mm(50)``, ``deg_per_s(30)``."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from numbers import Real

from safety_harness.base.exceptions import FormulaError, Place
from safety_harness.scenario.units import NUMBER, TIME, Dimension, normal_unit, parse_quantity


@dataclass(frozen=True)
class Quantity:
    """A ``value`` in SI with its ``dimension``, and with the text ``written``, which comparisons ignore."""

    value: float
    dimension: Dimension = field(compare=False)
    written: str = field(compare=False)
    kind: str = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "kind", self.dimension.name)

    def __str__(self) -> str:
        return self.written

    def __and__(self, right: object) -> Quantity:
        raise _needs_parentheses("&", self)

    __rand__ = __and__

    def __or__(self, right: object) -> Quantity:
        raise _needs_parentheses("|", self)

    __ror__ = __or__


def formula_error(expected: str, got: str, hint: str = "") -> FormulaError:
    """Return a FormulaError for a mistake in a formula that is not, or not yet, in a file."""
    return FormulaError(place=Place(field="formula"), expected=expected, got=got, hint=hint)


def _needs_parentheses(sign: str, quantity: Quantity) -> FormulaError:
    return formula_error(
        f'comparisons in parentheses, "(a > b) {sign} (c < d)", since "{sign}" binds more tightly',
        f'"{sign}" beside {quantity}',
    )


def quantity(number: float, unit: str, dimension: Dimension) -> Quantity:
    """Return ``number`` (finite) in a ``unit`` of ``dimension``, as the float in SI nearest to its text."""
    if isinstance(number, bool) or not isinstance(number, Real) or not math.isfinite(number):
        expected = f"a finite number of {unit}" if unit else "a finite number"
        raise FormulaError(place=Place(field=unit or "formula"), expected=expected, got=repr(number))
    return read_quantity(f"{float(number)!r} {unit}", dimension, Place(field=unit))


def read_quantity(text: str, dimension: Dimension, place: Place) -> Quantity:
    """Return the quantity in ``text``; raise ScenarioError at ``place`` if it is not of ``dimension``."""
    value = parse_quantity(text, dimension, place)
    number, _, unit = text.strip().partition(" ")
    if "e" not in number.lower():
        number = number.removeprefix("+")
        if "." in number:
            number = number.rstrip("0").removesuffix(".")
    unit = normal_unit(unit)
    return Quantity(value, dimension, f"{number} {unit}" if unit else number)


def plain(number: float) -> Quantity:
    """Return ``number`` as a quantity without a unit."""
    return quantity(number, "", NUMBER)


TIME_EPS = 1e-6  # of a control period: windows are written in decimals
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

    def ticks(self, period_s: float) -> tuple[int, int]:
        """Return the first and last tick, counted from now; the last is earlier if the window has no tick."""
        first, last = self.begin.value / period_s - TIME_EPS, self.end.value / period_s + TIME_EPS
        return math.ceil(first), math.floor(last)

    def phrase(self, from_now: str) -> str:
        """Return ``from_now`` followed by the end if the window begins now, else both of its times."""
        if self.begin.value == 0.0:
            return f"{from_now} {self.end}"
        return f"from {self.begin} to {self.end}"


def span_of(window: Window) -> Span | None:
    """Return the window from now to 2 s for ``s(2)``, or the window between both for ``(s(0.1), s(0.5))``."""
    if window is None:
        return None
    begin, end = window if isinstance(window, tuple) else (NOW, window)
    return Span(begin, end)
