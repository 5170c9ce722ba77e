"""What a formula's margin is at every tick: an interval, so that what is not known is not guessed.

The margin of a comparison is the distance to its limit, that of a truth +-inf; "not" turns the sign,
"and" and "always" take the least, "or" and "eventually" the largest, "until" the largest over the
ticks j of its window of the least of second(j) and first before j.  Windows are in control ticks,
ends included.  A value at its very limit is ``LEAST``, the smallest normal number, on the right side of <=
and >=, and on the wrong side of < and >: no margin is 0, and a formula and its negation never both hold.

Each margin is an interval from ``low`` to ``high``: NaN, ticks that were not reached and windows that run
beyond the last tick make it [-inf, inf], and every operator takes the bounds of its parts to its own.
(Compare Deshmukh et al., Robust online monitoring of signal temporal logic, 2017.)  Operators
without a window end with the run.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import ceil, floor

import numpy as np
from numpy.typing import NDArray

from safety_harness.compiled import compiled
from safety_harness.formulas.formula import (
    Always,
    And,
    Comparison,
    Eventually,
    Formula,
    Globally,
    Initially,
    Not,
    Or,
    Relation,
    Truth,
    Until,
)
from safety_harness.formulas.quantities import Span

LEAST = float(np.finfo(np.float64).tiny)
TIME_EPS = 1e-6  # of a control period: windows are written in decimals

Values = NDArray[np.float64]
Atoms = Callable[[Comparison | Truth], "MarginBounds"]


@dataclass(frozen=True, eq=False)
class MarginBounds:
    """Margins (n,) that lie between ``low`` and ``high``, never NaN; one array where they are known."""

    low: Values
    high: Values

    def __neg__(self) -> MarginBounds:
        low = -self.high
        return MarginBounds(low, low if self.low is self.high else -self.low)


@dataclass(frozen=True, eq=False)
class Margins:
    """A formula with its margins at every tick, and those of its parts."""

    formula: Formula
    bounds: MarginBounds
    parts: tuple[Margins, ...] = ()


def ticks_of(span: Span, period_s: float) -> tuple[int, int]:
    """The first and the last tick of a window, counted from now; last before first if it has none."""
    return ceil(span.begin.value / period_s - TIME_EPS), floor(span.end.value / period_s + TIME_EPS)


def margins(formula: Formula, atoms: Atoms, period_s: float) -> Margins:
    """The margins of ``formula`` at every tick, ``atoms`` giving those of its comparisons and truths."""
    if isinstance(formula, Comparison | Truth):
        return Margins(formula, atoms(formula))
    parts = tuple(margins(part, atoms, period_s) for part in formula.parts)
    return Margins(formula, _joined(formula, [part.bounds for part in parts], period_s), parts)


def _joined(formula: Formula, parts: list[MarginBounds], period_s: float) -> MarginBounds:
    match formula:
        case Not():
            return -parts[0]
        case And():
            return _least(parts)
        case Or():
            return -_least([-part for part in parts])
        case Always(span=span):
            return _always(parts[0], span, period_s)
        case Eventually(span=span):
            return -_always(-parts[0], span, period_s)
        case Until(span=span):
            return _until(parts[0], parts[1], span, period_s)
        case Globally():
            return _always(where_triggered(*parts), None, period_s)
        case Initially():
            return parts[0]
    raise TypeError(f"no formula: {formula!r}")


def _least(parts: list[MarginBounds]) -> MarginBounds:
    low = np.minimum.reduce([part.low for part in parts])
    if all(part.low is part.high for part in parts):
        return MarginBounds(low, low)
    return MarginBounds(low, np.minimum.reduce([part.high for part in parts]))


def _always(body: MarginBounds, span: Span | None, period_s: float) -> MarginBounds:
    if span is None:
        low = least_from_here(body.low)
        return MarginBounds(low, low if body.low is body.high else least_from_here(body.high))
    begin, end = ticks_of(span, period_s)
    return MarginBounds(
        least_in_window(body.low, begin, end, -np.inf), least_in_window(body.high, begin, end, np.inf)
    )


def _until(lasts: MarginBounds, ends: MarginBounds, span: Span | None, period_s: float) -> MarginBounds:
    """With a window: second comes within it, and first lasts until second comes after its begin.

    (Donze, Ferrere, Maler, Efficient robust monitoring for STL, 2013.)
    """
    if span is None:
        return MarginBounds(
            until_from_here(lasts.low, ends.low, -np.inf), until_from_here(lasts.high, ends.high, -np.inf)
        )
    begin, end = ticks_of(span, period_s)
    bounds = []
    for first, second, beyond in ((lasts.low, ends.low, -np.inf), (lasts.high, ends.high, np.inf)):
        comes = -least_in_window(-second, begin, end, -beyond)
        lasting = until_from_here(first, second, beyond)
        if begin > 0:
            shifted = np.full(len(first), beyond)
            shifted[: max(len(first) - begin, 0)] = lasting[begin:]
            lasting = np.minimum(shifted, least_in_window(first, 0, begin - 1, beyond))
        bounds.append(np.minimum(comes, lasting))
    return MarginBounds(*bounds)


def where_triggered(trigger: MarginBounds, response: MarginBounds) -> MarginBounds:
    """The response's margin where the trigger holds, inf where it does not, both where that is unknown."""
    low = np.where(trigger.high < 0.0, np.inf, response.low)
    high = np.where(trigger.low >= 0.0, response.high, np.inf)
    return MarginBounds(low, high)


def comparison_bounds(comparison: Comparison, low: Values, high: Values) -> MarginBounds:
    """The margins of a comparison whose signal lies between ``low`` and ``high`` (NaN: unknown)."""
    limit, relation = comparison.limit.value, comparison.relation
    above = relation in (Relation.ABOVE, Relation.AT_LEAST)
    least = low - limit if above else limit - high
    most = least if low is high else high - limit if above else limit - low
    at_limit = -LEAST if relation in (Relation.ABOVE, Relation.BELOW) else LEAST
    for margin in (least, most):
        margin[margin == 0.0] = at_limit
    unknown = np.isnan(least) | np.isnan(most)
    if not unknown.any():
        return MarginBounds(least, most)
    return MarginBounds(np.where(unknown, -np.inf, least), np.where(unknown, np.inf, most))


def truth_bounds(value: Values) -> MarginBounds:
    """The margins of a truth that is 1.0, 0.0, or NaN where it is unknown."""
    margin = np.where(value > 0.5, np.inf, -np.inf)
    unknown = np.isnan(value)
    return MarginBounds(margin, np.where(unknown, np.inf, margin) if unknown.any() else margin)


@compiled
def least_from_here(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """out[k] = min of x[k:]."""
    out = np.empty(x.shape[0])
    least = np.inf
    for k in range(x.shape[0] - 1, -1, -1):
        least = min(least, x[k])
        out[k] = least
    return out


@compiled
def least_in_window(x: NDArray[np.float64], begin: int, end: int, beyond: float) -> NDArray[np.float64]:
    """out[k] = min of x[k + begin] to x[k + end], ends included, with ``beyond`` where they leave x.

    0 <= begin <= end.  A queue keeps the positions at which a smaller value than all before it
    stands, seen from the window's begin: each is put in and taken out once.

    ``x`` (n,).
    """
    n = x.shape[0]
    out = np.empty(n)
    queue = np.empty(n, np.int64)
    first, last = 0, 0  # the queue is queue[first:last], its values falling from last to first
    for k in range(n - 1, -1, -1):
        entering = k + begin
        if entering < n:
            value = x[entering]
            while last > first and x[queue[last - 1]] >= value:
                last -= 1
            queue[last] = entering
            last += 1
            while queue[first] > k + end:
                first += 1
        least = x[queue[first]] if last > first else np.inf
        out[k] = min(least, beyond) if k + end >= n else least
    return out


@compiled
def until_from_here(
    lasts: NDArray[np.float64], ends: NDArray[np.float64], beyond: float
) -> NDArray[np.float64]:
    """out[k] = max over j >= k of min(ends[j], min of lasts[k:j]); ``beyond`` follows the last sample.

    ``lasts`` and ``ends`` (n,).
    """
    n = lasts.shape[0]
    out = np.empty(n)
    after = beyond
    for k in range(n - 1, -1, -1):
        after = max(ends[k], min(lasts[k], after))
        out[k] = after
    return out
