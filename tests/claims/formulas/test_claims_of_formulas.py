"""Formulas on real runs: the catalogue's word where both speak, three values where something is unknown."""

from __future__ import annotations

from dataclasses import replace
from math import inf, nan
from pathlib import Path

import numpy as np
import pytest
from examples import VISIT, run, scenario
from hypothesis import given, settings
from hypothesis import strategies as st
from random_formulas import formulas

from safety_harness.admission.admit import admit
from safety_harness.admission.claims import property_of
from safety_harness.base.exceptions import FormulaError, InadmissibleError, Place
from safety_harness.claims.formulas.claim import FormulaClaim, judge_part
from safety_harness.claims.formulas.formula import Comparison, Formula, Not, Relation, Truth, parts_of
from safety_harness.claims.formulas.language import (
    always,
    eventually,
    hand_distance,
    initially,
    m,
    m_per_s,
    parse_formula,
    repulsing,
    servoing,
    stopped,
    tcp_speed,
    whenever,
)
from safety_harness.claims.formulas.measures import Measure
from safety_harness.claims.formulas.quantities import quantity
from safety_harness.claims.formulas.signals import SIGNALS
from safety_harness.claims.properties.base import Evaluation, Unit
from safety_harness.claims.properties.hand_distance import RESOLUTION_M
from safety_harness.scenario.model import EDITION, Claim, Verdict
from safety_harness.scenario.read import read_scenario
from safety_harness.trace.trace import Trace

HOLDS, VIOLATED, INCONCLUSIVE = Verdict.HOLDS, Verdict.VIOLATED, Verdict.INCONCLUSIVE
PLACE = Place(file=Path("a.yaml"), line=12, field="claims")


def judged(sentence: str, trace: Trace) -> Evaluation:
    claim = Claim(sentence=sentence, expected=HOLDS, place=PLACE)
    return property_of(claim, trace.scenario).evaluate(trace)


def cut(trace: Trace, ticks: int) -> Trace:
    made = trace.decisions[trace.decisions["tick"] < ticks]
    latency_s = trace.decision_latency_s[: len(made)]
    return replace(
        trace, ticks=trace.ticks[:ticks], decisions=made, decision_latency_s=latency_s, ended="interrupted"
    )


def with_value(trace: Trace, field: str, tick: int, value: object) -> Trace:
    ticks = trace.ticks.copy()
    ticks[field][tick] = value
    return replace(trace, ticks=ticks)


@pytest.fixture(scope="module")
def alone() -> Trace:
    return run(scenario(duration_s=0.4))


@pytest.mark.parametrize("limit_mm", [50, 200, 265, 275, 400, 700])
def test_a_formula_of_the_hand_distance_says_what_the_catalogue_says(visit: Trace, limit_mm: int) -> None:
    own = judged(f"always hand distance > {limit_mm} mm", visit)
    catalogue = judged(f"hand distance never below {limit_mm} mm", visit)
    assert own.verdict is catalogue.verdict
    assert own.exercised == catalogue.exercised
    assert own.margin == pytest.approx(catalogue.margin, abs=RESOLUTION_M)
    assert own.worst_time_s == pytest.approx(catalogue.worst_time_s, abs=0.0081)


@pytest.mark.parametrize("limit_mmps", [100, 240, 260])
def test_a_formula_of_the_speed_says_what_the_catalogue_says(visit: Trace, limit_mmps: int) -> None:
    own = judged(f"TCP speed <= {limit_mmps} mm/s", visit)
    catalogue = judged(f"TCP speed never above {limit_mmps} mm/s", visit)
    assert (own.verdict, own.margin, own.exercised) == (
        catalogue.verdict,
        catalogue.margin,
        catalogue.exercised,
    )


def test_what_holds_at_the_ticks_alone_is_not_known_to_hold(visit: Trace) -> None:
    """Between both ends of the least distance lies a limit that neither breaks nor keeps."""
    assert hand_distance.finer is not None
    sampled = hand_distance.finer(visit)
    assert sampled.surely is not None
    limit_m = 0.5 * (sampled.low.min() + sampled.surely.min())
    assert sampled.low.min() < limit_m < sampled.surely.min() <= sampled.value.min()
    evaluation = FormulaClaim(always(hand_distance() > m(limit_m))).evaluate(visit)
    assert evaluation.verdict is INCONCLUSIVE
    assert evaluation.margin is not None
    assert -RESOLUTION_M < evaluation.margin < 0.0
    assert "perhaps not between them: between -0.0" in evaluation.reason


@pytest.mark.parametrize(
    ("sentence", "verdict"),
    [
        ("always hand distance > 50 mm", INCONCLUSIVE),
        ("always hand distance > 700 mm", VIOLATED),  # already in what is left
        ("eventually repulsing", INCONCLUSIVE),  # seen, but a run that was cut short proves no safety
        ("eventually stopped", INCONCLUSIVE),
        ("always servoing", VIOLATED),
        ("initially servoing", INCONCLUSIVE),
        ("initially repulsing", VIOLATED),
    ],
)
def test_a_run_that_was_cut_short_proves_violations_only(
    visit: Trace, sentence: str, verdict: Verdict
) -> None:
    evaluation = judged(sentence, cut(visit, 150))
    assert evaluation.verdict is verdict
    if verdict is INCONCLUSIVE:
        assert "cut short" in evaluation.reason


def test_a_trace_without_a_tick_says_nothing(visit: Trace) -> None:
    assert judged("always servoing", cut(visit, 0)).reason == "the trace is empty"


def test_a_trace_that_contradicts_itself_says_nothing(visit: Trace) -> None:
    assert judged("always servoing", with_value(visit, "mode", 5, 77)).verdict is INCONCLUSIVE


def test_what_is_not_known_at_one_tick_is_said_with_its_time(visit: Trace) -> None:
    hole = with_value(visit, "tcp_speed_mps", 10, nan)
    evaluation = judged("TCP speed < 260 mm/s", hole)
    assert (evaluation.verdict, evaluation.reason) == (INCONCLUSIVE, "TCP speed is not known at 0.080 s")
    assert judged("TCP speed < 260 mm/s", visit).verdict is HOLDS
    assert judged("TCP speed < 100 mm/s", hole).verdict is VIOLATED  # whatever it was then
    unseen = with_value(visit, "hand_distance_m", 9, nan)
    assert judged("hand distance > 50 mm", unseen).verdict is INCONCLUSIVE


def test_a_signal_that_there_is_not_makes_no_evidence(alone: Trace) -> None:
    nobody = "never exercised: there is no hand in this scenario; one within 400 mm of the TCP exercises it"
    for sentence, why in {
        "always hand distance > 50 mm": nobody,
        "not nearest hand to TCP < 50 mm": nobody,
        "predicted hand distance > 50 mm": nobody,
        "prediction error < 50 mm": nobody,
        "whenever deciding then spread < 50 mm": nobody,
        "not falling back": nobody,
        "not fault acting": "there is no fault in this scenario",
    }.items():
        evaluation = judged(sentence, alone)
        assert (evaluation.verdict, evaluation.reason, evaluation.exercised) == (INCONCLUSIVE, why, 0)


def test_a_hand_that_stays_away_puts_nothing_to_the_test() -> None:
    far = run(scenario(replace(VISIT, moves=VISIT.moves[1:2]), duration_s=0.2))
    evaluation = judged("always hand distance > 50 mm", far)
    assert evaluation.verdict is INCONCLUSIVE
    assert evaluation.reason.startswith(
        "never exercised: the nearest hand came to 654.9 mm of the arm's surface"
    )


def test_a_trigger_that_never_comes_is_no_evidence(visit: Trace) -> None:
    never = judged("whenever stopped then TCP speed < 1 mm/s", visit)
    assert (never.verdict, never.exercised) == (INCONCLUSIVE, 0)
    assert never.reason == 'never exercised: "stopped" never holds'
    entered = np.count_nonzero(np.diff((visit.ticks["mode"] == 1).astype(int)) == 1)
    often = judged("whenever repulsing then hand distance > 50 mm", visit)
    assert (often.verdict, often.exercised) == (HOLDS, entered)


def test_a_margin_of_whenever_is_the_worst_of_the_response_where_it_is_asked(visit: Trace) -> None:
    asked = visit.ticks["hand_distance_m"].min(axis=1) < 0.4
    evaluation = judged("whenever hand distance < 400 mm then TCP speed < 100 mm/s", visit)
    slowest = 0.1 - visit.ticks["tcp_speed_mps"][asked].max()
    assert evaluation.verdict is VIOLATED
    assert evaluation.margin == pytest.approx(slowest, abs=5e-3)  # the mean between two ticks counts too
    assert evaluation.unit is Unit.SPEED


def test_a_trigger_that_never_comes_says_by_how_little(visit: Trace) -> None:
    nearest_m = visit.ticks["hand_distance_m"].min()
    never = judged("whenever hand distance < 100 mm then stopped", visit)
    lacked = f"it lacked at least {(nearest_m - 0.1) * 1e3:.1f} mm"
    assert never.reason.startswith(f'never exercised: "hand distance < 100 mm" never holds: {lacked}, at ')
    mixed = judged("whenever hand distance < 100 mm and TCP speed < 1 mm/s then stopped", visit)
    assert mixed.reason.endswith("never holds")


def test_until_that_has_ended_before_it_began_is_no_evidence(visit: Trace) -> None:
    evaluation = judged("repulsing until hand distance > 300 mm within 2 s", visit)
    assert evaluation.verdict is INCONCLUSIVE
    assert evaluation.reason == 'never exercised: "hand distance > 300 mm" holds from the beginning'
    assert judged("servoing until repulsing", visit).verdict is HOLDS
    assert judged("servoing until repulsing", visit).exercised == np.argmax(visit.ticks["mode"] == 1)


@pytest.mark.parametrize(
    ("sentence", "told"),
    [
        ("within 5 s repulsing", "looks 5 s ahead"),
        ("always for 3 s (within 2 s servoing)", "looks 5 s ahead"),
        ("servoing until repulsing within 1 min", "looks 60 s ahead"),
        ("eventually from 1 ms to 2 ms servoing", "1 ms to 2 ms in"),
    ],
)
def test_a_window_without_room_is_refused_at_its_place(visit: Trace, sentence: str, told: str) -> None:
    with pytest.raises(FormulaError, match=told) as caught:
        judged(sentence, visit)
    assert caught.value.place == PLACE
    with pytest.raises(FormulaError, match=told):
        FormulaClaim(parse_formula(sentence)).evaluate(visit)


def test_a_window_as_long_as_the_scenario_has_room(visit: Trace) -> None:
    assert judged("always for 4 s not stopped", visit).verdict is HOLDS


def test_what_a_window_beyond_the_end_would_decide_stays_open(visit: Trace) -> None:
    evaluation = judged("always (within 1 s repulsing)", cut(visit, len(visit.ticks)))
    assert evaluation.verdict is VIOLATED
    open_end = judged("always (always for 1 s not stopped)", visit)
    assert open_end.verdict is INCONCLUSIVE
    assert "beyond the end of the run" in open_end.reason


def test_each_part_that_and_joins_keeps_its_margin_and_unit(visit: Trace) -> None:
    evaluation = judged("always (hand distance > 50 mm and TCP speed < 100 mm/s and not stopped)", visit)
    distance, speed, stop = evaluation.parts
    assert (distance.verdict, distance.unit) == (HOLDS, Unit.LENGTH)
    assert (speed.verdict, speed.unit) == (VIOLATED, Unit.SPEED)
    assert (stop.verdict, stop.margin, stop.unit) == (HOLDS, 1.0, Unit.COUNT)
    assert (evaluation.verdict, evaluation.margin, evaluation.unit) == (VIOLATED, speed.margin, Unit.SPEED)
    assert speed.sentence == "always TCP speed < 100 mm/s"
    for part in evaluation.parts:
        assert f"{part.sentence}: {part.verdict.value}, {part.margin_text()} (" in evaluation.reason


def test_the_worst_of_two_violations_in_one_unit_is_shown_and_an_open_part_is_graver_than_one_that_holds(
    visit: Trace,
) -> None:
    two = judged("hand distance > 500 mm and hand distance > 700 mm", visit)
    assert two.margin == two.parts[1].margin
    half = judged("TCP speed < 260 mm/s and (whenever stopped then servoing)", visit)
    assert [part.verdict for part in half.parts] == [HOLDS, INCONCLUSIVE]
    assert half.verdict is INCONCLUSIVE
    assert half.exercised == 0


def test_a_value_at_its_very_limit_is_judged_by_the_sign(alone: Trace) -> None:
    for sentence, verdict, margin in (
        ("elapsed time >= 0 s", HOLDS, 0.0),
        ("elapsed time > 0 s", VIOLATED, -np.finfo(float).tiny),
    ):
        evaluation = FormulaClaim(parse_formula(sentence)).evaluate(alone)
        assert (evaluation.verdict, evaluation.margin) == (verdict, margin)
        assert evaluation.reason == "elapsed time 0 s, exactly the limit"


def test_a_sentence_that_is_neither_is_told_of_both(alone: Trace) -> None:
    with pytest.raises(InadmissibleError, match='a formula such as "always hand distance > 50 mm"'):
        judged("the robot is kind", alone)


LIMITS = {"m": (-0.1, 0.0, 0.05, 0.269, 0.3, 0.8), "m/s": (0.0, 0.1, 0.247, 0.5), "rad": (0.0, 0.001, 0.1)}


@st.composite
def atoms(draw: st.DrawFn) -> Formula:
    signal = draw(st.sampled_from(SIGNALS))
    if signal.dimension is None:
        return Truth(signal)
    limit = draw(st.sampled_from(LIMITS.get(signal.dimension.si, (0.0, 0.01, 0.5, 2.0))))
    assert isinstance(signal, Measure)
    own = quantity(max(limit, signal.lowest), signal.dimension.si, signal.dimension)
    return Comparison(signal, draw(st.sampled_from(list(Relation))), own)


@settings(max_examples=150, deadline=None)
@given(formulas(atoms()), st.booleans())
def test_no_formula_agrees_with_its_negation_and_no_margin_contradicts_its_verdict(
    visit: Trace, formula: Formula, whole: bool
) -> None:
    trace = visit if whole else cut(visit, 200)
    try:
        asked = [part for part in (always(formula), Not(always(formula))) if parts_of(part)]
    except FormulaError:
        return  # margins of two kinds
    first, second = (judge_part(part, trace) for part in asked)
    for one in (first, second):
        assert one.margin is None or abs(one.margin) < inf
        if one.verdict is VIOLATED:
            assert one.margin is not None
            assert one.margin < 0.0
        if one.verdict is HOLDS:
            assert one.margin is not None
            assert one.margin >= 0.0
            assert one.exercised > 0
            assert whole
    assert (first.verdict, second.verdict) not in [(HOLDS, HOLDS), (VIOLATED, VIOLATED)]


def test_python_and_sentence_are_the_same_claim(visit: Trace) -> None:
    python = FormulaClaim(whenever(repulsing()).then(eventually(servoing() & ~stopped())))
    assert python.evaluate(visit) == judged(python.sentence, visit)
    assert FormulaClaim(initially(servoing())).evaluate(visit).exercised == 1
    assert FormulaClaim(tcp_speed() < m_per_s(1)).evaluate(visit).verdict is HOLDS


@pytest.mark.parametrize(
    ("claim", "told"),
    [
        ("always hand distence > 50 mm", '"hand distence" at column 8'),
        ("within 3 s servoing", "which looks 3 s ahead"),
        ("hand distance > 50 mm or TCP speed < 1 m/s", "one kind of margin"),
    ],
)
def test_a_file_is_refused_at_the_line_of_the_formula(claim: str, told: str, tmp_path: Path) -> None:
    file = tmp_path / "own.yaml"
    start = "scenario: a run\nduration: 2 s\ntcp start: {offset: [0 mm, -60 mm, 20 mm]}\nclaims:\n"
    file.write_text(f"{start}  joint speeds within limits: holds\n  {claim}: holds\n")
    with pytest.raises(FormulaError, match=told) as caught:
        admit(read_scenario(file))
    assert (caught.value.place.file, caught.value.place.line) == (file, 6)


@pytest.mark.parametrize(
    "sentence",
    [
        "eventually hand distance > 50 mm",
        "within 2 s hand distance > 50 mm",
        "not (always hand distance < 50 mm)",
        "eventually (always for 500 ms hand distance > 50 mm)",
    ],
)
def test_what_is_met_at_the_first_tick_says_nothing_of_what_follows(visit: Trace, sentence: str) -> None:
    """Whoever writes "eventually" for "always" gets no verdict; edition 1 held."""
    found = judged(sentence, visit)
    assert found.verdict is INCONCLUSIVE
    assert found.reason.endswith("holds from the beginning")
    stored = FormulaClaim(parse_formula(sentence), edition=1).evaluate(visit)
    assert stored.verdict is HOLDS
    met = judged("eventually repulsing", visit)
    assert (met.verdict, met.exercised) == (HOLDS, int(np.argmax(visit.ticks["mode"] == 1)))


@pytest.mark.parametrize(
    "sentence",
    ["TCP speed >= 0 mm/s", "always joint speed >= 0 deg/s", "spread >= 0 mm", "nearest hand to TCP > 0 mm"],
)
def test_a_limit_that_every_run_keeps_is_refused(sentence: str) -> None:
    def claimed(sentence: str, edition: int = EDITION) -> Claim:
        return Claim(sentence=sentence, expected=HOLDS, place=PLACE, edition=edition)

    with pytest.raises(FormulaError, match="which every run keeps"):
        property_of(claimed(sentence), scenario())
    property_of(claimed(sentence, edition=1), scenario())  # stored evidence is read
    property_of(claimed(f"whenever {sentence.removeprefix('always ')} then stopped"), scenario())
    property_of(claimed("hand distance > 0 mm"), scenario())  # which is negative inside


@pytest.mark.parametrize(
    "sentence",
    [
        "proposals lead away to within 100 mm",
        "proposals within 9 m of the optimum",
        "proposals within 3 spreads and 9 m of the optimum",
        "proposals never sure and more than 200 mm from the optimum",
        "repulsion moves away from every hand to within 1 m",
    ],
)
def test_a_tolerance_that_a_step_of_the_avoider_cannot_exceed_is_refused(sentence: str) -> None:
    """A step of 100 mm straight into the hand would keep it."""
    with pytest.raises(InadmissibleError, match="the largest error of a step of 100 mm"):
        property_of(Claim(sentence=sentence, expected=HOLDS, place=PLACE), scenario())
    property_of(
        Claim(sentence=sentence, expected=HOLDS, place=PLACE, edition=1), scenario()
    )  # stored evidence is read
