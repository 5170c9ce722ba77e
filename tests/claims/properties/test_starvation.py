"""Time that the task loses adds up until the arm is nearer to its goal than before."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from itertools import groupby

import numpy as np
import pytest
from broken import hardly_leaves
from examples import VISIT, ConstantSpeed, hand, run, scenario

from safety_harness.cell.controller.desired import desired_transform_tcp_to_base
from safety_harness.claims.properties.servoing import NeverStarved, lost_ticks
from safety_harness.claims.signals.poses import pose_errors
from safety_harness.scenario.model import Verdict
from safety_harness.scenario.moves import MoveTo, Wait
from safety_harness.trace.records import Mode
from safety_harness.trace.trace import Trace

STAYS = hand(MoveTo(position_in_base_m=(0.79, -0.27, 0.3), speed_mps=1.0), Wait(duration_s=9.0))


@lru_cache
def does_nothing() -> Trace:
    return run(scenario(duration_s=2.0), controller=ConstantSpeed((0.0,) * 6))


def test_servoing_that_gets_on_loses_next_to_nothing() -> None:
    trace = run(scenario(duration_s=3.0))
    lost, away = lost_ticks(trace)
    assert lost.max() * 0.008 <= 0.1  # while it gets up to speed
    assert 0 < away.sum() < len(away)
    evaluation = NeverStarved(longest_s=1.0).evaluate(trace)
    assert (evaluation.verdict, evaluation.exercised) == (Verdict.HOLDS, int(away.sum()))


def test_a_controller_that_does_nothing_loses_all_the_time() -> None:
    lost, _ = lost_ticks(does_nothing())
    assert np.array_equal(lost, np.arange(len(lost)))
    evaluation = NeverStarved(longest_s=1.5).evaluate(does_nothing())
    assert (evaluation.verdict, evaluation.margin) == (Verdict.VIOLATED, pytest.approx(-0.5))


def test_a_run_that_is_not_longer_than_the_limit_is_no_evidence() -> None:
    for limit_s in (2.0, 3.0):
        evaluation = NeverStarved(longest_s=limit_s).evaluate(does_nothing())
        assert (evaluation.verdict, evaluation.exercised) == (Verdict.INCONCLUSIVE, 0)


def test_a_run_that_ends_while_the_task_is_starved_leaves_it_open() -> None:
    evaluation = NeverStarved(longest_s=1.9).evaluate(run(scenario(STAYS, duration_s=2.0)))
    assert evaluation.verdict is Verdict.INCONCLUSIVE
    assert "when the run ends" in evaluation.reason


def test_going_to_and_fro_starves_the_task_although_no_interruption_is_long() -> None:
    trace = hardly_leaves()
    away = [len(list(g)) for servoing, g in groupby(trace.ticks["mode"] == Mode.SERVOING) if not servoing]
    evaluation = NeverStarved(longest_s=2.5).evaluate(trace)
    assert len(away) >= 4
    assert max(away) * 0.008 < 2.2
    assert evaluation.verdict is Verdict.VIOLATED


def test_a_visit_costs_no_more_than_the_time_of_giving_way(visit: Trace) -> None:
    """And that of getting up to speed again; as much of it as the arm does not happen to come nearer in."""
    lost, away = lost_ticks(visit)
    repulsing = np.count_nonzero((visit.ticks["mode"] != Mode.SERVOING) & away) * 0.008
    assert 0.0 < lost.max() * 0.008 <= repulsing + 0.1
    assert lost[-1] == 0


def test_the_error_is_eq_15_s_for_an_upright_tcp() -> None:
    trace = run(scenario(VISIT, duration_s=1.0))
    distance_m, angle_rad = pose_errors(trace)
    assert np.hypot(distance_m, angle_rad) ** 2 == pytest.approx(trace.ticks["sse"], rel=1e-3, abs=1e-7)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-4, 0.3, 3.0])
def test_angles_of_the_pose_are_those_that_it_was_turned_by(angle: float, visit: Trace) -> None:
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    ticks = visit.ticks.copy()
    desired = desired_transform_tcp_to_base(visit.scenario.settings)[:3, :3]
    ticks["transform_tcp_to_base"][:, :3, :3] = desired @ turn
    distance_m, angle_rad = pose_errors(replace(visit, ticks=ticks))
    assert distance_m == pytest.approx(pose_errors(visit)[0])
    assert angle_rad == pytest.approx(np.full(len(ticks), angle), rel=1e-6, abs=1e-15)
