"""Which tick, and which comparison or truth, a formula's margin comes from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from safety_harness.formulas.formula import (
    Always,
    And,
    Comparison,
    Eventually,
    Globally,
    Not,
    Or,
    Truth,
    Until,
)
from safety_harness.formulas.quantities import Span
from safety_harness.formulas.semantics import MarginBounds, Margins, ticks_of, where_triggered


@dataclass(frozen=True)
class Witness:
    """A tick, from 0, and what is said there; ``atom`` is None for what comes after the last tick."""

    tick: int
    atom: Comparison | Truth | None


def witness(margins: Margins, tick: int, period_s: float, *, low: bool) -> Witness:
    """Where the lower (or upper) bound of the margin at ``tick`` comes from.

    Of several places with the same margin the first that is not known for certain, else the first.
    """
    formula, parts = margins.formula, margins.parts
    match formula:
        case Comparison() | Truth():
            return Witness(tick, formula)
        case Not():
            return witness(parts[0], tick, period_s, low=not low)
        case And() | Or():
            best = _first([part.bounds for part in parts], tick, low=low, least=isinstance(formula, And))
            return witness(parts[best], tick, period_s, low=low)
        case Always(span=span) | Eventually(span=span):
            least = isinstance(formula, Always)
            at = _in_window(parts[0].bounds, tick, span, period_s, low=low, least=least)
            return witness(parts[0], at, period_s, low=low) if at is not None else _beyond(margins)
        case Globally():
            asked = where_triggered(parts[0].bounds, parts[1].bounds)
            at = _in_window(asked, tick, None, period_s, low=low, least=True)
            return witness(parts[1], at or 0, period_s, low=low)
        case Until(span=span):
            return _of_until(margins, tick, span, period_s, low=low)
    return witness(parts[0], tick, period_s, low=low)


def _beyond(margins: Margins) -> Witness:
    return Witness(len(margins.bounds.low), None)


def _side(bounds: MarginBounds, *, low: bool) -> NDArray[np.float64]:
    return bounds.low if low else bounds.high


def _extreme(values: NDArray[np.float64], doubtful: NDArray[np.bool_], *, least: bool) -> int:
    """The place of the least or largest value, a doubtful one before others."""
    at = np.flatnonzero(values == (values.min() if least else values.max()))
    unsure = at[doubtful[at]]
    return int(unsure[0] if len(unsure) else at[0])


def _first(parts: list[MarginBounds], tick: int, *, low: bool, least: bool) -> int:
    values = np.array([_side(part, low=low)[tick] for part in parts])
    doubtful = np.array([part.low[tick] < part.high[tick] for part in parts])
    return _extreme(values, doubtful, least=least)


def _in_window(
    body: MarginBounds, tick: int, span: Span | None, period_s: float, *, low: bool, least: bool
) -> int | None:
    """The tick that decides, or None where that is one beyond the last."""
    values, n = _side(body, low=low), len(body.low)
    begin, end = (tick, n - 1) if span is None else (tick + t for t in ticks_of(span, period_s))
    within = slice(begin, min(end, n - 1) + 1)
    if begin >= n:
        return None
    at = begin + _extreme(values[within], body.low[within] < body.high[within], least=least)
    beyond = -np.inf if low else np.inf
    runs_on = end >= n and (beyond < values[at] if least else beyond > values[at])
    return None if runs_on else at


def _of_until(margins: Margins, tick: int, span: Span | None, period_s: float, *, low: bool) -> Witness:
    """Of the ticks at which the second part may end it the best, and there the worst of what is asked."""
    first, second = margins.parts
    n = len(margins.bounds.low) - tick
    begin, end = (0, n - 1) if span is None else ticks_of(span, period_s)
    later = max(begin + 1 - n, 0 if end < n else 1)  # as many ticks beyond the last as matter
    lasts, ends = (_from(part.bounds, tick, later) for part in (first, second))
    ways = [
        np.minimum(e, np.append(np.inf, np.minimum.accumulate(f)[:-1]))[begin : end + 1]
        for f, e in ((lasts.low, ends.low), (lasts.high, ends.high))
    ]
    j = begin + _extreme(ways[0 if low else 1], ways[0] < ways[1], least=False)
    asked = MarginBounds(np.append(lasts.low[:j], ends.low[j]), np.append(lasts.high[:j], ends.high[j]))
    at = _extreme(_side(asked, low=low), asked.low < asked.high, least=True)
    if at >= n:
        return _beyond(margins)
    return witness(second if at == j else first, tick + at, period_s, low=low)


def _from(bounds: MarginBounds, tick: int, later: int) -> MarginBounds:
    """From ``tick`` on, with as many unknown ones after the last."""
    return MarginBounds(
        np.append(bounds.low[tick:], np.full(later, -np.inf)),
        np.append(bounds.high[tick:], np.full(later, np.inf)),
    )
