"""A prefix of a run has the margin that a whole run of its length has, tick after tick."""

from __future__ import annotations

from math import inf, nan

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from safety_harness.base.exceptions import FormulaError
from safety_harness.claims.formulas.formula import (
    Always,
    Comparison,
    Eventually,
    Formula,
    Globally,
    Not,
    Relation,
    Truth,
    Until,
)
from safety_harness.claims.formulas.language import mm, ms, s
from safety_harness.claims.formulas.quantities import Span
from safety_harness.claims.formulas.semantics import MarginBounds, comparison_bounds, margins, truth_bounds
from safety_harness.extensions.field.monitoring.prefix import Prefix, refuse_endless
from tests.claims.formulas.random_formulas import (
    PERIOD_S,
    P,
    Run,
    X,
    comparisons,
    formulas,
    margins_of,
    runs,
    truths,
)

anything = formulas(comparisons | truths)
claims = anything | st.builds(Globally, anything, anything)
HIGH = Comparison(X, Relation.ABOVE, mm(0))


SIGNALS, MEASURES = ("x", "y", "p", "q"), np.array([1.0, 1.0, 0.0, 0.0])


def columns(atom: Comparison | Truth) -> tuple[int, int, int]:
    return SIGNALS.index(atom.signal.words), 0, 1


def seen(run: Run, *ticks: int, off: float = 0.0) -> NDArray[np.float64]:
    """What is known at each tick, (m, signals, 2): a measure may be off, and NaN is not known at all."""
    values = np.array([[run[name][tick] for name in SIGNALS] for tick in ticks])
    known = np.stack([values - off * MEASURES, values + off * MEASURES], axis=2)
    return np.where(np.isnan(known), (-inf, inf), known)


def until_tick(run: Run, tick: int) -> Run:
    return {name: values[: tick + 1] for name, values in run.items()}


@settings(max_examples=400, deadline=None)
@given(claims, runs(1, 24))
def test_every_prefix_has_the_margin_of_a_whole_run(formula: Formula, run: Run) -> None:
    try:
        prefix = Prefix(formula, PERIOD_S, 1, columns)
    except FormulaError:
        assume(False)
    for tick in range(len(run["x"])):
        prefix.see(seen(run, tick), grown=True)
        whole = margins_of(formula, until_tick(run, tick)).bounds
        assert (prefix.least, prefix.most) == (whole.low[0], whole.high[0])


@settings(max_examples=200, deadline=None)
@given(claims, runs(2, 24), st.integers(0, 2**32 - 1))
def test_the_latest_tick_may_be_known_better_later(formula: Formula, run: Run, seed: int) -> None:
    """As bounds from a tick to the next, which are known one tick later than its value."""
    try:
        prefix = Prefix(formula, PERIOD_S, 1, columns)
    except FormulaError:
        assume(False)
    wider = np.random.default_rng(seed).uniform(0.0, 0.004, len(run["x"]))
    for now in range(len(run["x"])):
        latest = [seen(run, now - 1, off=wider[now - 1])] if now else []
        prefix.see(np.concatenate([*latest, seen(run, now)]), grown=True)
        each = np.concatenate([seen(run, tick, off=wider[tick] * (tick < now)) for tick in range(now + 1)])

        def whole(atom: Comparison | Truth, each: NDArray[np.float64] = each) -> MarginBounds:
            low, high = each[:, SIGNALS.index(atom.signal.words)].T
            if isinstance(atom, Truth):
                return truth_bounds(np.where(low == high, low, nan))
            return comparison_bounds(atom, low, high)

        assert prefix.least == margins(formula, whole, PERIOD_S).bounds.low[0]


def test_what_is_remembered_does_not_grow() -> None:
    prefix = Prefix(Always(Eventually(HIGH, Span(ms(0), ms(80)))), PERIOD_S, 1, columns)
    sizes = set()
    for tick in range(2_000):
        run = {"x": [float(tick % 10) - 1.0], "y": [0.0], "p": [0.0], "q": [0.0]}
        prefix.see(seen(run, 0), grown=True)
        sizes.add(prefix._values.size)
    assert len(sizes) == 1
    assert prefix.latest == (8.0, 8.0)


@pytest.mark.parametrize(
    ("formula", "words"),
    [
        (Always(Always(HIGH), Span(ms(0), s(1))), "which only the end of the run decides"),
        (Globally(Eventually(HIGH), HIGH), "which only the end of the run decides"),
        (Globally(HIGH, Eventually(HIGH)), "which only the end of the run decides"),
        (Always(Not(Always(HIGH))), "which only the end of the run decides"),
        (Until(HIGH, Truth(P), Span(ms(1), ms(2))), "a window with a control tick"),
        (Always(HIGH, Span(ms(0), s(1_000_000))), "windows that reach at most 160 s ahead"),
    ],
)
def test_what_needs_more_memory_is_refused_with_the_reason(formula: Formula, words: str) -> None:
    with pytest.raises(FormulaError, match=words):
        refuse_endless(formula, PERIOD_S)


def test_a_prefix_of_nothing_has_no_margin_above_all() -> None:
    assert Prefix(Always(HIGH), PERIOD_S, 1, columns).least == -inf
