"""A prediction is compared with the nearest true hand at the time that it is for."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from examples import VISIT, hand, run, scenario

from safety_harness.base.settings import DEFAULTS
from safety_harness.claims.properties.hand_prediction import HandPredictions
from safety_harness.claims.signals.predictions import prediction_errors_m
from safety_harness.scenario.faults import FalseHand
from safety_harness.scenario.model import Verdict
from safety_harness.scenario.moves import Wait
from safety_harness.trace.trace import Trace

WITHIN = HandPredictions(maximum_m=0.05)
HORIZON_S = DEFAULTS.hand_filter.prediction_horizon_s
LEFT = hand(Wait(duration_s=9.0), at=(0.6, 0.6, 0.1), name="left")


@lru_cache
def two_hands() -> Trace:
    return run(scenario(VISIT, LEFT, duration_s=1.2))


def test_errors_are_those_of_a_look_at_each_prediction_by_itself() -> None:
    trace = two_hands()
    errors = prediction_errors_m(trace)
    assert len(errors) == np.count_nonzero(trace.time_s + HORIZON_S <= trace.time_s[-1] + 1e-12)
    for k in range(0, len(errors), 7):
        tick = trace.ticks[k]
        for slot in np.flatnonzero(tick["track_valid"]):
            best = np.inf
            for number in range(2):
                path = trace.ticks["hand_position_in_base_m"][:, number]
                there = [np.interp(tick["time_s"] + HORIZON_S, trace.time_s, path[:, i]) for i in range(3)]
                best = min(best, float(np.linalg.norm(tick["predicted_hand_in_base_m"][slot] - there)))
            assert errors[k, slot] == pytest.approx(best, abs=1e-12)
        assert np.isnan(errors[k][~tick["track_valid"]]).all()


def test_a_hand_that_rests_is_predicted_where_it_is() -> None:
    evaluation = WITHIN.evaluate(run(scenario(LEFT, duration_s=0.6)))
    assert evaluation.verdict is Verdict.HOLDS
    assert evaluation.margin == pytest.approx(0.05, abs=2e-3)
    assert evaluation.exercised == 63  # ticks 0 to 62: at most 0.5 s, so that 0.1 s more are in the run


def test_a_hand_that_starts_is_predicted_to_rest_so_that_the_error_is_its_whole_way() -> None:
    starts = replace(VISIT, moves=(Wait(duration_s=0.4), *VISIT.moves))
    trace = run(scenario(starts, duration_s=1.0))
    path = trace.ticks["hand_position_in_base_m"][:, 0]
    k = 50  # 0.4 s
    at = trace.time_s[k] + HORIZON_S
    there = np.array([np.interp(at, trace.time_s, path[:, i]) for i in range(3)])
    error = np.nanmin(prediction_errors_m(trace)[k])
    assert error == pytest.approx(np.linalg.norm(there - path[k]), abs=2e-3)
    worst = WITHIN.evaluate(trace)
    assert worst.margin is not None
    assert worst.worst_time_s is not None
    assert worst.worst_time_s == pytest.approx(0.43, abs=0.04)  # while it speeds up: 1 m/s, 10 m/s2


def test_a_hand_that_is_not_there_is_as_wrong_as_the_true_one_is_far() -> None:
    ghost = FalseHand(position_in_base_m=(0.4, 0.5, 0.2))
    trace = run(replace(scenario(LEFT, duration_s=0.6), faults=(ghost,)))
    evaluation = WITHIN.evaluate(trace)
    apart = np.linalg.norm(np.subtract(ghost.position_in_base_m, LEFT.starts_at_in_base_m))
    assert evaluation.verdict is Verdict.VIOLATED
    assert evaluation.margin == pytest.approx(0.05 - apart, abs=1e-3)


def test_a_run_shorter_than_the_horizon_has_nothing_to_compare() -> None:
    evaluation = WITHIN.evaluate(run(scenario(LEFT, duration_s=0.08)))
    assert (evaluation.verdict, evaluation.exercised) == (Verdict.INCONCLUSIVE, 0)


def test_without_a_hand_there_is_nothing_to_predict() -> None:
    assert WITHIN.evaluate(run(scenario(duration_s=0.3))).verdict is Verdict.INCONCLUSIVE


def test_a_prediction_that_is_no_number_is_no_evidence_but_an_empty_slot_is_no_prediction() -> None:
    trace = two_hands()
    assert WITHIN.evaluate(trace).verdict is not Verdict.INCONCLUSIVE
    ticks = trace.ticks.copy()
    ticks["predicted_hand_in_base_m"][30, int(np.argmax(ticks["track_valid"][30]))] = np.nan
    evaluation = WITHIN.evaluate(replace(trace, ticks=ticks))
    assert evaluation.verdict is Verdict.INCONCLUSIVE
    assert "0.240 s" in evaluation.reason
