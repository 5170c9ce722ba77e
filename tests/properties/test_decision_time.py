"""An answer's time is the wall's and the arm's together, and one that never came was not in time."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from examples import hand, run, scenario

from safety_harness.properties.decision_time import DecisionTime, waited_s
from safety_harness.scenario.faults import AvoiderFault, AvoiderLate, AvoiderNaN, AvoiderSilent
from safety_harness.scenario.model import Verdict
from safety_harness.scenario.moves import MoveTo, Wait
from safety_harness.trace.trace import Trace

WITHIN = DecisionTime(within_s=0.1)
STAYS = hand(MoveTo(position_in_base_m=(0.79, -0.27, 0.3), speed_mps=1.0), Wait(duration_s=9.0))


@lru_cache
def with_fault(fault: AvoiderFault) -> Trace:
    return run(replace(scenario(STAYS, duration_s=3.0), faults=(fault,)))


def on_the_wall(trace: Trace, *latencies_s: float) -> Trace:
    """The same run on a machine on which the decisions took these times."""
    every = np.resize(np.array(latencies_s), len(trace.decisions))
    return replace(trace, decision_latency_s=every)


def test_the_margin_is_what_the_slowest_answer_leaves() -> None:
    visit = with_fault(AvoiderNaN())
    assert len(visit.decisions) > 2
    quick = WITHIN.evaluate(on_the_wall(visit, 0.001, 0.03, 0.002))
    assert (quick.verdict, quick.margin) == (Verdict.HOLDS, pytest.approx(0.07))
    slow = WITHIN.evaluate(on_the_wall(visit, 0.02, 0.13))
    assert (slow.verdict, slow.margin) == (Verdict.VIOLATED, pytest.approx(-0.03))
    assert slow.exercised == len(visit.decisions)


def test_a_simulated_delay_adds_to_every_decision_and_not_to_the_next() -> None:
    trace = with_fault(AvoiderLate(delay_s=0.08))
    assert len(trace.decisions) > 2  # one after the other, the hand still there
    assert waited_s(trace) == pytest.approx(np.full(len(trace.decisions), 0.08))
    evaluation = WITHIN.evaluate(on_the_wall(trace, 0.005))
    assert (evaluation.verdict, evaluation.margin) == (Verdict.HOLDS, pytest.approx(0.015))
    assert DecisionTime(within_s=0.08).evaluate(on_the_wall(trace, 0.005)).verdict is Verdict.VIOLATED


def test_an_answer_that_never_came_is_late_however_much_time_was_allowed() -> None:
    trace = with_fault(AvoiderSilent())
    for within_s in (0.1, 5.0):
        evaluation = DecisionTime(within_s=within_s).evaluate(on_the_wall(trace, 0.0))
        assert evaluation.verdict is Verdict.VIOLATED
        assert evaluation.margin is not None
        assert evaluation.margin <= -trace.scenario.settings.clock.control_period_s + 1e-12


def test_an_answer_that_is_no_number_is_in_time() -> None:
    assert np.all(waited_s(with_fault(AvoiderNaN())) == 0.0)


def test_times_that_were_not_taken_down_are_no_evidence(visit: Trace) -> None:
    for latency_s in (np.nan, np.inf, -1.0):
        assert WITHIN.evaluate(on_the_wall(visit, latency_s)).verdict is Verdict.INCONCLUSIVE
    missing = replace(visit, decision_latency_s=np.zeros(0))
    assert WITHIN.evaluate(missing).verdict is Verdict.INCONCLUSIVE


def test_without_a_decision_there_is_nothing_to_judge() -> None:
    evaluation = WITHIN.evaluate(run(scenario(duration_s=0.1)))
    assert (evaluation.verdict, evaluation.exercised) == (Verdict.INCONCLUSIVE, 0)
