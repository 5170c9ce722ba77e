"""An answer's time is simulated; one that never came was not in time, one that cost nothing shows nothing."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from examples import hand, scenario

from safety_harness.admission.admit import admit
from safety_harness.admission.trial import run_kinematic
from safety_harness.base.settings import DEFAULTS, DecisionTimes, Settings
from safety_harness.claims.properties.answered import DecisionTime
from safety_harness.scenario.faults import AvoiderFault, AvoiderLate, AvoiderNaN, AvoiderSilent
from safety_harness.scenario.model import Verdict
from safety_harness.scenario.moves import MoveTo, Wait
from safety_harness.trace.trace import Trace

WITHIN = DecisionTime(within_s=0.1)
STAYS = hand(MoveTo(position_in_base_m=(0.79, -0.27, 0.3), speed_mps=1.0), Wait(duration_s=9.0))


def costing(*quantiles_s: float) -> Settings:
    times = DecisionTimes(quantiles_s=quantiles_s)
    return replace(DEFAULTS, avoidance=replace(DEFAULTS.avoidance, decision_time=times))


@lru_cache
def ran(*faults: AvoiderFault, settings: Settings = DEFAULTS) -> Trace:
    what = scenario(STAYS, duration_s=3.0, settings=settings)
    return run_kinematic(admit(replace(what, faults=faults)))


def test_the_margin_is_what_the_slowest_answer_leaves() -> None:
    trace = ran(settings=costing(0.04))
    assert len(trace.decisions) > 1
    found = WITHIN.evaluate(trace)
    assert (found.verdict, found.margin) == (Verdict.HOLDS, pytest.approx(0.06))
    assert found.exercised == len(trace.decisions)
    late = DecisionTime(within_s=0.03).evaluate(trace)
    assert (late.verdict, late.margin) == (Verdict.VIOLATED, pytest.approx(-0.01))


def test_it_is_over_at_the_tick_at_which_the_answer_counts() -> None:
    found = WITHIN.evaluate(ran(settings=costing(0.09)))
    assert found.margin == pytest.approx(0.1 - 0.096)


def test_a_simulated_delay_adds_to_every_decision_and_not_to_the_next() -> None:
    trace = ran(AvoiderLate(delay_s=0.08), settings=costing(0.01))
    assert len(trace.decisions) > 1  # one after the other, the hand still there
    assert (trace.decisions["tick"] - trace.decisions["asked_tick"] == 12).all()
    found = WITHIN.evaluate(trace)
    assert (found.verdict, found.margin) == (Verdict.HOLDS, pytest.approx(0.1 - 0.096))


def test_an_answer_that_never_came_is_late_however_much_time_was_allowed() -> None:
    for within_s in (0.1, 5.0):
        found = DecisionTime(within_s=within_s).evaluate(ran(AvoiderSilent()))
        assert found.verdict is Verdict.VIOLATED
        assert found.margin is not None
        assert found.margin <= -DEFAULTS.clock.control_period_s + 1e-12


def test_a_decision_that_costs_nothing_shows_nothing() -> None:
    for trace in (ran(), ran(AvoiderNaN()), ran(settings=costing(0.0))):
        found = WITHIN.evaluate(trace)
        assert found.verdict is Verdict.INCONCLUSIVE
        assert found.reason.startswith("computing time not modelled")
        assert found.exercised == 0


def test_without_computing_time_a_delay_can_break_it_and_not_keep_it() -> None:
    trace = ran(AvoiderLate(delay_s=0.08))
    assert WITHIN.evaluate(trace).verdict is Verdict.INCONCLUSIVE
    assert DecisionTime(within_s=0.05).evaluate(trace).verdict is Verdict.VIOLATED


def test_one_decision_that_costs_nothing_among_others_is_enough_to_show_nothing() -> None:
    trace = ran(settings=costing(0.04))
    decisions = trace.decisions.copy()
    decisions["decision_time_s"][0] = 0.0
    decisions["asked_tick"][0] = decisions["tick"][0]
    found = WITHIN.evaluate(replace(trace, decisions=decisions))
    assert found.verdict is Verdict.INCONCLUSIVE


def test_the_wall_s_clock_is_not_judged() -> None:
    trace = ran(settings=costing(0.04))
    for latency_s in (0.0, 5.0, np.nan):
        slow = replace(trace, decision_latency_s=np.full(len(trace.decisions), latency_s))
        assert WITHIN.evaluate(slow) == WITHIN.evaluate(trace)


def test_without_a_decision_there_is_nothing_to_judge() -> None:
    found = WITHIN.evaluate(run_kinematic(admit(scenario(duration_s=0.1))))
    assert (found.verdict, found.exercised) == (Verdict.INCONCLUSIVE, 0)


def test_what_lasts_exactly_as_long_as_its_limit_holds_with_margin_0() -> None:
    trace = ran(settings=costing(0.072))
    assert (trace.decisions["tick"] - trace.decisions["asked_tick"] == 9).all()
    found = DecisionTime(within_s=0.072).evaluate(trace)  # 9 x 8 ms is more, in floats
    assert (found.verdict, found.margin) == (Verdict.HOLDS, 0.0)


def test_a_decision_that_breaks_it_is_exercised_once() -> None:
    for trace in (ran(settings=costing(0.072)), ran(AvoiderLate(delay_s=0.08))):
        found = DecisionTime(within_s=0.05).evaluate(trace)
        assert (found.verdict, found.exercised) == (Verdict.VIOLATED, len(trace.decisions))
