"""The moment that is shown is one that the margin comes from."""

from __future__ import annotations

from math import inf, nan

from hypothesis import given, settings
from random_formulas import PERIOD_S, P, Run, X, bounds_of, comparisons, formulas, margins_of, runs, truths

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
from safety_harness.claims.formulas.language import mm, ms
from safety_harness.claims.formulas.quantities import Span
from safety_harness.claims.formulas.semantics import Witness, witness

ABOVE_0 = Comparison(X, Relation.ABOVE, mm(0))


@settings(max_examples=300, deadline=None)
@given(formulas(comparisons | truths), runs())
def test_what_is_said_at_the_witness_is_the_margin(formula: Formula, run: Run) -> None:
    margins = margins_of(formula, run)
    for low in (True, False):
        margin = float((margins.bounds.low if low else margins.bounds.high)[0])
        found = witness(margins, 0, PERIOD_S, low=low)
        if found.atom is None:
            assert abs(margin) == inf
            assert found.tick == len(run["x"])
            continue
        said = bounds_of(found.atom, run)
        assert abs(margin) in (abs(said.low[found.tick]), abs(said.high[found.tick]))


@settings(max_examples=200, deadline=None)
@given(formulas(comparisons | truths), formulas(comparisons | truths), runs())
def test_the_witness_of_whenever_is_in_its_response(trigger: Formula, reply: Formula, run: Run) -> None:
    margins = margins_of(Globally(trigger, reply), run)
    found = witness(margins, 0, PERIOD_S, low=True)
    margin = float(margins.bounds.low[0])
    if found.atom is not None and abs(margin) < inf:
        assert abs(bounds_of(found.atom, run).low[found.tick]) == abs(margin)


def of(formula: Formula, *x: float, low: bool = True) -> Witness:
    run = {"x": list(x), "y": [0.0] * len(x), "p": [1.0, 0.0, 1.0, 0.0][: len(x)], "q": [0.0] * len(x)}
    return witness(margins_of(formula, run), 0, PERIOD_S, low=low)


def test_each_operator_names_the_tick_that_decides() -> None:
    x = (0.003, -0.001, 0.002, 0.001)
    assert of(Always(ABOVE_0), *x) == Witness(1, ABOVE_0)
    assert of(Eventually(ABOVE_0), *x) == Witness(0, ABOVE_0)
    assert of(Not(Always(ABOVE_0)), *x) == Witness(1, ABOVE_0)
    assert of(Not(Eventually(ABOVE_0)), *x) == Witness(0, ABOVE_0)
    assert of(Eventually(ABOVE_0, Span(ms(8), ms(16))), *x) == Witness(2, ABOVE_0)
    assert of(Until(ABOVE_0, Not(Truth(P))), *x) == Witness(0, ABOVE_0)
    assert of(Globally(Truth(P), ABOVE_0), *x) == Witness(2, ABOVE_0)
    assert of(Always(ABOVE_0, Span(ms(0), ms(40))), *x) == Witness(4, None)


def test_what_is_not_known_decides_only_the_bound_that_it_bounds() -> None:
    x = (nan, -0.001, 0.002)
    assert of(Always(ABOVE_0), *x) == Witness(0, ABOVE_0)
    assert of(Always(ABOVE_0), *x, low=False) == Witness(1, ABOVE_0)
    assert of(Not(Always(ABOVE_0)), *x) == Witness(1, ABOVE_0)
