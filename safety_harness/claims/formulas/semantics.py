"""Compute the margin of a formula at every tick as an interval, because some values may be unknown.

``witness`` finds the tick and the comparison or truth from which a margin results.

The margin of a comparison is the signal's distance from the limit, and the margin of a truth is +-inf. "not"
changes the sign. "and" and "always" take the least margin, and "or" and "eventually" take the largest margin.
For "until", the result is computed for each tick j of its window: it is the least of the second part's margin
at j and the margins of the first part before j. The largest of these values is the margin. Windows are
counted in control ticks and include both ends. A value exactly at its limit has the margin ``LEAST``, the
smallest normal number, if the relation is <= or >=. For < and >, its margin is -``LEAST``. So no margin is 0,
and a formula and its negation never both hold.

Each margin is an interval from ``low`` to ``high``. The interval is [-inf, inf] for a NaN, for a tick that
the run did not reach, and for a window that ends after the last tick. Every operator computes its bounds from
the bounds of its parts. (See Deshmukh et al., Robust online monitoring of signal temporal logic, 2017.) The
scope of an operator without a window ends with the run.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import compiled
from safety_harness.claims.formulas.formula import (
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
from safety_harness.claims.formulas.quantities import Span

LEAST = float(np.finfo(np.float64).tiny)
OF_A_TICK = (Comparison, Truth, Not, And, Or)
OPERATORS = (Comparison, Truth, Not, And, Or, Always, Eventually, Until, Globally)
# Indices in OPERATORS, since compiled code takes no classes.
NOT, AND, OR, ALWAYS, EVENTUALLY, UNTIL, GLOBALLY = range(2, 9)
NO_WINDOW = (-1, -1)  # a negative begin: the operator's scope ends with the run

Values = NDArray[np.float64]
Atoms = Callable[[Comparison | Truth], "MarginBounds"]


@dataclass(frozen=True, eq=False)
class MarginBounds:
    """Lower bounds ``low`` (n,) and upper bounds ``high`` (n,) of margins, which are never NaN.

    If all margins are known, both fields are the same array.
    """

    low: Values
    high: Values

    def __neg__(self) -> MarginBounds:
        low = -self.high
        return MarginBounds(low, low if self.low is self.high else -self.low)


@dataclass(frozen=True, eq=False)
class Margins:
    """A formula with the bounds of its margin at every tick, and with the margins of its parts."""

    formula: Formula
    bounds: MarginBounds
    parts: tuple[Margins, ...] = ()


@dataclass(frozen=True, eq=False)
class Case:
    """A case that is possible at the ticks ``where`` (n,).

    ``atoms`` returns the margins of the comparisons and truths in this case.
    """

    where: NDArray[np.bool_]
    atoms: Atoms


def margins(formula: Formula, atoms: Atoms, period_s: float, cases: Sequence[Case] = ()) -> Margins:
    """Return the margins of ``formula`` at every tick.

    They are computed from the margins of its comparisons and truths, which ``atoms`` returns. If several of
    the ``cases`` apply to a tick, exactly one of them was true at that tick. At such a tick, the margin of an
    "and" or "or" of comparisons and truths lies between the least and the largest margin over these cases.
    This bound is useful even if the margin of each single part is unknown.
    """
    if isinstance(formula, Comparison | Truth):
        return Margins(formula, atoms(formula))
    parts = tuple(margins(part, atoms, period_s, cases) for part in formula.parts)
    bounds = _joined(formula, [part.bounds for part in parts], period_s)
    if (
        # A case holds at a single tick, so it limits only formulas without temporal operators.
        cases
        and isinstance(formula, And | Or)
        and all(isinstance(node, OF_A_TICK) for node in formula.nodes())
    ):
        bounds = _of_any_case(
            bounds, [(case.where, margins(formula, case.atoms, period_s)) for case in cases]
        )
    return Margins(formula, bounds, parts)


def ticks_asked(
    margins: Margins, period_s: float, begin: NDArray[np.bool_] | None = None
) -> list[tuple[Comparison | Truth, NDArray[np.bool_]]]:
    """Return each comparison and truth, together with a mask of ticks (n,).

    The mask contains the ticks at which the comparison or truth affects the value of the formula at the first
    tick. If an operator is evaluated at the ticks ``begin`` (n,), its parts are evaluated at all ticks of the
    windows that begin there.
    """
    formula, n = margins.formula, len(margins.bounds.low)
    begins = np.arange(n) == 0 if begin is None else begin
    if isinstance(formula, Comparison | Truth):
        return [(formula, begins)]
    whens = [begins] * len(margins.parts)
    if isinstance(formula, Always | Eventually | Until):
        first, last = (0, n) if formula.span is None else formula.span.ticks(period_s)
        whens = [_windows(begins, 0 if k + 1 < len(whens) else first, last) for k in range(len(whens))]
    elif isinstance(formula, Globally):
        every = _windows(begins, 0, n)
        whens = [every, every & (margins.parts[0].bounds.high >= 0.0)]
    pairs = zip(margins.parts, whens, strict=True)
    return [tick for part, when in pairs for tick in ticks_asked(part, period_s, when)]


def _windows(begin: NDArray[np.bool_], first: int, last: int) -> NDArray[np.bool_]:
    """Return a mask (n,) of the ticks that are ``first`` to ``last`` ticks after a tick of ``begin`` (n,)."""
    # Prefix sums: a window contains a tick of ``begin`` if the sums at its two ends differ.
    counts = np.append(0, np.cumsum(begin))
    ticks = np.arange(len(begin))
    any_in_window: NDArray[np.bool_] = (
        counts[np.maximum(ticks - first + 1, 0)] > counts[np.maximum(ticks - last, 0)]
    )
    return any_in_window


def _of_any_case(bounds: MarginBounds, cases: list[tuple[NDArray[np.bool_], Margins]]) -> MarginBounds:
    low = np.minimum.reduce([np.where(where, margins.bounds.low, np.inf) for where, margins in cases])
    high = np.maximum.reduce([np.where(where, margins.bounds.high, -np.inf) for where, margins in cases])
    some = np.logical_or.reduce([where for where, _ in cases])
    return MarginBounds(np.where(some, low, bounds.low), np.where(some, high, bounds.high))


def _joined(formula: Formula, parts: list[MarginBounds], period_s: float) -> MarginBounds:
    if isinstance(formula, Initially):
        return parts[0]
    span = getattr(formula, "span", None)
    begin, end = NO_WINDOW if span is None else span.ticks(period_s)
    operator, bounds = OPERATORS.index(type(formula)), parts[0]
    for part in parts[1:] or parts:  # of three and more, two by two
        bounds = MarginBounds(*operate(operator, begin, end, bounds.low, bounds.high, part.low, part.high))
    return bounds


def where_triggered(trigger: MarginBounds, response: MarginBounds) -> MarginBounds:
    """Return the response's margin if the trigger holds, and inf if the trigger does not hold.

    If the trigger is unknown, the bounds cover both possibilities.
    """
    return MarginBounds(*_bounds_where_triggered(trigger.low, trigger.high, response.low, response.high))


def comparison_bounds(comparison: Comparison, low: Values, high: Values) -> MarginBounds:
    """Return the margins of a comparison whose signal lies between ``low`` (n,) and ``high`` (n,).

    NaN marks an unknown value.
    """
    limit, relation = comparison.limit.value, comparison.relation
    above = relation in (Relation.ABOVE, Relation.AT_LEAST)
    least = low - limit if above else limit - high
    most = least if low is high else high - limit if above else limit - low
    at_limit = -LEAST if relation in (Relation.ABOVE, Relation.BELOW) else LEAST
    for margin in (least, most):
        # A margin of 0 would be its own negation, so the relation decides its sign.
        margin[margin == 0.0] = at_limit
    unknown = np.isnan(least) | np.isnan(most)
    if not unknown.any():
        return MarginBounds(least, most)
    return MarginBounds(np.where(unknown, -np.inf, least), np.where(unknown, np.inf, most))


def truth_bounds(value: Values) -> MarginBounds:
    """Return the margins of a truth.

    ``value`` (n,) is 1.0 for true, 0.0 for false, and NaN for unknown.
    """
    margin = np.where(value > 0.5, np.inf, -np.inf)
    unknown = np.isnan(value)
    return MarginBounds(margin, np.where(unknown, np.inf, margin) if unknown.any() else margin)


@compiled
def least_from_here(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return an array out with out[k] = min(x[k:]) for ``x`` of shape (n,)."""
    out = np.empty(x.shape[0])
    least = np.inf
    for k in range(x.shape[0] - 1, -1, -1):
        least = min(least, x[k])
        out[k] = least
    return out


@compiled
def least_in_window(x: NDArray[np.float64], begin: int, end: int, outside: float) -> NDArray[np.float64]:
    """Return an array out with out[k] = min(x[k + begin : k + end + 1]).

    ``outside`` is the value of x after its last sample. Here 0 <= begin <= end. A window of w samples spans
    at most two blocks of w samples. The window has one section in each of these blocks, and the least value
    of the window is the lesser of the two sections' least values (van Herk, 1992).

    ``x`` (n,).
    """
    n, w = x.shape[0], end - begin + 1
    out, to_end, from_begin = np.full(n, np.inf), np.empty(n), np.empty(n)
    for block in range(0, n, w):
        last = min(block + w, n) - 1
        from_begin[block] = x[block]
        for k in range(block + 1, last + 1):
            from_begin[k] = min(from_begin[k - 1], x[k])
        to_end[last] = x[last]
        for k in range(last - 1, block - 1, -1):
            to_end[k] = min(to_end[k + 1], x[k])
    inside = max(n - end, 0)  # windows that end within x
    for k in range(inside):
        out[k] = min(to_end[k + begin], from_begin[k + end])
    least = np.inf
    for k in range(n - begin - 1, inside - 1, -1):
        least = min(least, x[k + begin])
        out[k] = least
    for k in range(inside, n):
        out[k] = min(out[k], outside)
    return out


@compiled
def until_from_here(
    lasts: NDArray[np.float64], ends: NDArray[np.float64], outside: float
) -> NDArray[np.float64]:
    """Return an array out with out[k] = max over j >= k of min(ends[j], min(lasts[k:j])).

    ``lasts`` and ``ends`` are (n,); ``outside`` is the result after the last sample.
    """
    n = lasts.shape[0]
    out = np.empty(n)
    later = outside
    for k in range(n - 1, -1, -1):
        # Either the second part holds here, or the first part holds here and the "until" holds at the next
        # tick.
        later = max(ends[k], min(lasts[k], later))
        out[k] = later
    return out


@compiled
def _bounds_where_triggered(
    trigger_low: Values, trigger_high: Values, low: Values, high: Values
) -> tuple[Values, Values]:
    """Return the lower and the upper bounds (n,) of the result of ``where_triggered``.

    ``trigger_low``, ``trigger_high``, ``low`` and ``high`` are of shape (n,).
    """
    least, most = low.copy(), high.copy()
    for k in range(len(least)):
        if trigger_high[k] < 0.0:
            least[k] = np.inf
        if not trigger_low[k] >= 0.0:
            most[k] = np.inf
    return least, most


@compiled
def _until(lasts: Values, ends: Values, begin: int, end: int, outside: float) -> Values:
    """Return one bound of the margin of an "until" at each tick, shape (n,).

    The second part must hold in the window, and the first part must hold until then. ``lasts`` (n,) and
    ``ends`` (n,) are the bounds of the first and the second part. ``outside`` is the bound after the last
    sample. Source: Donze, Ferrere and Maler, Efficient robust monitoring for STL, 2013.
    """
    if begin < 0:
        return until_from_here(lasts, ends, -np.inf)
    lasting = until_from_here(lasts, ends, outside)
    # In a window that begins later, the first part must also hold before the window.
    if begin > 0:
        shifted = np.full(len(lasts), outside)
        shifted[: max(len(lasts) - begin, 0)] = lasting[begin:]
        lasting = np.minimum(shifted, least_in_window(lasts, 0, begin - 1, outside))
    # The least of three margins: the second part holds in the window, the first part holds before the window,
    # and an "until" without an end holds from the window's begin.
    return np.minimum(-least_in_window(-ends, begin, end, -outside), lasting)


@compiled
def operate(
    operator: int, begin: int, end: int, low: Values, high: Values, other_low: Values, other_high: Values
) -> tuple[Values, Values]:
    """Return the lower and the upper bounds of an operator's margin, each of shape (n,).

    The bounds are computed from the bounds of the operator's one or two parts. ``low``, ``high``,
    ``other_low`` and ``other_high`` are of shape (n,).

    Args:
        operator: The operator's place in ``OPERATORS``.
        begin: The first tick of the operator's window, relative to now; a negative number means that the
            operator has no window.
        end: The last tick of the operator's window.
        low: The lower bounds of the first part's margin.
        high: The upper bounds of the first part's margin.
        other_low: The lower bounds of the second part's margin.
        other_high: The upper bounds of the second part's margin.

    """
    if operator == NOT:
        return -high, -low
    if operator == AND:
        return np.minimum(low, other_low), np.minimum(high, other_high)
    if operator == OR:
        return np.maximum(low, other_low), np.maximum(high, other_high)
    if operator == UNTIL:
        return _until(low, other_low, begin, end, -np.inf), _until(high, other_high, begin, end, np.inf)
    if operator == GLOBALLY:
        low, high = _bounds_where_triggered(low, high, other_low, other_high)
    if operator == EVENTUALLY:  # not always not
        low, high = -high, -low
    if begin < 0:
        low, high = least_from_here(low), least_from_here(high)
    else:
        low, high = least_in_window(low, begin, end, -np.inf), least_in_window(high, begin, end, np.inf)
    return (-high, -low) if operator == EVENTUALLY else (low, high)


@dataclass(frozen=True)
class Witness:
    """The tick that decides a margin, and the comparison or truth that decides it.

    Ticks are counted from 0; ``atom`` is None if the deciding tick is after the run.
    """

    tick: int
    atom: Comparison | Truth | None


def witness(margins: Margins, tick: int, period_s: float, *, low: bool) -> Witness:
    """Return the witness of a margin at ``tick``.

    If ``low`` is true, it is the witness of the margin's lower bound, and otherwise that of its upper bound.
    If several comparisons or ticks have this margin, the function prefers those whose value is uncertain, and
    returns the first.
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
            return witness(parts[0], at, period_s, low=low) if at is not None else _no_witness(margins)
        case Globally():
            triggered = where_triggered(parts[0].bounds, parts[1].bounds)
            at = _in_window(triggered, tick, None, period_s, low=low, least=True)
            return witness(parts[1], at or 0, period_s, low=low)
        case Until(span=span):
            return _of_until(margins, tick, span, period_s, low=low)
    return witness(parts[0], tick, period_s, low=low)


def _no_witness(margins: Margins) -> Witness:
    return Witness(len(margins.bounds.low), None)


def _side(bounds: MarginBounds, *, low: bool) -> NDArray[np.float64]:
    return bounds.low if low else bounds.high


def _extreme(values: NDArray[np.float64], doubtful: NDArray[np.bool_], *, least: bool) -> int:
    """Return the index of the least or the largest value.

    If several values are equal, the index is that of the first ``doubtful`` value or, without a doubtful
    value, of the first value.
    """
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
    """Return the tick that decides, or None if the time after the last tick decides."""
    values, n = _side(body, low=low), len(body.low)
    begin, end = (tick, n - 1) if span is None else (tick + t for t in span.ticks(period_s))
    window = slice(begin, min(end, n - 1) + 1)
    if begin >= n:
        return None
    at = begin + _extreme(values[window], body.low[window] < body.high[window], least=least)
    outside = -np.inf if low else np.inf
    runs_on = end >= n and (outside < values[at] if least else outside > values[at])
    return None if runs_on else at


def _of_until(margins: Margins, tick: int, span: Span | None, period_s: float, *, low: bool) -> Witness:
    """Return the witness of an "until".

    The second part is taken at the tick that is best for the "until". If the first part has a smaller margin
    at an earlier tick, the witness is there.
    """
    first, second = margins.parts
    n = len(margins.bounds.low) - tick
    begin, end = (0, n - 1) if span is None else span.ticks(period_s)
    later = max(begin + 1 - n, 0 if end < n else 1)  # as many ticks beyond the last as matter
    lasts, ends = (_bounds_from(part.bounds, tick, later) for part in (first, second))
    candidates = [
        np.minimum(e, np.append(np.inf, np.minimum.accumulate(f)[:-1]))[begin : end + 1]
        for f, e in ((lasts.low, ends.low), (lasts.high, ends.high))
    ]
    j = begin + _extreme(candidates[0 if low else 1], candidates[0] < candidates[1], least=False)
    deciding = MarginBounds(np.append(lasts.low[:j], ends.low[j]), np.append(lasts.high[:j], ends.high[j]))
    at = _extreme(_side(deciding, low=low), deciding.low < deciding.high, least=True)
    if at >= n:
        return _no_witness(margins)
    return witness(second if at == j else first, tick + at, period_s, low=low)


def _bounds_from(bounds: MarginBounds, tick: int, later: int) -> MarginBounds:
    """Return ``bounds`` from ``tick`` on.

    Infinite bounds for ``later`` further ticks are appended.
    """
    return MarginBounds(
        np.append(bounds.low[tick:], np.full(later, -np.inf)),
        np.append(bounds.high[tick:], np.full(later, np.inf)),
    )
