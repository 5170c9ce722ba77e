"""Giving way in time, and only to hands: stretches counted by hand, controllers set up wrongly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from broken import minds_hands_within, sees_no_hand
from examples import ConstantSpeed, hand, run, scenario

from safety_harness.base.settings import DEFAULTS
from safety_harness.claims.properties.reaction import (
    GivesWay,
    GivesWayToTrueHand,
    NoFalseAlarms,
    beginnings,
    gives_way,
    predicted_near,
)
from safety_harness.claims.signals.true_motion import nearest_hand_m
from safety_harness.scenario.faults import FalseHand
from safety_harness.scenario.model import Verdict
from safety_harness.scenario.moves import Wait
from safety_harness.trace.records import Limit, Mode
from safety_harness.trace.trace import Trace

IN_TIME, NO_ALARM = GivesWay(within_s=0.1), NoFalseAlarms()
IN_TRUTH = GivesWayToTrueHand(within_s=0.1)


def reacting_from(trace: Trace, late: int, until: int | None = None) -> Trace:
    """The same run, but the controller gives way only from ``late`` ticks after the hand came near on."""
    ticks = trace.ticks.copy()
    near = np.flatnonzero(predicted_near(trace)[0])
    ticks["mode"] = Mode.SERVOING
    ticks["mode"][near[0] + late : until] = Mode.REPULSING
    return replace(trace, ticks=ticks)


def test_the_system_reacts_in_the_very_tick(visit: Trace) -> None:
    evaluation = IN_TIME.evaluate(visit)
    assert (evaluation.verdict, evaluation.margin) == (Verdict.HOLDS, 0.1)
    assert evaluation.exercised == 1
    near = np.flatnonzero(predicted_near(visit)[0])
    assert gives_way(visit)[near].all()
    assert np.all(visit.ticks["predicted_distance_m"][near] < 0.4)


@pytest.mark.parametrize(
    ("late", "verdict"), [(1, "holds"), (12, "holds"), (13, "violated"), (50, "violated")]
)
def test_each_tick_of_delay_costs_a_control_period(late: int, verdict: str, visit: Trace) -> None:
    evaluation = IN_TIME.evaluate(reacting_from(visit, late))
    assert evaluation.margin == pytest.approx(0.1 - 0.008 * late, abs=1e-12)
    assert evaluation.verdict is Verdict(verdict)


def test_a_delay_of_exactly_the_time_allowed_holds(visit: Trace) -> None:
    evaluation = GivesWay(within_s=0.104).evaluate(reacting_from(visit, 13))
    assert (evaluation.verdict, evaluation.margin) == (Verdict.HOLDS, 0.0)


def test_a_protective_stop_is_a_reaction(visit: Trace) -> None:
    ticks = visit.ticks.copy()
    ticks["mode"][ticks["mode"] == Mode.REPULSING] = Mode.PROTECTIVE_STOP
    assert IN_TIME.evaluate(replace(visit, ticks=ticks)).verdict is Verdict.HOLDS


def test_losing_the_object_is_none(visit: Trace) -> None:
    ticks = visit.ticks.copy()
    ticks["mode"] = Mode.OBJECT_LOST
    assert IN_TIME.evaluate(replace(visit, ticks=ticks)).verdict is Verdict.VIOLATED


def test_going_back_to_servoing_beside_the_hand_counts_as_not_reacting(visit: Trace) -> None:
    near = np.flatnonzero(predicted_near(visit)[0])
    stops_early = reacting_from(visit, 0, until=int(near[0]) + 10)
    assert len(near) > 30
    evaluation = IN_TIME.evaluate(stops_early)
    assert evaluation.verdict is Verdict.VIOLATED
    assert evaluation.worst_time_s == visit.time_s[-1]


def test_a_run_that_ends_before_the_time_allowed_is_no_evidence(visit: Trace) -> None:
    first = int(np.flatnonzero(predicted_near(visit)[0])[0])
    late = reacting_from(visit, 500)
    scene = replace(visit.scenario, duration_s=float(visit.time_s[first + 5]))
    keep = visit.decisions["tick"] < first + 6
    short = replace(
        late, ticks=late.ticks[: first + 6].copy(), scenario=scene, decisions=visit.decisions[keep]
    )
    assert IN_TIME.evaluate(short).verdict is Verdict.INCONCLUSIVE


def test_a_hand_that_is_near_from_the_first_tick_on_counts_once(visit: Trace) -> None:
    ticks = visit.ticks.copy()
    ticks["track_valid"][:, 0] = True
    ticks["predicted_hand_in_base_m"][:, 0] = ticks["transform_tcp_to_base"][:, :3, 3] + 0.1
    ticks["mode"] = Mode.REPULSING
    evaluation = IN_TIME.evaluate(replace(visit, ticks=ticks))
    assert (evaluation.verdict, evaluation.exercised) == (Verdict.HOLDS, 1)


def beside_a_hand(visit: Trace, near: list[int], answered: slice) -> Trace:
    """A predicted hand beside the TCP in the ticks ``near``, and the controller gives way in ``answered``."""
    ticks = visit.ticks.copy()
    ticks["track_valid"] = False
    ticks["track_valid"][near, 0] = True
    ticks["predicted_hand_in_base_m"][:, 0] = ticks["transform_tcp_to_base"][:, :3, 3] + 0.1
    ticks["mode"] = Mode.SERVOING
    ticks["mode"][answered] = Mode.REPULSING
    return replace(visit, ticks=ticks)


def test_one_that_was_answered_and_is_open_again_at_the_end_is_judged_by_its_answer(visit: Trace) -> None:
    last = len(visit.ticks)
    evaluation = IN_TIME.evaluate(
        beside_a_hand(visit, list(range(last - 60, last)), slice(last - 57, last - 5))
    )
    assert (evaluation.verdict, evaluation.exercised) == (Verdict.HOLDS, 1)
    assert evaluation.margin == pytest.approx(0.1 - 3 * 0.008, abs=1e-12)


def test_two_that_come_in_the_last_moment_and_are_not_answered_are_no_evidence(visit: Trace) -> None:
    last = len(visit.ticks)
    evaluation = IN_TIME.evaluate(beside_a_hand(visit, [last - 6, last - 2, last - 1], slice(0, 0)))
    assert evaluation.verdict is Verdict.INCONCLUSIVE
    assert "the run ends 40 ms after" in evaluation.reason


@pytest.mark.parametrize("field", ["transform_tcp_to_base", "predicted_hand_in_base_m"])
def test_what_is_no_number_is_inconclusive_and_the_reason_says_from_when(field: str, visit: Trace) -> None:
    at = int(np.flatnonzero(predicted_near(visit)[0])[3])
    ticks = visit.ticks.copy()
    ticks[field][at:] = np.nan
    evaluation = IN_TIME.evaluate(replace(visit, ticks=ticks))
    assert evaluation.verdict is Verdict.INCONCLUSIVE
    assert evaluation.reason.endswith(f"is not finite from {visit.time_s[at]:.3f} s")


def true_near(trace: Trace) -> np.ndarray:
    return nearest_hand_m(trace) < 0.4


def answering_from(trace: Trace, late: int, until: int | None = None) -> Trace:
    """The same run, but the controller gives way only from ``late`` ticks after the hand came near on."""
    ticks = trace.ticks.copy()
    first = int(np.flatnonzero(true_near(trace))[0])
    ticks["mode"] = Mode.SERVOING
    ticks["mode"][first + late : until] = Mode.REPULSING
    return replace(trace, ticks=ticks)


def test_a_hand_that_nobody_sees_is_a_true_hand_all_the_same() -> None:
    """What is predicted was answered, and says nothing: there was nothing."""
    blind = sees_no_hand()
    assert IN_TIME.evaluate(blind).verdict is Verdict.INCONCLUSIVE
    evaluation = IN_TRUTH.evaluate(blind)
    assert (evaluation.verdict, evaluation.exercised) == (Verdict.VIOLATED, 1)
    beside_s = float(np.count_nonzero(true_near(blind))) * 0.008
    assert evaluation.margin == pytest.approx(0.1 - beside_s, abs=1e-9)


def test_what_is_predicted_does_not_count_for_true_hands(visit: Trace) -> None:
    ticks = visit.ticks.copy()
    ticks["predicted_hand_in_base_m"] += 5.0
    ticks["track_valid"] = False
    assert IN_TRUTH.evaluate(replace(visit, ticks=ticks)) == IN_TRUTH.evaluate(visit)
    assert IN_TRUTH.evaluate(visit).verdict is Verdict.HOLDS


@pytest.mark.parametrize(("late", "verdict"), [(1, "holds"), (12, "holds"), (13, "violated")])
def test_each_tick_beside_a_true_hand_costs_a_control_period(late: int, verdict: str, visit: Trace) -> None:
    evaluation = IN_TRUTH.evaluate(answering_from(visit, late))
    assert evaluation.margin == pytest.approx(0.1 - 0.008 * late, abs=1e-12)
    assert evaluation.verdict is Verdict(verdict)


def test_a_true_hand_that_has_left_unanswered_shows_nothing(visit: Trace) -> None:
    """Unlike a prediction: the claim is about the danger and not about the controller's own rule."""
    near = np.flatnonzero(true_near(visit))
    ticks = visit.ticks.copy()
    ticks["mode"] = Mode.SERVOING
    ticks["hand_position_in_base_m"][near[5] :] = [2.0, -1.5, 0.2]
    evaluation = IN_TRUTH.evaluate(replace(visit, ticks=ticks))
    assert evaluation.margin == pytest.approx(0.1 - 0.008 * 5, abs=1e-12)
    assert evaluation.verdict is Verdict.INCONCLUSIVE


def test_a_run_that_ends_beside_a_true_hand_before_the_time_allowed_is_no_evidence(visit: Trace) -> None:
    first = int(np.flatnonzero(true_near(visit))[0])
    late = answering_from(visit, 500)
    for ticks, verdict in ((6, Verdict.INCONCLUSIVE), (20, Verdict.VIOLATED)):
        scene = replace(visit.scenario, duration_s=float(visit.time_s[first + ticks - 1]))
        keep = visit.decisions["tick"] < first + ticks
        short = replace(
            late, ticks=late.ticks[: first + ticks].copy(), scenario=scene, decisions=visit.decisions[keep]
        )
        assert IN_TRUTH.evaluate(short).verdict is verdict


@pytest.mark.parametrize("field", ["transform_tcp_to_base", "hand_position_in_base_m"])
def test_a_true_hand_that_is_no_number_is_no_evidence(field: str, visit: Trace) -> None:
    ticks = visit.ticks.copy()
    ticks[field][len(ticks) // 2] = np.nan
    assert IN_TRUTH.evaluate(replace(visit, ticks=ticks)).verdict is Verdict.INCONCLUSIVE


def test_no_true_hand_near_is_no_evidence() -> None:
    far = run(scenario(hand(Wait(duration_s=1.0), at=(2.0, -1.5, 0.2)), duration_s=0.4))
    assert IN_TRUTH.evaluate(far).verdict is Verdict.INCONCLUSIVE


def test_a_controller_that_minds_only_closer_hands_is_too_late() -> None:
    evaluation = IN_TIME.evaluate(minds_hands_within(0.3))
    assert evaluation.verdict is Verdict.VIOLATED
    assert NO_ALARM.evaluate(minds_hands_within(0.3)).verdict is Verdict.HOLDS


def test_a_controller_that_minds_distant_hands_gives_false_alarms() -> None:
    evaluation = NO_ALARM.evaluate(minds_hands_within(0.8))
    assert evaluation.verdict is Verdict.VIOLATED
    assert IN_TIME.evaluate(minds_hands_within(0.8)).verdict is Verdict.HOLDS


def test_no_hand_near_is_no_evidence_of_reacting() -> None:
    far = run(scenario(hand(Wait(duration_s=1.0), at=(2.0, -1.5, 0.2)), duration_s=0.4))
    assert IN_TIME.evaluate(far).verdict is Verdict.INCONCLUSIVE


def test_a_prediction_that_is_no_number_is_no_evidence(visit: Trace) -> None:
    ticks = visit.ticks.copy()
    ticks["predicted_hand_in_base_m"][int(np.argmax(ticks["track_valid"].any(axis=1)))] = np.nan
    assert IN_TIME.evaluate(replace(visit, ticks=ticks)).verdict is Verdict.INCONCLUSIVE


def test_the_margin_of_an_alarm_is_computed_by_hand(visit: Trace) -> None:
    first = int(visit.decisions["tick"][0])
    distance = np.linalg.norm(
        visit.ticks["hand_position_in_base_m"][first, 0] - visit.ticks["transform_tcp_to_base"][first, :3, 3]
    )
    evaluation = NO_ALARM.evaluate(visit)
    assert NO_ALARM.limit_m(DEFAULTS) == pytest.approx(0.4 + 2.0 * 0.1)
    assert evaluation.margin == pytest.approx(0.6 - distance, abs=1e-12)
    assert evaluation.worst_time_s == visit.time_s[first]
    assert evaluation.exercised == np.count_nonzero(nearest_hand_m(visit) > 0.6)


def test_a_wider_limit_leaves_more(visit: Trace) -> None:
    margins = [NoFalseAlarms(within_m=limit).evaluate(visit).margin or 0.0 for limit in (0.45, 0.5, 0.7)]
    assert np.diff(margins) == pytest.approx([0.05, 0.2], abs=1e-12)


def test_a_hand_that_is_not_there_is_the_worst_of_alarms() -> None:
    ghost = FalseHand(position_in_base_m=(0.8, -0.35, 0.25), from_s=0.2, for_s=0.3)
    evaluation = NO_ALARM.evaluate(run(replace(scenario(duration_s=1.5), faults=(ghost,))))
    assert evaluation.verdict is Verdict.VIOLATED
    assert evaluation.reason.startswith("nobody")
    assert evaluation.margin == pytest.approx(-0.6)


def test_servoing_alone_is_evidence_as_long_as_it_lasts() -> None:
    evaluation = NO_ALARM.evaluate(run(scenario(duration_s=0.4)))
    assert (evaluation.verdict, evaluation.exercised) == (Verdict.HOLDS, 51)


def test_a_hand_that_never_leaves_is_no_evidence_of_false_alarms() -> None:
    beside = run(
        scenario(hand(Wait(duration_s=1.0), at=(0.84, -0.4, 0.25)), duration_s=0.4),
        controller=ConstantSpeed((0.0,) * 6),
    )
    assert NO_ALARM.evaluate(beside).verdict is Verdict.INCONCLUSIVE


def test_a_stop_at_a_singularity_is_no_alarm(visit: Trace) -> None:
    quiet = run(scenario(duration_s=0.4))
    ticks = quiet.ticks.copy()
    ticks["mode"][20:] = Mode.PROTECTIVE_STOP
    stopped = replace(quiet, ticks=ticks)
    assert list(beginnings(stopped)) == [20]
    assert NO_ALARM.evaluate(stopped).verdict is Verdict.VIOLATED
    ticks = ticks.copy()
    ticks["limits"][20] |= int(Limit.SINGULARITY)
    assert NO_ALARM.evaluate(replace(quiet, ticks=ticks)).verdict is Verdict.HOLDS


@pytest.mark.parametrize("field", ["transform_tcp_to_base", "hand_position_in_base_m"])
def test_what_is_not_finite_is_no_evidence(field: str, visit: Trace) -> None:
    ticks = visit.ticks.copy()
    ticks[field][len(ticks) // 2] = np.nan
    assert NO_ALARM.evaluate(replace(visit, ticks=ticks)).verdict is Verdict.INCONCLUSIVE
