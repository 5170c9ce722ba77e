"""Calibration is judged over many independent runs, by an exact interval, and never by a few."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from examples import VISIT, scenario
from numpy.typing import NDArray
from test_columns_read import of_garbage

from safety_harness.admission.admit import admit
from safety_harness.admission.trial import run_kinematic
from safety_harness.base.settings import DEFAULTS, DecisionTimes
from safety_harness.cell.avoidance.candidates import CandidateCap
from safety_harness.cell.avoidance.learned import LearnedAvoider
from safety_harness.cell.avoidance.model_file import load_model
from safety_harness.cell.avoidance.shipped import shipped_model
from safety_harness.claims.properties.spread_calibration import (
    LEAST_DECISIONS,
    READ,
    IntervalRule,
    SpreadCalibration,
    Target,
    first_covered,
    target_in_base_m,
)
from safety_harness.scenario.model import Verdict
from safety_harness.trace.known import COLUMNS_OF_A_TRACE, NOT_MEASURED
from safety_harness.trace.trace import Trace
from safety_harness.trace.unmeasured import knowing

Floats = NDArray[np.float64]
LOW, HIGH = (
    np.array([[0.54, -0.65, -0.295], [0.64, -0.15, 0.25]]),
    np.array([[1.14, -0.05, 0.305], [0.76, 0.15, 0.45]]),
)
DESIRED = np.array(DEFAULTS.cell.desired_tcp_position_in_base_m)


def asked(visit: Trace, avoider: str, count: int, off_m: float = 0.0) -> list[Trace]:
    """Runs whose first decision is the network's on a hand and a TCP drawn from the seen space."""
    rng = np.random.default_rng(5)
    hands, tcps = (rng.uniform(LOW[k], HIGH[k], (count, 3)) for k in range(2))
    seeds = rng.integers(0, 2**62, count, dtype=np.uint64)
    positions, spreads = LearnedAvoider.from_model(load_model(shipped_model(avoider))).propose_many(
        hands, tcps, seeds
    )
    scene = replace(visit.scenario, avoider=avoider)
    traces = []
    for k in range(count):
        decisions = visit.decisions.copy()
        decisions["hand_position_in_base_m"][0] = hands[k]
        decisions["tcp_position_in_base_m"][0] = tcps[k]
        decisions["seed"][0] = seeds[k]
        decisions["proposed_position_in_base_m"][0] = positions[k] + off_m
        decisions["proposed_spread_m"][0] = spreads[k]
        traces.append(replace(visit, scenario=scene, decisions=decisions))
    return traces


@pytest.fixture(scope="module")
def exact(visit: Trace) -> list[Trace]:
    return asked(visit, "optimum", 400)


@lru_cache
def intervals(avoider: str) -> IntervalRule:
    found = IntervalRule.from_model(load_model(shipped_model(avoider)))
    assert found is not None
    return found


@pytest.mark.parametrize("avoider", ["mc-dropout", "optimum"])
def test_a_shipped_network_is_calibrated_where_it_was_trained(avoider: str, visit: Trace) -> None:
    evaluation = SpreadCalibration().evaluate(asked(visit, avoider, 400))
    assert evaluation.verdict is Verdict.HOLDS, evaluation
    assert evaluation.margin is not None
    assert 0.0 <= evaluation.margin <= 0.08
    assert evaluation.exercised == 400


def test_each_network_is_measured_by_what_it_was_calibrated_for() -> None:
    assert intervals("mc-dropout").target is Target.LABEL
    assert intervals("optimum").target is Target.OPTIMUM


def test_an_overconfident_or_displaced_network_is_violated(exact: Sequence[Trace], visit: Trace) -> None:
    own = intervals("optimum")
    sure = SpreadCalibration(intervals=replace(own, multiplier=own.multiplier / 2.0)).evaluate(exact)
    assert sure.verdict is Verdict.VIOLATED
    assert sure.margin is not None
    assert sure.margin < -0.05
    displaced = SpreadCalibration().evaluate(asked(visit, "optimum", 120, off_m=0.004))
    assert displaced.verdict is Verdict.VIOLATED


def test_a_few_runs_say_nothing_however_they_come_out(exact: Sequence[Trace]) -> None:
    evaluation = SpreadCalibration().evaluate(exact[: LEAST_DECISIONS - 1])
    assert (evaluation.verdict, evaluation.margin) == (Verdict.INCONCLUSIVE, None)
    assert SpreadCalibration().evaluate([]).verdict is Verdict.INCONCLUSIVE


def test_a_share_near_the_limit_is_left_open(exact: Sequence[Trace]) -> None:
    covered = [first_covered(trace, intervals("optimum")) for trace in exact]
    share = sum(map(bool, covered)) / len(covered)
    evaluation = SpreadCalibration(at_least=round(share, 3)).evaluate(exact)
    assert evaluation.verdict is Verdict.INCONCLUSIVE
    assert evaluation.reason.startswith("too few to tell")


def test_only_the_first_answered_decision_of_a_run_counts(exact: Sequence[Trace]) -> None:
    own, trace = intervals("optimum"), exact[0]
    assert first_covered(trace, own) is not None
    decisions = trace.decisions.copy()
    decisions["fault"] = "no answer within 100 ms"
    assert first_covered(replace(trace, decisions=decisions), own) is None


def test_an_answer_that_is_no_number_is_not_covered(exact: Sequence[Trace]) -> None:
    decisions = exact[0].decisions.copy()
    decisions["proposed_spread_m"] = np.nan
    assert first_covered(replace(exact[0], decisions=decisions), intervals("optimum")) is False


def test_several_avoiders_or_one_without_intervals_are_no_evidence(
    exact: Sequence[Trace], visit: Trace
) -> None:
    mixed = SpreadCalibration().evaluate([*exact, visit])
    assert mixed.verdict is Verdict.INCONCLUSIVE
    assert "several avoiders" in mixed.reason
    assert "no intervals" in SpreadCalibration().evaluate([visit] * 200).reason


def test_the_exact_target_is_the_best_of_very_many_candidates_and_the_pull(exact: Sequence[Trace]) -> None:
    cap = replace(CandidateCap.from_settings(DEFAULTS), count=200_000)
    offsets = cap.draw(np.random.default_rng(1))
    for trace in exact[:5]:
        decision = trace.decisions[0]
        tcp, hand = decision["tcp_position_in_base_m"], decision["hand_position_in_base_m"]
        best = tcp + offsets[np.argmin(np.linalg.norm(tcp + offsets - DESIRED, axis=1))]
        found = target_in_base_m(decision, DEFAULTS, Target.OPTIMUM) - 0.05 * (tcp - hand)
        assert found == pytest.approx(best, abs=5e-3)
        nearer_m = np.linalg.norm(best - DESIRED) - np.linalg.norm(found - DESIRED)
        assert 0.0 <= nearer_m < 1e-4


def test_a_label_is_one_of_a_hundred_candidates_and_never_nearer_than_the_exact_one(
    exact: Sequence[Trace],
) -> None:
    for trace in exact[:50]:
        decision = trace.decisions[0]
        pull = 0.05 * (decision["tcp_position_in_base_m"] - decision["hand_position_in_base_m"])
        label, best = (target_in_base_m(decision, DEFAULTS, t) - pull for t in (Target.LABEL, Target.OPTIMUM))
        assert np.linalg.norm(label - decision["tcp_position_in_base_m"]) == pytest.approx(0.1)
        assert np.linalg.norm(label - DESIRED) >= np.linalg.norm(best - DESIRED) - 1e-12
        again = target_in_base_m(decision, DEFAULTS, Target.LABEL) - pull
        assert np.array_equal(label, again)


def test_a_column_that_one_run_lacks_is_named(visit: Trace) -> None:
    runs = asked(visit, "mc-dropout", LEAST_DECISIONS)
    for column in READ:
        found = SpreadCalibration().evaluate([*runs[1:], knowing(runs[0], {column: NOT_MEASURED})])
        assert (found.verdict, found.unmeasured) == (Verdict.INCONCLUSIVE, (column,))


def test_columns_that_are_not_read_may_hold_anything(visit: Trace) -> None:
    runs = asked(visit, "mc-dropout", LEAST_DECISIONS)
    others = [column for column in COLUMNS_OF_A_TRACE if column not in READ]
    unknown = [of_garbage(run, others, seed=1) for run in runs]
    assert SpreadCalibration().evaluate(unknown) == SpreadCalibration().evaluate(runs)


def test_an_answer_is_judged_by_the_question_that_was_asked() -> None:
    """However far hand and TCP have gone on until it counts."""
    rule = IntervalRule(multiplier=1.0, residual_std_m=(0.002,) * 3, target=Target.OPTIMUM)
    slow = replace(
        DEFAULTS.avoidance, decision_time=DecisionTimes(quantiles_s=(0.2,)), decision_deadline_s=1.0
    )
    for settings in (DEFAULTS, replace(DEFAULTS, avoidance=slow)):
        trace = run_kinematic(admit(scenario(VISIT, settings=settings, avoider="optimum")))
        assert first_covered(trace, rule) is True
