"""A decision costs declared simulated time, in both worlds, alone or among many; the wall's clock none."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples import VISIT, hand, scenario
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from safety_harness.admission.admit import Admitted, admit
from safety_harness.admission.trial import run_kinematic, run_many, run_trial
from safety_harness.base.exceptions import FlakyAvoiderError, InadmissibleError, NoAnswerError
from safety_harness.base.settings import DEFAULTS, DecisionCost, DecisionTimes, Measured, Settings
from safety_harness.cell.avoidance.avoider import Proposal
from safety_harness.cell.avoidance.flaky import refuse_flaky
from safety_harness.cell.controller.cycle import QUESTION, answer_after
from safety_harness.cell.controller.decision_times import decision_times_s
from safety_harness.cell.controller.records import parameters_dtype
from safety_harness.scenario.fault_table import fault_table
from safety_harness.scenario.faults import AvoiderLate
from safety_harness.scenario.model import Scenario
from safety_harness.scenario.moves import MoveTo, Wait
from safety_harness.trace.compare import first_difference
from safety_harness.trace.records import Check, DecisionOutcome
from safety_harness.trace.store import load_trace, save_trace
from safety_harness.trace.trace import Trace

STAYS = hand(MoveTo(position_in_base_m=(0.79, -0.27, 0.3), speed_mps=1.0), Wait(duration_s=9.0))
PERIOD_S = DEFAULTS.clock.control_period_s
World = Callable[[Admitted], Trace]


class Upwards:
    """100 mm up, and what it declares; before an answer it may sleep."""

    name = "upwards"

    def __init__(self, decision_time_s: float | None = None, sleeps_s: float = 0.0) -> None:
        self.decision_time_s = decision_time_s
        self.sleeps_s = sleeps_s
        self.asked = 0

    def propose(self, *, tcp_position_in_base_m: np.ndarray, **rest: object) -> Proposal:
        self.asked += 1
        if self.asked <= 4:
            time.sleep(self.sleeps_s)
        return Proposal(tcp_position_in_base_m + [0.0, 0.0, 0.1])


def alone_among_many(admitted: Admitted) -> Trace:
    return next(run_many([admitted]))


WORLDS = {"PyBullet": run_trial, "kinematic": run_kinematic, "many": alone_among_many}
each_world = pytest.mark.parametrize("world", WORLDS.values(), ids=WORLDS)


def costing(cost: DecisionCost | DecisionTimes, wall_limit_s: float = 30.0) -> Settings:
    return replace(
        DEFAULTS,
        avoidance=replace(DEFAULTS.avoidance, decision_time=cost),
        clock=replace(DEFAULTS.clock, wall_limit_s=wall_limit_s),
    )


def drawn_from(*quantiles_s: float, measured: Measured | None = None) -> DecisionTimes:
    return DecisionTimes(quantiles_s=quantiles_s, measured=measured)


def visit(settings: Settings = DEFAULTS, seed: int = 1) -> Scenario:
    return scenario(VISIT, duration_s=1.6, settings=settings, seed=seed)


@each_world
def test_an_avoider_that_declares_90_ms_loses_90_ms_of_the_hand_s_approach(world: World) -> None:
    free = world(admit(visit(), avoider=Upwards()))
    slow = world(admit(visit(), avoider=Upwards(0.09)))
    before, after = free.decisions[0], slow.decisions[0]
    assert after["asked_tick"] == before["tick"] == before["asked_tick"]
    assert after["tick"] - before["tick"] == 12  # the first tick at which 90 ms are over
    assert (before["decision_time_s"], after["decision_time_s"]) == (0.0, 0.09)
    hands = slow.ticks["hand_position_in_base_m"][:, 0]
    came_m = np.linalg.norm(hands[after["tick"]] - hands[before["tick"]])
    assert came_m == pytest.approx(1.0 * 12 * PERIOD_S, rel=0.05)  # at 1 m/s
    nearer = (
        slow.ticks["hand_distance_m"][after["tick"], 0] - free.ticks["hand_distance_m"][before["tick"], 0]
    )
    assert -came_m - 0.01 < nearer < -0.5 * came_m
    assert slow.ticks["hand_distance_m"].min() < free.ticks["hand_distance_m"].min() - 0.005


def test_the_worlds_and_many_at_once_decide_alike() -> None:
    cost = costing(drawn_from(0.005, 0.02, 0.06))
    many = [admit(replace(visit(cost, seed), hands=(STAYS,)), avoider=Upwards()) for seed in range(3)]
    together = list(run_many(many))
    for admitted, trace in zip(many, together, strict=True):
        assert first_difference(trace, run_kinematic(admitted)) is None
        other = run_trial(admitted)
        for name in ("asked_tick", "tick", "decision_time_s", "outcome"):
            np.testing.assert_array_equal(trace.decisions[name][:1], other.decisions[name][:1])
    assert len({float(trace.decisions["decision_time_s"][0]) for trace in together}) == 3


@each_world
def test_the_wall_s_clock_changes_no_bit(world: World) -> None:
    quick = world(admit(visit(), avoider=Upwards()))
    slow = world(admit(visit(), avoider=Upwards(sleeps_s=0.15)))
    assert slow.decision_latency_s[0] > 0.1  # it did take longer than the decision deadline
    assert first_difference(quick, slow) is None
    assert slow.decisions["fault"][0] == ""


@each_world
def test_the_question_is_of_when_it_was_asked_and_the_gate_s_of_when_it_counts(world: World) -> None:
    seen: list[tuple[float, ...]] = []

    class Notes(Upwards):
        def propose(self, *, tcp_position_in_base_m: np.ndarray, **rest: object) -> Proposal:
            seen.append(tuple(tcp_position_in_base_m))
            return super().propose(tcp_position_in_base_m=tcp_position_in_base_m)

    trace = world(admit(visit(), avoider=Notes(0.05)))
    first = trace.decisions[0]
    asked = trace.ticks["transform_tcp_to_base"][first["asked_tick"], :3, 3]
    assert seen[1] == pytest.approx(asked, abs=1e-12)  # after the rehearsal
    counts = trace.ticks["transform_tcp_to_base"][first["tick"], :3, 3]
    assert first["tcp_position_in_base_m"] == pytest.approx(counts, abs=1e-12)
    assert np.linalg.norm(asked - counts) > 1e-4


@each_world
def test_above_the_deadline_there_is_no_answer_and_nobody_is_asked(world: World) -> None:
    avoider = Upwards(0.11)
    trace = world(admit(visit(), avoider=avoider))
    first = trace.decisions[0]
    assert (first["proposed_failed"], first["outcome"]) == (Check.LATE, DecisionOutcome.OPPOSITE)
    assert first["fault"] == "no answer within 100 ms"
    assert first["tick"] - first["asked_tick"] == 13
    assert avoider.asked == 1  # the rehearsal


def test_a_fault_s_delay_comes_on_top() -> None:
    faulty = replace(visit(), faults=(AvoiderLate(delay_s=0.03),))
    trace = run_kinematic(admit(faulty, avoider=Upwards(0.05)))
    assert trace.decisions["tick"][0] - trace.decisions["asked_tick"][0] == 10
    over = run_kinematic(admit(faulty, avoider=Upwards(0.08)))
    assert over.decisions["proposed_failed"][0] == Check.LATE


@given(ticks=st.integers(0, 2_000), period_us=st.integers(1_000, 50_000), beyond=st.floats(1e-6, 0.999))
@hypothesis_settings(max_examples=200, deadline=None)
def test_an_exact_multiple_of_the_period_is_that_many_ticks(
    ticks: int, period_us: int, beyond: float
) -> None:
    parameters, question, nothing = np.zeros(1, parameters_dtype(6)), np.zeros(1, QUESTION), fault_table(())
    parameters["control_period_s"] = period_us / 1e6
    parameters["decision_deadline_s"] = 1e6
    answer_after(parameters, question, nothing, ticks * period_us / 1e6)
    assert question["counts_from"][0] == ticks
    answer_after(parameters, question, nothing, (ticks + beyond) * period_us / 1e6)
    assert question["counts_from"][0] == ticks + 1


def test_at_the_deadline_an_answer_is_in_time() -> None:
    trace = run_kinematic(admit(visit(), avoider=Upwards(0.1)))
    assert trace.decisions["fault"][0] == ""
    assert trace.decisions["tick"][0] - trace.decisions["asked_tick"][0] == 13


def test_the_settings_come_before_what_the_avoider_declares() -> None:
    trace = run_kinematic(admit(visit(costing(drawn_from(0.016))), avoider=Upwards(0.09)))
    assert trace.decisions["tick"][0] - trace.decisions["asked_tick"][0] == 2


def test_what_is_drawn_is_the_seed_s_anew_for_each_decision_and_within_the_quantiles() -> None:
    cost, n = drawn_from(0.001, 0.002, 0.010), 20_000
    times_s = decision_times_s(cost, 0.0, 5, n)
    np.testing.assert_array_equal(times_s, decision_times_s(cost, 0.0, 5, n))
    assert not np.array_equal(times_s, decision_times_s(cost, 0.0, 6, n))
    assert (times_s.min(), times_s.max()) == pytest.approx((0.001, 0.010), abs=1e-5)
    assert np.mean(times_s < 0.002) == pytest.approx(0.5, abs=0.02)  # between quantiles alike
    assert np.mean(times_s < 0.006) == pytest.approx(0.75, abs=0.02)


def test_an_avoider_that_declares_no_time_is_refused() -> None:
    with pytest.raises(InadmissibleError, match="an avoider that declares a time"):
        admit(visit(), avoider=Upwards(-0.1))


def test_a_profile_is_that_of_the_avoider_that_is_asked() -> None:
    own = Measured(avoider="opposite pose", sha256="", machine="a machine", questions=100)
    admit(visit(costing(drawn_from(0.0, 0.01, measured=own))))
    for wrong in (replace(own, avoider="nearest candidate"), replace(own, sha256="ab")):
        with pytest.raises(InadmissibleError, match="a profile of opposite pose"):
            admit(visit(costing(drawn_from(0.0, 0.01, measured=wrong))))


class Hangs(Upwards):
    """Answers the rehearsal, and then nothing any more."""

    def propose(self, *, tcp_position_in_base_m: np.ndarray, **rest: object) -> Proposal:
        self.asked += 1
        while self.asked > 1:
            time.sleep(0.01)
        return Proposal(tcp_position_in_base_m + [0.0, 0.0, 0.1])


@each_world
def test_one_that_hangs_ends_the_run_and_there_is_no_trace_of_it(world: World) -> None:
    admitted = admit(visit(costing(DecisionCost.AS_DECLARED, wall_limit_s=0.2)), avoider=Hangs())
    with pytest.raises(NoAnswerError, match=r"'upwards' gave no answer within 0\.2 s of wall time"):
        world(admitted)


class ByTheClock(Upwards):
    """Takes 30 ms, then more than the deadline, then next to nothing."""

    def propose(self, **question: np.ndarray) -> Proposal:
        time.sleep({2: 0.03, 3: 0.13}.get(self.asked + 1, 0.0))
        return super().propose(**question)


@pytest.mark.parametrize("world", [run_trial, run_kinematic])
def test_by_the_wall_s_clock_an_answer_costs_what_it_took_and_the_record_repeats_it(
    world: Callable[..., Trace], tmp_path: Path
) -> None:
    what = scenario(STAYS, duration_s=2.5, settings=costing(DecisionCost.WALL_CLOCK))
    trace = world(admit(what, avoider=ByTheClock()))
    first, second = trace.decisions[0], trace.decisions[1]
    assert first["decision_time_s"] == trace.decision_latency_s[0] > 0.03
    waits = first["tick"] - first["asked_tick"]
    assert (waits - 1) * PERIOD_S < first["decision_time_s"] <= waits * PERIOD_S
    assert second["proposed_failed"] == Check.LATE
    assert second["decision_time_s"] > 0.1
    save_trace(trace, tmp_path / "wall.trace")
    stored = load_trace(tmp_path / "wall.trace")
    repeated = world(admit(stored.scenario, avoider=Upwards(sleeps_s=0.05)), recorded=stored)
    assert first_difference(stored, repeated) is None


def test_by_the_wall_s_clock_many_at_once_are_refused() -> None:
    admitted = admit(visit(costing(DecisionCost.WALL_CLOCK)), avoider=Upwards())
    with pytest.raises(InadmissibleError, match="these runs have to repeat"):
        list(run_many([admitted]))


class Counts(Upwards):
    """Another answer to every question."""

    def propose(self, **question: np.ndarray) -> Proposal:
        proposal = super().propose(**question)
        return Proposal(proposal.position_in_base_m + [0.0, 0.0, 1e-4 * self.asked])


def test_an_avoider_is_asked_again_what_it_was_asked_then() -> None:
    sound = run_trial(admit(visit(), avoider=Upwards(0.05)))
    refuse_flaky(Upwards(0.05), sound)
    flaky = Counts(0.05)
    with pytest.raises(FlakyAvoiderError):
        refuse_flaky(flaky, run_trial(admit(visit(), avoider=flaky)))
