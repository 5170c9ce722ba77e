"""A prefix of a run has the margin that a whole run of its length has, tick after tick."""

from __future__ import annotations

from math import inf

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

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
from safety_harness.claims.formulas.semantics import MarginBounds, margins
from safety_harness.extensions.field.monitoring.prefix import MOST_RECURSIONS, Prefix, refuse_endless
from tests.claims.formulas.random_formulas import (
    PERIOD_S,
    P,
    Run,
    X,
    bounds_of,
    comparisons,
    formulas,
    margins_of,
    runs,
    truths,
)

anything = formulas(comparisons | truths)
claims = anything | st.builds(Globally, anything, anything)
HIGH = Comparison(X, Relation.ABOVE, mm(0))


def at(run: Run, tick: int):
    def bounds(atom: Comparison | Truth) -> tuple[float, float]:
        of_all = bounds_of(atom, run)
        return float(of_all.low[tick]), float(of_all.high[tick])

    return bounds


def until_tick(run: Run, tick: int) -> Run:
    return {name: values[: tick + 1] for name, values in run.items()}


@settings(max_examples=400, deadline=None)
@given(claims, runs(1, 24))
def test_every_prefix_has_the_margin_of_a_whole_run(formula: Formula, run: Run) -> None:
    try:
        prefix = Prefix(formula, PERIOD_S)
    except FormulaError:
        assume(False)
    for tick in range(len(run["x"])):
        prefix.step(at(run, tick))
        whole = margins_of(formula, until_tick(run, tick)).bounds
        assert (prefix.least, prefix.most) == (whole.low[0], whole.high[0])


@settings(max_examples=200, deadline=None)
@given(claims, runs(2, 24), st.integers(0, 2**32 - 1))
def test_the_latest_tick_may_be_known_better_later(formula: Formula, run: Run, seed: int) -> None:
    """As bounds from a tick to the next, which are known one tick later than its value."""
    try:
        prefix = Prefix(formula, PERIOD_S)
    except FormulaError:
        assume(False)
    wider = np.random.default_rng(seed).uniform(0.0, 0.004, len(run["x"]))

    def known(tick: int, cell: bool):
        def bounds(atom: Comparison | Truth) -> tuple[float, float]:
            low, high = at(run, tick)(atom)
            by = wider[tick] if cell else 0.0
            return low - by, high + by

        return bounds

    for now in range(len(run["x"])):
        prefix.step(known(now, False), [known(now - 1, True)] if now else [])

        def whole(atom: Comparison | Truth, now: int = now) -> MarginBounds:
            each = [known(tick, tick < now)(atom) for tick in range(now + 1)]
            return MarginBounds(*np.array(each).T)

        assert prefix.least == margins(formula, whole, PERIOD_S).bounds.low[0]


def test_what_is_remembered_does_not_grow() -> None:
    prefix = Prefix(Always(Eventually(HIGH, Span(ms(0), ms(80)))), PERIOD_S)
    sizes = set()
    for tick in range(2_000):
        prefix.step(lambda _, tick=tick: (float(tick % 10) - 1.0,) * 2)
        sizes.add(prefix._values.size)
    assert len(sizes) == 1
    assert prefix.latest == (8.0, 8.0)


@pytest.mark.parametrize(
    ("formula", "words"),
    [
        (Always(Always(HIGH), Span(ms(0), s(1))), "which only the end of the run decides"),
        (Globally(Eventually(HIGH), HIGH), "which only the end of the run decides"),
        (Until(HIGH, Truth(P), Span(ms(1), ms(2))), "a window with a control tick"),
        (Always(HIGH, Span(ms(0), s(1_000_000))), "windows that reach at most 160 s ahead"),
    ],
)
def test_what_needs_more_memory_is_refused_with_the_reason(formula: Formula, words: str) -> None:
    with pytest.raises(FormulaError, match=words):
        refuse_endless(formula, PERIOD_S)


def test_only_so_many_operators_without_a_window() -> None:
    formula: Formula = HIGH
    for _ in range(MOST_RECURSIONS):
        formula = Always(Not(formula))
    refuse_endless(formula, PERIOD_S)
    with pytest.raises(FormulaError, match="operators without a window"):
        refuse_endless(Eventually(formula), PERIOD_S)


def test_a_prefix_of_nothing_has_no_margin_above_all() -> None:
    assert Prefix(Always(HIGH), PERIOD_S).least == -inf
