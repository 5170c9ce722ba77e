"""Whatever is no number is found wherever it stands, and what is not there is no fault."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from examples import VISIT, ConstantSpeed, Nonsense, run, scenario

from safety_harness.claims.properties.finite import FiniteTrace
from safety_harness.scenario.faults import AvoiderNaN
from safety_harness.scenario.model import Verdict
from safety_harness.trace.records import DECISION, TICK, DecisionOutcome
from safety_harness.trace.trace import Trace

FINITE = FiniteTrace()


def numbers(layout: np.dtype[np.void]) -> list[str]:
    return [name for name in layout.names or () if layout[name].base.kind == "f"]


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("name", [name for name in numbers(TICK) if name != "time_s"])
def test_one_number_of_one_tick_is_found(name: str, value: float, visit: Trace) -> None:
    ticks = visit.ticks.copy()
    assert ticks["track_valid"][100, 0]
    assert ticks["object_visible"][100]
    ticks[name][(100, *[0] * (ticks[name].ndim - 1))] = value
    evaluation = FINITE.evaluate(replace(visit, ticks=ticks))
    assert (evaluation.verdict, evaluation.margin) == (Verdict.VIOLATED, -1.0)
    assert evaluation.worst_time_s == pytest.approx(0.8)


@pytest.mark.parametrize("name", [n for n in numbers(DECISION) if n not in ("time_s", "spread_threshold_m")])
def test_one_number_of_one_decision_is_found(name: str, visit: Trace) -> None:
    decisions = visit.decisions.copy()
    decisions["outcome"][0] = DecisionOutcome.OPPOSITE
    decisions[name][(0, *[1] * (decisions[name].ndim - 1))] = np.nan
    evaluation = FINITE.evaluate(replace(visit, decisions=decisions))
    assert (evaluation.verdict, evaluation.margin) == (Verdict.VIOLATED, -1.0)
    assert evaluation.worst_time_s == pytest.approx(visit.decisions["time_s"][0])


def test_what_is_not_there_need_not_be_a_number(visit: Trace) -> None:
    """A second hand that is not there, slots that track nothing, a start without any image."""
    assert np.isinf(visit.ticks["hand_distance_m"][:, 1]).all()
    assert np.isnan(visit.ticks["predicted_hand_in_base_m"][:, 1]).all()
    blind = run(scenario(duration_s=0.1), controller=ConstantSpeed((0.1,) * 6))
    assert np.isnan(blind.ticks["sse"]).all()
    answers_nan = run(replace(scenario(VISIT, duration_s=1.0), faults=(AvoiderNaN(),)))
    assert np.isnan(answers_nan.decisions["proposed_position_in_base_m"]).all()
    for trace in (visit, blind, answers_nan):
        evaluation = FINITE.evaluate(trace)
        assert (evaluation.verdict, evaluation.margin) == (Verdict.HOLDS, 0.0)
        assert evaluation.exercised == len(trace.ticks)


@pytest.mark.parametrize("time_s", [0.392, 0.4 - 1.0, np.nan])
def test_time_that_stands_or_goes_back_is_found(time_s: float, visit: Trace) -> None:
    ticks = visit.ticks.copy()
    ticks["time_s"][50] = time_s  # as tick 49, before it, or never
    evaluation = FINITE.evaluate(replace(visit, ticks=ticks))
    assert evaluation.verdict is Verdict.VIOLATED
    assert evaluation.worst_time_s == pytest.approx(0.4)


def test_time_that_goes_forward_by_another_step_contradicts_the_scenario(visit: Trace) -> None:
    ticks = visit.ticks.copy()
    ticks["time_s"] *= 1.001
    assert FINITE.evaluate(replace(visit, ticks=ticks)).verdict is Verdict.INCONCLUSIVE


def test_a_controller_of_nonsense_is_found_at_its_first_tick() -> None:
    evaluation = FINITE.evaluate(run(scenario(duration_s=0.1), controller=Nonsense((0.1,) * 6)))
    assert (evaluation.verdict, evaluation.worst_time_s) == (Verdict.VIOLATED, pytest.approx(0.048))
