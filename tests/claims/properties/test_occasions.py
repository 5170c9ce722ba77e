"""What puts a claim to the test: an occasion of the claim's own, within what its sentence asks of."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from examples import VISIT, hand, scenario

from safety_harness.admission.admit import admit
from safety_harness.admission.claims import property_of
from safety_harness.admission.trial import run_trial
from safety_harness.base.exceptions import FormulaError, InadmissibleError
from safety_harness.base.settings import DEFAULTS
from safety_harness.cell.simulation.worlds import KINEMATIC
from safety_harness.claims.formulas.claim import FormulaClaim
from safety_harness.claims.formulas.language import (
    always,
    eventually,
    hand_distance,
    initially,
    mm,
    ms,
    stopped,
)
from safety_harness.claims.formulas.parse import parse_formula
from safety_harness.claims.properties.base import Evaluation
from safety_harness.scenario.faults import HandSensorBlind
from safety_harness.scenario.model import Claim, Scenario, Verdict
from safety_harness.scenario.moves import MoveTo
from safety_harness.trace.trace import Trace

FAR = hand(MoveTo(position_in_base_m=(1.1, -0.9, 0.2), speed_mps=0.4))  # never within 400 mm of the arm


def made(what: Scenario) -> Trace:
    return run_trial(admit(what), world=KINEMATIC)


@pytest.fixture(scope="module")
def seen() -> Trace:
    """A hand that visits, from 0.3 s on within 400 mm."""
    return made(scenario(VISIT))


def said(sentence: str, trace: Trace) -> Evaluation:
    return property_of(Claim(sentence=sentence, expected=Verdict.HOLDS), trace.scenario).evaluate(trace)


@pytest.mark.parametrize(
    "sentence",
    [
        "hand distance > 100 mm or (within 200 ms stopped)",
        "not (hand distance < 100 mm and (eventually repulsing))",
        "repulsing or (hand distance > 100 mm until stopped)",
    ],
)
def test_a_temporal_word_beside_a_comparison_of_no_time_is_refused_with_both_spellings(sentence: str) -> None:
    with pytest.raises(FormulaError) as refused:
        parse_formula(sentence)
    for begins in ("always", "initially"):
        whole = f"{begins} {sentence}" if sentence.startswith("not") else f"{begins} ({sentence})"
        assert f"{begins} (" in str(refused.value)
        parse_formula(whole)


def test_the_same_is_refused_in_python() -> None:
    mixed = (hand_distance() > mm(100)) | eventually(stopped(), window=ms(200))
    with pytest.raises(FormulaError, match="initially"):
        FormulaClaim(mixed)
    FormulaClaim(always(mixed)), FormulaClaim(initially(mixed))


@pytest.mark.parametrize(
    "sentence",
    [
        "always for 100 ms hand distance > 50 mm",
        "initially hand distance > 50 mm",
        "whenever elapsed time < 100 ms then hand distance > 50 mm",
        "always from 0 ms to 104 ms nearest hand to TCP > 50 mm",
    ],
)
def test_a_hand_that_comes_near_after_the_formula_s_window_is_no_occasion(sentence: str, seen: Trace) -> None:
    evaluation = said(sentence, seen)
    assert (evaluation.verdict, evaluation.exercised) == (Verdict.INCONCLUSIVE, 0)
    assert "at any tick that the formula asks of" in evaluation.reason
    assert "within 400 mm exercises it" in evaluation.reason


def test_a_hand_that_comes_near_within_the_window_is_an_occasion(seen: Trace) -> None:
    for sentence in ("always for 2 s hand distance > 50 mm", "always from 1 s to 2 s hand distance > 50 mm"):
        assert said(sentence, seen).exercised == 1


@pytest.mark.parametrize("critical_m", [0.1, 0.4, 1.9])
@pytest.mark.parametrize(
    "sentence",
    [
        "hand distance never below 50 mm",
        "no moving part touches a hand",
        "always hand distance > 50 mm",
        "nearest hand to TCP > 50 mm",
        "starts retreating within 100 ms of a true hand",
        "starts retreating within 100 ms of a predicted hand",
    ],
)
def test_the_tested_system_s_critical_distance_makes_no_occasion(sentence: str, critical_m: float) -> None:
    """A hand that stays far off exercises nothing, however early the system gives way to it."""
    avoidance = replace(DEFAULTS.avoidance, critical_distance_m=critical_m)
    trace = made(scenario(FAR, duration_s=1.0, settings=replace(DEFAULTS, avoidance=avoidance)))
    evaluation = said(sentence, trace)
    assert (evaluation.verdict, evaluation.exercised) == (Verdict.INCONCLUSIVE, 0)


def test_a_limit_above_200_mm_is_put_to_the_test_within_twice_its_distance(seen: Trace) -> None:
    nearest_m = float(seen.ticks["hand_distance_m"][:, 0].min())
    assert 0.2 < nearest_m < 0.4
    for sentence in ("hand distance never below {} mm", "always hand distance > {} mm"):
        trace = made(scenario(FAR, duration_s=1.0))
        far_mm = float(trace.ticks["hand_distance_m"][:, 0].min()) * 1e3
        assert said(sentence.format(round(0.4 * far_mm)), trace).exercised == 0
        assert said(sentence.format(round(0.6 * far_mm)), trace).exercised == 1


def test_an_encounter_that_nobody_answered_is_no_evidence_of_an_answer(seen: Trace) -> None:
    blind = made(replace(seen.scenario, faults=(HandSensorBlind(),)))
    near = np.flatnonzero(
        np.linalg.norm(
            blind.ticks["hand_position_in_base_m"][:, 0] - blind.ticks["transform_tcp_to_base"][:, :3, 3],
            axis=1,
        )
        < 0.4
    )
    assert 0 < len(near) * 0.008 < 2.0
    evaluation = said("starts retreating within 2 s of a true hand", blind)
    assert (evaluation.verdict, evaluation.exercised) == (Verdict.INCONCLUSIVE, 0)
    assert "never gave way" in evaluation.reason
    assert said("starts retreating within 100 ms of a true hand", blind).verdict is Verdict.VIOLATED


def test_one_answer_does_not_stand_for_an_encounter_that_nobody_answered() -> None:
    twice = hand(*VISIT.moves, *VISIT.moves)
    blind_later = replace(scenario(twice, duration_s=5.0), faults=(HandSensorBlind(from_s=1.5),))
    evaluation = said("starts retreating within 2 s of a true hand", made(blind_later))
    assert (evaluation.verdict, evaluation.exercised) == (Verdict.INCONCLUSIVE, 1)


def test_a_time_to_give_way_that_ends_after_the_run_is_refused(seen: Trace) -> None:
    for whose in ("true", "predicted"):
        with pytest.raises(InadmissibleError, match=r"duration, 2\.5 s"):
            said(f"gives way within 50 s of a {whose} hand", seen)


def test_a_run_shorter_than_the_time_to_recover_the_object_says_nothing_of_it(seen: Trace) -> None:
    assert said("object in view or recovered within 50 s", seen).verdict is Verdict.INCONCLUSIVE
    assert said("object in view or recovered within 2 s", seen).verdict is Verdict.HOLDS


@pytest.mark.parametrize(
    ("sentence", "meant"),
    [
        ("joint speed < 180 rad/s", "joint speed < 180 deg/s"),
        ("hand distance > -5 m", "hand distance > -5 mm"),
        ("TCP speed < 250 m/s", "TCP speed < 250 mm/s"),
        ("nearest hand to TCP > -1 mm", "nearest hand to TCP > 1 mm"),
        ("joint accelerations never above 500 rad/s2", "joint accelerations never above 500 deg/s2"),
        ("TCP acceleration never above 500 m/s2", "TCP acceleration never above 500 mm/s2"),
        ("hand distance never below 50 m", "hand distance never below 50 mm"),
    ],
)
def test_a_limit_that_nothing_can_reach_is_refused_as_another_unit(
    sentence: str, meant: str, seen: Trace
) -> None:
    with pytest.raises((FormulaError, InadmissibleError), match="probably another unit"):
        said(sentence, seen)
    said(meant, seen)


def test_the_hint_is_not_for_a_limit_of_zero(seen: Trace) -> None:
    assert said("hand distance > 0 mm", seen).verdict is Verdict.HOLDS
    with pytest.raises(InadmissibleError) as refused:
        said("hand distance never below -1 mm", seen)
    assert "another unit" not in str(refused.value)
