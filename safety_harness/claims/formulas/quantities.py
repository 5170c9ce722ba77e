"""Quantities with units for the limits of formulas: ``mm(50)``, ``deg_per_s(30)``."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from numbers import Real

from safety_harness.base.exceptions import FormulaError, Place
from safety_harness.scenario.units import NUMBER, TIME, Dimension, normal_unit, parse_quantity


@dataclass(frozen=True)
class Quantity:
    """A physical quantity with its ``value`` in SI units and its ``dimension``.

    ``written`` is the quantity as text, which comparisons ignore.
    """

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
    """Return a FormulaError for a mistake in a formula that does not come from a file."""
    return FormulaError(place=Place(field="formula"), expected=expected, got=got, hint=hint)


def _needs_parentheses(sign: str, quantity: Quantity) -> FormulaError:
    return formula_error(
        f'comparisons in parentheses, "(a > b) {sign} (c < d)", since "{sign}" binds more tightly',
        f'"{sign}" beside {quantity}',
    )


def quantity(number: float, unit: str, dimension: Dimension) -> Quantity:
    """Return ``number`` in ``unit`` as a quantity.

    The quantity's value is the nearest float in SI units. The number must be finite, and the unit must be a
    unit of ``dimension``.
    """
    if isinstance(number, bool) or not isinstance(number, Real) or not math.isfinite(number):
        expected = f"a finite number of {unit}" if unit else "a finite number"
        raise FormulaError(place=Place(field=unit or "formula"), expected=expected, got=repr(number))
    return read_quantity(f"{float(number)!r} {unit}", dimension, Place(field=unit))


def read_quantity(text: str, dimension: Dimension, place: Place) -> Quantity:
    """Return the quantity in ``text``.

    Raise ScenarioError at ``place`` if the quantity does not have the dimension ``dimension``.
    """
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
NOW = Quantity(0.0, TIME, "0 s")  # the beginning of a window that states only its end


@dataclass(frozen=True)
class Span:
    """A window of time from ``begin`` to ``end``.

    Both times are relative to the present tick, and the window includes both.
    """

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
        """Return the first and the last tick, relative to now.

        If the window contains no tick, the last tick is before the first.
        """
        first, last = self.begin.value / period_s - TIME_EPS, self.end.value / period_s + TIME_EPS
        return math.ceil(first), math.floor(last)

    def phrase(self, from_now: str) -> str:
        """Return the window as text.

        If the window begins now, the text is ``from_now`` and the end. Any other window is written with both
        times.
        """
        if self.begin.value == 0.0:
            return f"{from_now} {self.end}"
        return f"from {self.begin} to {self.end}"


def span_of(window: Window) -> Span | None:
    """Return ``window`` as a span.

    For example, ``s(2)`` becomes the span from now to 2 s; a pair contains the begin and the end of a span.
    """
    if window is None:
        return None
    begin, end = window if isinstance(window, tuple) else (NOW, window)
    return Span(begin, end)
