"""Agreement with rtamt wherever the samples decide, and every class of disagreement by its least example.

docs/explanation/formulas.md has the argument for each class.
"""

from __future__ import annotations

from math import inf, isnan, nan

import numpy as np
import pytest
from disagreement import noted
from hypothesis import given, settings
from random_formulas import P, Run, X, Y, comparisons, formulas, margins_of, runs
from rtamt_runs import in_rtamt, robustness

from safety_harness.base.exceptions import FormulaError
from safety_harness.claims.formulas.claim import FormulaClaim
from safety_harness.claims.formulas.formula import (
    Always,
    Comparison,
    Eventually,
    Formula,
    Globally,
    Not,
    Relation,
    Truth,
    conjunction,
)
from safety_harness.claims.formulas.language import hand_distance, mm, mm_per_s, ms, tcp_speed
from safety_harness.claims.formulas.quantities import Span
from safety_harness.claims.formulas.semantics import LEAST

ABOVE_0 = Comparison(X, Relation.ABOVE, mm(0))
ABOVE_3 = Comparison(X, Relation.ABOVE, mm(3))


def run_of(*x: float, y: float = 0.0) -> Run:
    n = len(x)
    return {"x": list(x), "y": [y] * n, "p": [1.0] * n, "q": [1.0] * n}


def ours(formula: Formula, run: Run) -> tuple[float, float]:
    bounds = margins_of(formula, run).bounds
    return float(bounds.low[0]), float(bounds.high[0])


def theirs(formula: Formula, run: Run) -> float:
    return robustness(in_rtamt(formula), run)[0]


@settings(max_examples=150, deadline=None)
@given(formulas(comparisons), runs(least=2, most=30, gaps=False))
def test_wherever_the_samples_decide_rtamt_says_the_same(formula: Formula, run: Run) -> None:
    bounds = margins_of(formula, run).bounds
    decided = np.isfinite(bounds.low) & (bounds.low == bounds.high)
    low = np.where(np.abs(bounds.low) == LEAST, 0.0, bounds.low)
    others = np.array(robustness(in_rtamt(formula), run))
    noted("rtamt", "margins of random formulas", "SI", low[decided], others[decided])
    assert np.array_equal(low[decided], others[decided])
    assert np.all((bounds.low <= others + LEAST) & (others - LEAST <= bounds.high))


def test_the_agreement_would_notice_a_difference() -> None:
    run = run_of(0.001, -0.001)
    assert ours(Always(ABOVE_0), run) == (-0.001, -0.001)
    assert theirs(Always(ABOVE_0), run) == -0.001
    assert theirs(Eventually(ABOVE_0), run) == 0.001


def test_nan_is_passed_over_by_rtamt_and_unknown_here() -> None:
    """Class 1: what is not known satisfies nothing."""
    run = run_of(0.001, nan, 0.001)
    assert theirs(Always(ABOVE_0), run) == 0.001
    assert ours(Always(ABOVE_0), run) == (-inf, 0.001)
    first = run_of(nan, 0.001)
    assert isnan(theirs(ABOVE_0, first))
    assert ours(ABOVE_0, first) == (-inf, inf)


def test_a_window_beyond_the_end_is_satisfied_for_rtamt_and_unknown_here() -> None:
    """Class 2: a trace that is too short promises nothing."""
    run = run_of(0.001, 0.001)
    always = Always(ABOVE_0, Span(ms(0), ms(40)))
    assert theirs(always, run) == 0.001
    assert ours(always, run) == (-inf, 0.001)
    later = Always(ABOVE_0, Span(ms(24), ms(40)))
    assert theirs(later, run) == inf
    assert ours(later, run) == (-inf, inf)
    eventually = Eventually(ABOVE_3, Span(ms(0), ms(40)))
    assert theirs(eventually, run) == -0.002
    assert ours(eventually, run) == (-0.002, inf)


def test_at_the_limit_itself_rtamt_tells_neither_strict_from_not_nor_a_formula_from_its_negation() -> None:
    """Class 3: x > 3 mm is not satisfied by 3 mm."""
    run = run_of(0.003, 0.003)
    assert theirs(ABOVE_3, run) == theirs(Not(ABOVE_3), run) == 0.0
    assert ours(ABOVE_3, run) == (-LEAST, -LEAST)
    assert ours(Not(ABOVE_3), run) == (LEAST, LEAST)
    at_least = Comparison(X, Relation.AT_LEAST, mm(3))
    assert ours(at_least, run) == (LEAST, LEAST)


def test_a_trigger_has_a_margin_for_rtamt_and_none_here() -> None:
    """Class 4: how far one is from being asked is not how far one is from failing."""
    run = run_of(0.003, 0.003, y=-0.001)
    whenever = Globally(ABOVE_0, Comparison(Y, Relation.ABOVE, mm(0)))
    assert theirs(whenever, run) == -0.001
    assert ours(whenever, run) == (-0.001, -0.001)
    barely = run_of(0.0005, 0.0005, y=-0.001)
    assert theirs(whenever, barely) == -0.0005
    assert ours(whenever, barely) == (-0.001, -0.001)
    untriggered = run_of(-0.002, -0.002, y=-0.001)
    assert theirs(whenever, untriggered) == 0.002
    assert ours(whenever, untriggered) == (inf, inf)


def test_a_truth_is_a_number_for_rtamt_and_without_end_here() -> None:
    """Class 5: 0.5 of a truth is no length; beside one, the least of both takes it for half a metre."""
    run = run_of(0.9, 0.9)
    both = conjunction(ABOVE_0, Truth(P))
    assert robustness("((x > 0) and (p > 0.5))", run)[0] == 0.5
    assert ours(both, run) == (0.9, 0.9)


def test_a_single_sample_is_a_trace_here() -> None:
    """Class 6: rtamt ends in an error of its own."""
    run = run_of(0.001)
    with pytest.raises(UnboundLocalError):
        theirs(Always(ABOVE_0), run)
    assert ours(Always(ABOVE_0), run) == (0.001, 0.001)


def test_margins_of_two_kinds_are_compared_by_rtamt_and_refused_here() -> None:
    """Class 7: a millimetre is neither more nor less than a millimetre a second."""
    run = run_of(0.002, 0.002, y=0.001)
    assert robustness("((x > 0) or (y > 0))", run)[0] == 0.002
    with pytest.raises(FormulaError, match="one kind of margin"):
        FormulaClaim((tcp_speed() > mm_per_s(0)) | (hand_distance() > mm(0)))
