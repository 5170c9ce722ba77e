"""Doubt falls back, certainty is used, and the arm stops where nothing can be reached."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from broken import (
    CERTAIN,
    IN_DOUBT,
    TOO_FAR,
    falls_back_to_the_hand,
    gate_of,
    heads_out_of_reach,
    uses_no_answer,
    uses_what_it_doubts,
)
from examples import VISIT, AnswersNothing, Displaced, StoppingGate, hand, run, scenario

from safety_harness.base.settings import DEFAULTS, HandSensorKind
from safety_harness.claims.properties import fallback
from safety_harness.claims.properties.base import Property
from safety_harness.claims.properties.fallback import (
    CertainIsUsed,
    FallbackPoses,
    StopsWhereNothingIsReachable,
    UncertainFallsBack,
)
from safety_harness.scenario.faults import FalseHand
from safety_harness.scenario.gate import GateRule
from safety_harness.scenario.model import Verdict
from safety_harness.scenario.moves import MoveTo
from safety_harness.scenario.obstacles import Obstacle
from safety_harness.trace.records import Check, DecisionOutcome, Mode
from safety_harness.trace.trace import Trace

UNCERTAIN, USED = UncertainFallsBack(cycles=2), CertainIsUsed()
OUT_OF_REACH = Displaced((0.0, 2.0, 0.0), spread_m=0.03, spread_threshold_m=0.02)
STOPS, POSES = StopsWhereNothingIsReachable(), FallbackPoses()


@lru_cache
def doubting() -> Trace:
    return run(scenario(VISIT), avoider=IN_DOUBT)


@lru_cache
def certain() -> Trace:
    return run(scenario(VISIT), avoider=CERTAIN)


@lru_cache
def nowhere_to_go() -> Trace:
    return run(scenario(VISIT, settings=TOO_FAR), avoider=OUT_OF_REACH)


def edited(trace: Trace, **changed: object) -> Trace:
    decisions = trace.decisions.copy()
    for name, value in changed.items():
        decisions[name] = value
    return replace(trace, decisions=decisions)


@pytest.mark.parametrize(
    ("prop", "trace"),
    [
        (UNCERTAIN, doubting),
        (USED, certain),
        (UNCERTAIN, nowhere_to_go),
        (STOPS, nowhere_to_go),
        (POSES, doubting),
    ],
    ids=["falls-back", "is-used", "stops-in-doubt", "stops", "pose"],
)
def test_the_system_holds(prop: Property, trace: object) -> None:
    evaluation = prop.evaluate(trace())  # type: ignore[operator]
    assert evaluation.verdict is Verdict.HOLDS, evaluation
    assert evaluation.exercised > 0


def test_doubt_and_certainty_are_each_others_silence() -> None:
    assert UNCERTAIN.evaluate(certain()).verdict is Verdict.INCONCLUSIVE
    assert USED.evaluate(doubting()).verdict is Verdict.INCONCLUSIVE


def test_an_avoider_without_a_threshold_says_nothing_of_either(visit: Trace) -> None:
    assert UNCERTAIN.evaluate(visit).verdict is Verdict.INCONCLUSIVE
    assert USED.evaluate(visit).verdict is Verdict.INCONCLUSIVE


def test_no_answer_is_neither_certain_nor_uncertain() -> None:
    silent = run(scenario(VISIT), avoider=AnswersNothing())
    assert len(silent.decisions) > 0
    for prop in (UNCERTAIN, USED):
        assert prop.evaluate(silent).verdict is Verdict.INCONCLUSIVE


def test_noting_down_the_opposite_pose_does_not_make_up_for_going_elsewhere() -> None:
    """The records say that it fell back; the arm went where the avoider had said."""
    trace = uses_what_it_doubts()
    said = edited(
        trace,
        outcome=DecisionOutcome.OPPOSITE,
        chosen_position_in_base_m=trace.decisions["opposite_position_in_base_m"],
    )
    evaluation = UNCERTAIN.evaluate(said)
    assert evaluation.verdict is Verdict.VIOLATED, evaluation
    assert "from the opposite pose" in evaluation.reason, evaluation


def test_using_an_answer_is_judged_by_the_way_too() -> None:
    trace = uses_no_answer()
    said = edited(
        trace,
        outcome=DecisionOutcome.PROPOSED,
        chosen_position_in_base_m=trace.decisions["proposed_position_in_base_m"],
    )
    evaluation = USED.evaluate(said)
    assert evaluation.verdict is Verdict.VIOLATED, evaluation
    assert "from the proposed position" in evaluation.reason


def test_a_stop_is_no_fallback_while_the_opposite_pose_could_be_used() -> None:
    stopped = run(scenario(VISIT), avoider=IN_DOUBT, gate=gate_of(StoppingGate))
    evaluation = UNCERTAIN.evaluate(stopped)
    assert evaluation.verdict is Verdict.VIOLATED
    assert evaluation.margin is not None
    assert -0.1 <= evaluation.margin < -0.05  # all that the opposite pose had to spare


def test_a_stop_instead_of_a_certain_answer_costs_the_whole_way() -> None:
    stopped = run(scenario(VISIT), avoider=CERTAIN, gate=gate_of(StoppingGate))
    evaluation = USED.evaluate(stopped)
    assert evaluation.verdict is Verdict.VIOLATED
    assert evaluation.margin == pytest.approx(-np.hypot(0.05, 0.08), abs=1e-9)


def test_calling_it_a_stop_and_moving_on_is_violated() -> None:
    trace = heads_out_of_reach()
    ticks = trace.ticks.copy()
    ticks["mode"][ticks["mode"] == Mode.REPULSING] = Mode.PROTECTIVE_STOP
    evaluation = STOPS.evaluate(replace(trace, ticks=ticks))
    assert evaluation.verdict is Verdict.VIOLATED


def test_every_decision_that_left_nothing_is_judged_and_the_worst_is_told() -> None:
    """Before the one that was there, one that could be used; after it one at the very end of the run."""
    trace = heads_out_of_reach()
    (only,) = trace.decisions
    ticks, decisions = trace.ticks.copy(), np.repeat(trace.decisions, 3)
    at = (int(only["tick"]) - 10, int(only["tick"]), len(ticks) - 1)
    ticks["decision"] = -1
    for number, tick in enumerate(at):
        ticks["decision"][tick] = number
        tcp = ticks["transform_tcp_to_base"][tick, :3, 3]
        decisions["tick"][number], decisions["time_s"][number] = tick, ticks["time_s"][tick]
        decisions["asked_tick"][number] = tick
        decisions["joint_position_rad"][number] = ticks["joint_position_rad"][tick]
        decisions["tcp_position_in_base_m"][number] = tcp
        far = (0.0, 0.0, 0.01) if number == 0 else (0.0, 2.0, 0.0)
        decisions["proposed_position_in_base_m"][number] = tcp + np.array(far)
    three = replace(trace, ticks=ticks, decisions=decisions, decision_latency_s=np.zeros(3))
    alone, evaluation = STOPS.evaluate(trace), STOPS.evaluate(three)
    assert evaluation.exercised == 2
    assert (evaluation.margin, evaluation.worst_time_s) == (alone.margin, float(only["time_s"]))
    assert evaluation.reason == "way left of a stop's, worst of 2"


def test_a_certain_answer_that_cannot_be_used_need_not_be() -> None:
    far = Displaced((0.0, 2.0, 0.0), spread_m=0.01, spread_threshold_m=0.02)
    assert USED.evaluate(run(scenario(VISIT), avoider=far)).verdict is Verdict.INCONCLUSIVE


def test_a_fallback_that_heads_for_the_hand_breaks_its_second_part_alone() -> None:
    evaluation = POSES.evaluate(falls_back_to_the_hand())
    assert [part.verdict for part in evaluation.parts] == [Verdict.HOLDS, Verdict.VIOLATED]
    assert evaluation.margin == evaluation.parts[1].margin


def test_a_fallback_out_of_reach_breaks_its_first_part_alone() -> None:
    evaluation = POSES.evaluate(nowhere_to_go())
    assert [part.verdict for part in evaluation.parts] == [Verdict.VIOLATED, Verdict.HOLDS]
    assert evaluation.margin is not None
    assert evaluation.margin < -0.5


def test_no_fallback_pose_at_all_is_a_violation() -> None:
    none = edited(doubting(), opposite_position_in_base_m=np.nan)
    assert POSES.evaluate(none).verdict is Verdict.VIOLATED


def test_without_a_true_hand_its_direction_is_not_exercised() -> None:
    ticks = doubting().ticks.copy()
    ticks["hand_present"] = False
    ticks["hand_distance_capsule"] = -1
    nobody = replace(doubting(), ticks=ticks, scenario=replace(doubting().scenario, hands=()))
    evaluation = POSES.evaluate(nobody)
    assert [part.verdict for part in evaluation.parts] == [Verdict.HOLDS, Verdict.INCONCLUSIVE]


@pytest.mark.parametrize("prop", [UNCERTAIN, USED, STOPS, POSES], ids=lambda prop: prop.sentence)
@pytest.mark.parametrize("field", ["joint_position_rad", "transform_tcp_to_base"])
def test_what_is_not_finite_is_no_evidence(prop: Property, field: str) -> None:
    ticks = doubting().ticks.copy()
    ticks[field][len(ticks) // 2] = np.nan
    assert prop.evaluate(replace(doubting(), ticks=ticks)).verdict is Verdict.INCONCLUSIVE


@pytest.mark.parametrize("prop", [UNCERTAIN, USED, STOPS, POSES], ids=lambda prop: prop.sentence)
def test_without_a_decision_there_is_nothing_to_judge(prop: Property) -> None:
    assert prop.evaluate(run(scenario(duration_s=0.2))).verdict is Verdict.INCONCLUSIVE


def twice(trace: Trace) -> Trace:
    """Its first decision, and the same a tick later."""
    ticks, decisions = trace.ticks.copy(), np.repeat(trace.decisions[:1], 2)
    later = int(decisions["tick"][0]) + 1
    ticks["decision"] = -1
    ticks["decision"][later - 1 : later + 1] = 0, 1
    decisions["tick"][1] = decisions["asked_tick"][1] = later
    decisions["time_s"][1] = ticks["time_s"][later]
    decisions["joint_position_rad"][1] = ticks["joint_position_rad"][later]
    decisions["tcp_position_in_base_m"][1] = ticks["transform_tcp_to_base"][later, :3, 3]
    return replace(trace, ticks=ticks, decisions=decisions, decision_latency_s=np.zeros(2))


def test_a_margin_that_is_not_finite_decides_wherever_it_stands(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for later in (np.nan, np.inf):
        reach_m, stopped_m = iter([0.1, later]), iter([0.1, later])
        monkeypatch.setattr(fallback, "reach_m", lambda *_, reach_m=reach_m: next(reach_m))
        told = POSES.evaluate(twice(doubting()))
        assert (told.verdict, "not finite" in told.reason) == (Verdict.INCONCLUSIVE, True), told.reason
        monkeypatch.setattr(fallback, "reach_m", lambda *_: -1.0)
        monkeypatch.setattr(fallback, "stopped_m", lambda *_, stopped_m=stopped_m: next(stopped_m))
        told = STOPS.evaluate(twice(doubting()))
        assert (told.verdict, "not finite" in told.reason) == (Verdict.INCONCLUSIVE, True), told.reason


def test_a_part_that_is_violated_is_not_hidden_by_one_that_is_not_finite(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(fallback, "reach_m", lambda *_: np.nan)
    trace = doubting()
    hand = trace.ticks["hand_position_in_base_m"][int(trace.decisions["tick"][0]), 0]
    evaluation = POSES.evaluate(edited(trace, opposite_position_in_base_m=hand))
    assert [part.verdict for part in evaluation.parts] == [Verdict.INCONCLUSIVE, Verdict.VIOLATED]
    assert evaluation.verdict is Verdict.VIOLATED


def test_what_the_cells_boxes_bar_could_not_be_used() -> None:
    box = Obstacle(size_m=(0.1, 0.1, 0.1), position_in_base_m=(0.74, 0.05, 0.52))
    walled = replace(scenario(VISIT), obstacles=(box,))
    refused = run(walled, avoider=CERTAIN)
    assert Check.OBSTACLE & int(refused.decisions["proposed_failed"][0])
    assert USED.evaluate(refused).verdict is Verdict.INCONCLUSIVE
    assert USED.evaluate(run(scenario(VISIT), avoider=CERTAIN)).verdict is Verdict.HOLDS


def test_a_way_refused_for_where_a_hand_may_be_is_not_asked_for() -> None:
    """Only the filter knows where that is; a gate without such a rule is not believed."""
    trace = run(scenario(VISIT), avoider=CERTAIN, gate=gate_of(StoppingGate))
    kept = edited(trace, proposed_failed=int(Check.TOWARDS_A_HAND), opposite_failed=int(Check.TOWARDS_A_HAND))
    assert USED.evaluate(kept).verdict is Verdict.VIOLATED
    ruled = replace(kept, scenario=replace(kept.scenario, gate=GateRule(hands_within=0.99)))
    told = USED.evaluate(ruled)
    assert (told.verdict, "from where a hand may be" in told.reason) == (Verdict.INCONCLUSIVE, True)
    in_doubt = edited(ruled, proposed_spread_m=0.03)
    told = UNCERTAIN.evaluate(in_doubt)
    assert (told.verdict, told.reason) == (Verdict.HOLDS, "the way of the stop")


def test_a_stop_of_the_next_decision_is_none_of_the_one_before() -> None:
    false_hand = FalseHand(position_in_base_m=(0.64, 0.17, 0.38), from_s=0.424)
    overhead = replace(DEFAULTS, hand_sensor=replace(DEFAULTS.hand_sensor, kind=HandSensorKind.OVERHEAD))
    coming = hand(MoveTo(position_in_base_m=(0.84, -0.45, 0.25), speed_mps=0.5), at=(0.84, -0.7, 0.25))
    what = replace(scenario(coming, duration_s=3.0, settings=overhead), faults=(false_hand,))
    trace = run(what, avoider=Displaced((0.0, 0.1, 0.0), spread_m=0.03, spread_threshold_m=0.02))
    first, second = trace.decisions["tick"][:2].tolist()
    assert trace.decisions["outcome"][:2].tolist() == [DecisionOutcome.OPPOSITE, DecisionOutcome.STOP]
    for cycles in (2, second - first, 50):
        assert UncertainFallsBack(cycles=cycles).evaluate(trace).verdict is Verdict.HOLDS, cycles
