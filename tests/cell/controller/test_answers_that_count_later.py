"""A question whose answer counts later: when, about what, and of which hand if that has gone meanwhile."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bench import AWAY, Bench

from safety_harness.base.settings import DEFAULTS
from safety_harness.scenario.fault_table import fault_table
from safety_harness.scenario.faults import AvoiderLate, AvoiderSilent, Fault
from safety_harness.trace.records import Check, DecisionOutcome, Mode

PERIOD_S = DEFAULTS.clock.control_period_s
FORGETFUL = replace(DEFAULTS, hand_filter=replace(DEFAULTS.hand_filter, track_timeout_s=2.5 * PERIOD_S))


def bench_with(fault: Fault, bench: Bench) -> Bench:
    bench.controller.records = bench.controller.records._replace(faults=fault_table((fault,)))
    return bench


@pytest.mark.parametrize(
    ("delay_s", "ticks"), [(0.4 * PERIOD_S, 1), (PERIOD_S, 1), (1.5 * PERIOD_S, 2), (10 * PERIOD_S, 10)]
)
def test_an_answer_counts_at_the_first_tick_at_which_its_delay_is_over(delay_s: float, ticks: int) -> None:
    bench = bench_with(AvoiderLate(delay_s=delay_s), Bench())
    near = bench.beside(0.3)
    bench.tick(AWAY, count=3)
    asked = bench.tick(AWAY, near)
    assert (asked["mode"], asked["decision"]) == (Mode.SERVOING, -1)
    rows = [bench.tick(AWAY, near).copy() for _ in range(ticks + 2)]
    assert [row["decision"] for row in rows] == [-1] * (ticks - 1) + [0, -1, -1]
    assert [row["mode"] for row in rows] == [Mode.SERVOING] * (ticks - 1) + [Mode.REPULSING] * 3
    decision = bench.controller.decisions[0]
    assert decision["tick"] == 3 + ticks
    assert decision["time_s"] == pytest.approx((3 + ticks) * PERIOD_S)
    assert decision["outcome"] == DecisionOutcome.PROPOSED


def test_a_delay_of_seven_periods_lasts_seven_though_their_quotient_is_rounded_up() -> None:
    period_s, delay_s = 0.01, 0.07
    assert delay_s / period_s > 7.0
    settings = replace(DEFAULTS, clock=replace(DEFAULTS.clock, control_period_s=period_s))
    bench = bench_with(AvoiderLate(delay_s=delay_s), Bench(settings=settings))
    near = bench.beside(0.3)
    assert bench.tick(near, count=7)["decision"] == -1
    assert bench.tick(near)["decision"] == 0


def test_a_late_answer_is_to_the_question_of_then() -> None:
    bench = bench_with(AvoiderLate(delay_s=4 * PERIOD_S), Bench())
    near, tcp = bench.beside(0.3), bench.tcp.copy()
    bench.tick(near)
    bench.place(tcp + [0.0, 0.01, 0.02])
    bench.tick(near, count=4)
    decision = bench.controller.decisions[0]
    away = tcp - near
    expected = tcp + DEFAULTS.avoidance.radius_m * away / np.linalg.norm(away)
    assert decision["proposed_position_in_base_m"] == pytest.approx(expected, abs=2e-3)
    assert decision["tcp_position_in_base_m"] == pytest.approx(bench.tcp, abs=1e-12)


@pytest.mark.parametrize("fault", [AvoiderSilent(), AvoiderLate(delay_s=0.101)])
def test_what_comes_after_the_deadline_does_not_count_and_the_opposite_pose_does_at_the_deadline(
    fault: Fault,
) -> None:
    bench = bench_with(fault, Bench())
    near = bench.beside(0.3)
    ticks = int(np.ceil(DEFAULTS.avoidance.decision_deadline_s / PERIOD_S))
    assert bench.tick(near, count=ticks)["mode"] == Mode.SERVOING
    assert bench.tick(near)["mode"] == Mode.REPULSING
    decision = bench.controller.decisions[0]
    assert (decision["tick"], decision["proposed_failed"]) == (ticks, Check.LATE)
    assert decision["outcome"] == DecisionOutcome.OPPOSITE


def test_if_every_hand_has_gone_meanwhile_the_decision_is_about_the_one_of_the_question() -> None:
    bench = bench_with(AvoiderLate(delay_s=8 * PERIOD_S), Bench(settings=FORGETFUL))
    near = bench.beside(0.3)
    bench.tick(near)
    row = bench.tick(count=8)
    assert not row["track_valid"].any()
    assert row["decision"] == 0
    assert bench.controller.decisions[0]["hand_position_in_base_m"] == pytest.approx(near, abs=5e-3)


def test_a_fault_is_noted_at_every_tick_at_which_it_acts_and_at_no_other() -> None:
    bench = bench_with(AvoiderLate(delay_s=3 * PERIOD_S), Bench())
    near, acted = bench.beside(0.3), []
    for hands in ((AWAY,), (near,), (near,), (near,), (near,), (near,)):
        acted.append(bool(bench.tick(*hands)["faults"]))
    # from the question to the answer
    assert acted == [False, True, True, True, True, False]


def test_a_late_decision_is_about_the_nearest_hand_of_now_where_there_is_one() -> None:
    bench = bench_with(AvoiderLate(delay_s=6 * PERIOD_S), Bench())
    bench.tick(bench.beside(0.3))
    for k in range(6):
        row = bench.tick(bench.beside(0.3 - 0.01 * k))
    assert row["decision"] == 0
    decision = bench.controller.decisions[0]
    assert decision["hand_position_in_base_m"] == pytest.approx(row["predicted_hand_in_base_m"][0], abs=1e-12)
    assert np.linalg.norm(decision["hand_position_in_base_m"] - bench.beside(0.3)) > 0.03


def test_a_record_of_late_decisions_says_nothing_of_those_after_it() -> None:
    late, in_time = "no answer within 100 ms", ""
    bench = Bench(recorded_late=(late, in_time))
    near = bench.beside(0.15)
    for _ in range(3):
        bench.tick(near)
        bench.place(bench.controller.decisions[-1]["chosen_position_in_base_m"])
    decisions = bench.controller.decisions
    assert len(decisions) == 3
    assert decisions["fault"].tolist() == [late, "", ""]
    assert decisions["proposed_failed"].tolist() == [Check.LATE, Check.NONE, Check.NONE]
