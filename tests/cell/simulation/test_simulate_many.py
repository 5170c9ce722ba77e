"""Many episodes at once are the same traces as one by one, whatever the order, the chunk or the avoider."""

from __future__ import annotations

import tracemalloc
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from examples import VISIT, Displaced, hand, scenario

from safety_harness.admission.admit import Admitted, admit
from safety_harness.admission.trial import run_kinematic, run_many, slower_because
from safety_harness.base.exceptions import AvoiderError
from safety_harness.cell.avoidance.avoider import Avoider, Proposal
from safety_harness.claims.properties.answered import DecisionTime
from safety_harness.claims.properties.finite import FiniteTrace
from safety_harness.scenario.faults import AvoiderLate, AvoiderNaN, AvoiderSilent, HandSensorBlind
from safety_harness.scenario.model import Scenario, Verdict
from safety_harness.scenario.moves import MoveTo, ReachForTcp, Wait, Wander, Withdraw
from safety_harness.scenario.read import read_scenario
from safety_harness.trace.compare import first_difference
from safety_harness.trace.records import Check
from safety_harness.trace.trace import Trace

SCENARIOS = Path(__file__).parents[3] / "scenarios"
REACH = hand(
    Wait(duration_s=0.1),
    ReachForTcp(speed_mps=1.0, until_distance_m=0.2, at_most_s=1.0),
    Withdraw(speed_mps=1.0),
)
WANDER = hand(
    Wander(speed_mps=0.6, corners_in_base_m=((0.6, -0.6, 0.1), (1.1, -0.2, 0.6)), duration_s=1.5),
    at=(1.0, -0.6, 0.3),
)
OTHER = hand(MoveTo(position_in_base_m=(0.85, 0.3, 0.3), speed_mps=1.2), at=(1.2, 0.8, 0.3), name="left")


def varied() -> list[Scenario]:
    """Short and long, with and without hands, faults of the avoider, decisions of every kind."""
    late = (AvoiderLate(from_s=0.0, for_s=2.0, delay_s=0.05),)
    silent = (AvoiderSilent(from_s=0.0, for_s=2.0),)
    says_nan = (AvoiderNaN(from_s=0.0, for_s=2.0),)
    blind = (HandSensorBlind(from_s=0.3, for_s=0.3),)
    return [
        scenario(VISIT, duration_s=1.6, seed=3),
        scenario(duration_s=0.4),
        scenario(REACH, duration_s=1.4, seed=5, avoider="mc-dropout"),
        replace(scenario(VISIT, duration_s=1.2, avoider="mc-dropout"), faults=late),
        replace(scenario(VISIT, duration_s=1.2, avoider="mc-dropout"), faults=silent),
        replace(scenario(VISIT, duration_s=1.2, avoider="mc-dropout"), faults=says_nan),
        replace(scenario(REACH, duration_s=1.2), faults=blind),
        scenario(VISIT, OTHER, duration_s=1.6, seed=9, avoider="mc-dropout"),
        scenario(WANDER, duration_s=1.5, seed=11, avoider="nearest candidate"),
        scenario(REACH, duration_s=1.4, seed=6, avoider="mc-dropout"),
    ]


@pytest.fixture(scope="module")
def episodes() -> list[Admitted]:
    return [admit(what) for what in varied()]


@pytest.fixture(scope="module")
def one_by_one(episodes: list[Admitted]) -> list[Trace]:
    return [run_kinematic(admitted) for admitted in episodes]


def assert_same(found: Sequence[Trace], expected: Sequence[Trace]) -> None:
    assert len(found) == len(expected)
    for one, other in zip(found, expected, strict=True):
        difference = first_difference(one, other)
        assert difference is None, f"{one.scenario.name}: {difference}"
        assert one.ticks.tobytes() == other.ticks.tobytes()
        assert one.scenario == other.scenario
        assert one.provenance == other.provenance
        assert one.complete


def test_the_examples_decide_in_every_way(one_by_one: list[Trace]) -> None:
    made = np.concatenate([trace.decisions for trace in one_by_one])
    assert set(made["outcome"]) >= {0, 1}
    assert {int(Check.LATE), int(Check.NOT_FINITE)} <= set(made["proposed_failed"])
    assert min(len(trace.decisions) for trace in one_by_one) == 0


@pytest.mark.parametrize("ticks_at_once", [1, 400, 100_000])
def test_in_chunks_of_any_size_they_are_the_same_bits(
    episodes: list[Admitted], one_by_one: list[Trace], ticks_at_once: int
) -> None:
    assert_same(list(run_many(episodes, ticks_at_once=ticks_at_once)), one_by_one)


def test_in_any_order_they_are_the_same_bits(episodes: list[Admitted], one_by_one: list[Trace]) -> None:
    order = np.random.default_rng(1).permutation(len(episodes))
    assert_same(list(run_many([episodes[k] for k in order])), [one_by_one[k] for k in order])


def test_no_scenarios_are_no_traces() -> None:
    assert list(run_many([])) == []


@pytest.mark.parametrize(
    "name",
    [
        "cornered",
        "lost-between-two-hands",
        "camera-30-hz",
        "fault-camera-knocked",
        "fault-joint-stuck",
        "recorded-handover-two-hands",
        "robot-ur3",
    ],
)
def test_shipped_scenarios_are_the_same_bits(name: str) -> None:
    what = read_scenario(SCENARIOS / f"{name}.yaml")
    admitted = admit(replace(what, duration_s=min(what.duration_s, 8.0)))
    assert_same(list(run_many([admitted, admitted])), [run_kinematic(admitted)] * 2)


def test_scenarios_are_taken_as_they_are_needed_and_the_memory_is_bounded() -> None:
    what = admit(scenario(REACH, duration_s=1.0))
    taken = 0

    def endless() -> object:
        nonlocal taken
        while True:
            taken += 1
            yield what

    traces = run_many(endless(), ticks_at_once=500)  # type: ignore[arg-type]
    next(traces)
    assert taken <= 5
    for _ in range(8):
        next(traces)
    tracemalloc.start()
    for _ in range(8):
        next(traces)
    _, early = tracemalloc.get_traced_memory()
    for _ in range(80):
        next(traces)
    _, late = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert late < 1.3 * early


@dataclass
class Batch:
    """Displaces the TCP by what its seed says; counts how it is asked."""

    answer: str = "right"
    together: int = 0
    in_turn: int = 0
    name: str = "batch"

    def propose(
        self, *, hand_position_in_base_m: np.ndarray, tcp_position_in_base_m: np.ndarray, seed: int
    ) -> Proposal:
        self.in_turn += 1
        return Proposal(tcp_position_in_base_m + [0.0, 0.001 * (seed % 50), 0.05], np.full(3, 0.001))

    def propose_many(
        self, hands: np.ndarray, tcps: np.ndarray, seeds: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        self.together += 1
        if self.answer == "raises":
            raise AvoiderError("no more")
        if self.answer == "breaks":
            raise ZeroDivisionError
        shift = np.stack([0.0 * seeds, 0.001 * (seeds % np.uint64(50)), 0.0 * seeds + 0.05], axis=1)
        positions = tcps + shift
        if self.answer == "shape":
            positions = positions[:, :2]
        return positions, np.full(tcps.shape, 0.001)


def with_avoider(avoider: Avoider) -> list[Admitted]:
    return [admit(scenario(REACH, duration_s=1.2, seed=seed), avoider=avoider) for seed in range(4)]


def test_an_avoider_that_takes_many_questions_is_asked_for_all_at_once() -> None:
    avoider = Batch()
    expected = [run_kinematic(one) for one in with_avoider(avoider)]
    avoider.in_turn = 0
    many = with_avoider(avoider)
    avoider.in_turn = 0
    assert_same(list(run_many(many)), expected)
    decisions = sum(len(trace.decisions) for trace in expected)
    assert avoider.in_turn == 0
    assert 0 < avoider.together < decisions
    assert slower_because(avoider) == ""


@pytest.mark.parametrize("answer", ["raises", "breaks", "shape"])
def test_a_batch_that_fails_is_asked_in_turn(answer: str) -> None:
    expected = [run_kinematic(one) for one in with_avoider(Batch())]
    assert_same(list(run_many(with_avoider(Batch(answer)))), expected)


def test_a_batch_has_no_time_of_its_own_on_the_clock_and_nothing_is_claimed_of_it() -> None:
    for trace in run_many(with_avoider(Batch())):
        assert len(trace.decisions) > 0
        assert np.isnan(trace.decision_latency_s).all()
        evaluation = DecisionTime(within_s=1.0).evaluate(trace)
        assert evaluation.verdict is Verdict.INCONCLUSIVE
        assert FiniteTrace().evaluate(trace).verdict is Verdict.HOLDS


def test_an_avoider_that_takes_one_question_is_asked_in_turn_and_says_so() -> None:
    avoider = Displaced((0.0, 0.0, 0.05))
    assert slower_because(avoider) == "displaced gets one question after another: it has no propose_many"
    many = with_avoider(avoider)
    found = list(run_many(many))
    assert_same(found, [run_kinematic(one) for one in many])
    assert all((trace.decision_latency_s > 0.0).all() for trace in found)


class Nonsense(Batch):
    """Its second answer of a batch is not a number."""

    def propose_many(
        self, hands: np.ndarray, tcps: np.ndarray, seeds: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        positions, spreads = super().propose_many(hands, tcps, seeds)
        positions[1:] = np.nan
        return positions, spreads


def test_an_answer_of_a_batch_that_is_no_number_is_that_decisions_fault_alone() -> None:
    found = list(run_many(with_avoider(Nonsense())))
    faults = [trace.decisions["fault"][0] for trace in found]
    assert faults[0] == ""
    assert all(fault.startswith("the proposed position is not finite") for fault in faults[1:])
