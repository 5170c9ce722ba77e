"""The signal "prediction error" is that of ``hand predictions within``: each at the time that it is for."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from safety_harness.admission.admit import admit
from safety_harness.admission.claims import property_of
from safety_harness.admission.trial import run_kinematic
from safety_harness.claims.formulas.claim import FormulaClaim
from safety_harness.claims.formulas.language import always, hand_tracked, mm, prediction_error, s, whenever
from safety_harness.claims.properties.hand_prediction import HandPredictions
from safety_harness.scenario.model import Claim, Verdict
from safety_harness.scenario.read import read_scenario
from safety_harness.trace.trace import Trace

SCENARIOS = Path(__file__).parents[3] / "scenarios"
SPEED_MPS, HORIZON_S = 1.0, 0.1
WITHIN_10_MM = prediction_error() < mm(10)


def walking(visit: Trace, *, extrapolated_s: float) -> Trace:
    """A hand at constant velocity and one track, that says where it will be so much later."""
    ticks = visit.ticks.copy()
    way_m = SPEED_MPS * visit.time_s[:, None] * np.array([[0.6, 0.0, 0.8]])
    ticks["hand_position_in_base_m"][:, 0] = way_m
    ticks["track_valid"] = np.array([True, False, False, False])
    ticks["predicted_hand_in_base_m"] = np.nan
    ticks["predicted_hand_in_base_m"][:, 0] = way_m + SPEED_MPS * extrapolated_s * np.array([0.6, 0.0, 0.8])
    return replace(visit, ticks=ticks)


def test_a_perfect_predictor_has_no_error_and_one_that_never_extrapolates_the_whole_way(visit: Trace) -> None:
    last = len(visit.ticks) - 1
    for extrapolated_s, error_m in ((HORIZON_S, 0.0), (0.0, SPEED_MPS * HORIZON_S)):
        value = prediction_error.sample(walking(visit, extrapolated_s=extrapolated_s)).value
        known = visit.time_s + HORIZON_S <= visit.time_s[last] + 1e-12
        assert value[known] == pytest.approx(np.full(known.sum(), error_m), abs=1e-12)
        assert np.isnan(value[~known]).all()
        assert (~known).sum() == 13  # 12.5 ticks of 8 ms


def test_the_claim_is_violated_by_who_never_extrapolates_and_holds_for_who_is_right(visit: Trace) -> None:
    right, lagging = walking(visit, extrapolated_s=HORIZON_S), walking(visit, extrapolated_s=0.0)
    known = always(WITHIN_10_MM, window=s(3.5))
    for formula in (known, always(WITHIN_10_MM), whenever(hand_tracked()).then(WITHIN_10_MM)):
        assert FormulaClaim(formula).evaluate(lagging).verdict is Verdict.VIOLATED
    assert FormulaClaim(known).evaluate(right).verdict is Verdict.HOLDS


def test_what_is_predicted_for_after_the_run_is_not_known_and_does_not_hold(visit: Trace) -> None:
    right = walking(visit, extrapolated_s=HORIZON_S)
    for formula in (always(WITHIN_10_MM), whenever(hand_tracked()).then(WITHIN_10_MM)):
        evaluation = FormulaClaim(formula).evaluate(right)
        assert evaluation.verdict is Verdict.INCONCLUSIVE
        first_s = visit.time_s[len(visit.ticks) - 13]
        assert evaluation.reason == f"prediction error is not known at {first_s:.3f} s"


def test_a_run_shorter_than_the_horizon_knows_no_error(visit: Trace) -> None:
    short = replace(walking(visit, extrapolated_s=HORIZON_S), ticks=visit.ticks[:12], ended="interrupted")
    assert np.isnan(prediction_error.sample(short).value).all()


@pytest.mark.parametrize("name", ["hand-visits-and-leaves", "between-two-hands", "hand-returns"])
def test_it_agrees_with_the_catalogue_on_a_shipped_run(name: str) -> None:
    trace = run_kinematic(admit(read_scenario(SCENARIOS / f"{name}.yaml")))
    value = prediction_error.sample(trace).value
    claim = HandPredictions(maximum_m=0.05).evaluate(trace)
    assert claim.margin is not None
    assert 0.05 - np.nanmax(value) == pytest.approx(claim.margin, abs=1e-15)
    assert trace.time_s[np.nanargmax(value)] == claim.worst_time_s
    tracked = trace.ticks["track_valid"].any(axis=1)
    tracked[trace.time_s + HORIZON_S > trace.time_s[-1] + 1e-12] = False
    assert np.array_equal(~np.isnan(value), tracked)
    limit_mm = 1e3 * np.nanmax(value)
    for factor, verdict in ((0.999, Verdict.VIOLATED), (1.001, Verdict.HOLDS)):
        text = f"{limit_mm * factor:.6f} mm"
        until_s = trace.time_s[np.flatnonzero(tracked)[-1]]
        sentences = (
            f"hand predictions within {text}",
            f"always for {until_s:.3f} s (not hand tracked or prediction error < {text})",
        )
        for sentence in sentences:
            own = property_of(Claim(sentence=sentence, expected=verdict), trace.scenario)
            assert own.evaluate(trace).verdict is verdict, sentence
