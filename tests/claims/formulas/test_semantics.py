"""The margins are those of the definition, and keep the laws of logic."""

from __future__ import annotations

from math import inf, nan

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from random_formulas import (
    Run,
    X,
    by_definition,
    comparisons,
    formulas,
    margins_of,
    relations,
    runs,
    spans,
    truths,
)

from safety_harness.claims.formulas.formula import (
    Always,
    Comparison,
    Eventually,
    Formula,
    Globally,
    Not,
    Relation,
    Until,
    conjunction,
    disjunction,
)
from safety_harness.claims.formulas.language import mm, ms
from safety_harness.claims.formulas.quantities import Span
from safety_harness.claims.formulas.semantics import LEAST

anything = formulas(comparisons | truths)
many = settings(max_examples=100, deadline=None)


def pairs(formula: Formula, run: Run) -> list[tuple[float, float]]:
    bounds = margins_of(formula, run).bounds
    return list(zip(bounds.low.tolist(), bounds.high.tolist(), strict=True))


@many
@given(anything, runs())
def test_every_margin_is_that_of_the_definition(formula: Formula, run: Run) -> None:
    assert pairs(formula, run) == by_definition(formula, run)


@many
@given(anything, anything, runs())
def test_a_trigger_asks_for_the_response_where_it_holds(trigger: Formula, reply: Formula, run: Run) -> None:
    whenever = Globally(trigger, reply)
    assert pairs(whenever, run) == by_definition(whenever, run)


def test_the_definition_is_not_met_by_a_wrong_window() -> None:
    """The oracle can fail: the last tick of a window counts."""
    run = {"x": [0.0, 0.0, -0.003], "y": [0.0] * 3, "p": [1.0] * 3, "q": [1.0] * 3}
    right = Always(Comparison(X, Relation.ABOVE, mm(-1)), Span(ms(0), ms(16)))
    short = Always(Comparison(X, Relation.ABOVE, mm(-1)), Span(ms(0), ms(8)))
    assert pairs(right, run)[0] == by_definition(right, run)[0] == (-0.002, -0.002)
    assert pairs(short, run)[0] == (0.001, 0.001)


@many
@given(anything, spans, runs())
def test_what_is_not_always_otherwise_is_eventually_so(formula: Formula, span: Span | None, run: Run) -> None:
    assert pairs(Not(Always(Not(formula), span)), run) == pairs(Eventually(formula, span), run)


@many
@given(anything, anything, runs())
def test_not_both_is_one_that_is_not(first: Formula, second: Formula, run: Run) -> None:
    both = Not(conjunction(first, second))
    assert pairs(both, run) == pairs(disjunction(Not(first), Not(second)), run)
    assert pairs(Not(Not(first)), run) == pairs(first, run)


@many
@given(anything, runs())
def test_a_formula_and_its_negation_never_both_hold_and_are_never_both_violated(
    formula: Formula, run: Run
) -> None:
    for (low, high), (low_of_not, high_of_not) in zip(
        pairs(formula, run), pairs(Not(formula), run), strict=True
    ):
        assert low <= high
        assert low != 0.0
        assert high != 0.0
        assert not (low >= 0.0 and low_of_not >= 0.0)
        assert not (high < 0.0 and high_of_not < 0.0)


@many
@given(relations, st.integers(-3, 2), st.sampled_from([Always, Eventually]), spans, runs())
def test_a_harder_limit_has_a_smaller_margin(
    relation: Relation, limit: int, over: type[Always], span: Span | None, run: Run
) -> None:
    low, high = (over(Comparison(X, relation, mm(c)), span) for c in (limit, limit + 1))
    easier, harder = (low, high) if relation.value[0] == ">" else (high, low)
    for easy, hard in zip(pairs(easier, run), pairs(harder, run), strict=True):
        assert easy[0] >= hard[0]
        assert easy[1] >= hard[1]


@many
@given(anything, anything, st.integers(0, 3), st.integers(1, 4), st.integers(0, 4), runs())
def test_a_longer_window_asks_more_of_always_and_less_of_eventually_and_until(
    formula: Formula, second: Formula, begin: int, length: int, longer: int, run: Run
) -> None:
    short, long = (Span(ms(8 * begin), ms(8 * (begin + length + more))) for more in (0, longer))
    for a, b in zip(pairs(Always(formula, short), run), pairs(Always(formula, long), run), strict=True):
        assert a >= b
        assert a[1] >= b[1]
    for once in (
        [Eventually(formula, span) for span in (short, long)],
        [Until(formula, second, span) for span in (short, long)],
    ):
        for a, b in zip(pairs(once[0], run), pairs(once[1], run), strict=True):
            assert a[0] <= b[0]
            assert a[1] <= b[1]


@many
@given(anything, runs(gaps=False), st.data())
def test_what_becomes_known_narrows_the_margin(formula: Formula, run: Run, data: st.DataObject) -> None:
    gaps = {
        name: [nan if data.draw(st.booleans()) else value for value in values] for name, values in run.items()
    }
    for known, unknown in zip(pairs(formula, run), pairs(formula, gaps), strict=True):
        assert unknown[0] <= known[0] <= known[1] <= unknown[1]


@many
@given(anything, runs(least=2, gaps=False), st.data())
def test_a_prefix_never_says_what_the_whole_run_denies(
    formula: Formula, run: Run, data: st.DataObject
) -> None:
    """A run that is cut short: the ticks that it did not reach are unknown."""
    reached = data.draw(st.integers(1, len(run["x"]) - 1))
    cut = {name: values[:reached] + [nan] * (len(values) - reached) for name, values in run.items()}
    whole, part = pairs(formula, run)[0], pairs(formula, cut)[0]
    assert part[0] <= whole[0]
    assert whole[1] <= part[1]


def test_a_value_at_its_limit_is_on_the_side_that_the_sign_says() -> None:
    run = {"x": [0.003], "y": [0.0], "p": [0.0], "q": [0.0]}
    for relation, side in ((">", -1), (">=", 1), ("<", -1), ("<=", 1)):
        assert pairs(Comparison(X, Relation(relation), mm(3)), run) == [(side * LEAST, side * LEAST)]


def test_nothing_known_is_nothing_said() -> None:
    run = {name: [nan] * 3 for name in "xypq"}
    for formula in (Always, Eventually, Not):
        assert pairs(formula(Comparison(X, Relation.ABOVE, mm(0))), run)[0] == (-inf, inf)


def test_long_windows_of_many_samples_are_those_of_numpy() -> None:
    rng = np.random.default_rng(5)
    x = rng.normal(size=500)
    run = {"x": x.tolist(), "y": x.tolist(), "p": [1.0] * 500, "q": [1.0] * 500}
    always = Always(Comparison(X, Relation.ABOVE, mm(0)), Span(ms(8 * 7), ms(8 * 60)))
    low = margins_of(always, run).bounds.low
    least = [x[k + 7 : k + 61].min() for k in range(440)]
    assert np.array_equal(low[:440], least)
    assert np.all(np.isneginf(low[440:]))
