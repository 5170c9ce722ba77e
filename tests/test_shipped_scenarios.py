"""Every shipped scenario comes out as its file expects, and together they walk the whole state table."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from examples import shipped

from safety_harness import admit, judge, run_trial
from safety_harness.admission.avoiders import NAMES
from safety_harness.admission.trial import run_kinematic
from safety_harness.scenario.faults import EVERY_FAULT
from safety_harness.scenario.model import RecordedHand, Verdict
from safety_harness.scenario.robots import OwnRobot, Robot
from safety_harness.trace.records import Mode, Trigger
from safety_harness.trace.trace import Trace

SHIPPED = shipped()
S, R, P, L = Mode.SERVOING, Mode.REPULSING, Mode.PROTECTIVE_STOP, Mode.OBJECT_LOST


@lru_cache
def trace_of(name: str) -> Trace:
    return run_trial(admit(SHIPPED[name]))


RENDERED = pytest.param("rendered-images", marks=pytest.mark.long)  # "make oldest" runs it every day


@pytest.mark.parametrize("name", [RENDERED if name in RENDERED.values else name for name in SHIPPED])
def test_every_verdict_is_the_expected_one(name: str) -> None:
    trace = trace_of(name)
    assert trace.complete
    for claim, evaluation in zip(trace.scenario.claims, judge(trace), strict=True):
        assert evaluation.verdict is claim.expected, evaluation


@pytest.mark.parametrize(
    ("name", "before", "after"),
    [
        ("hand-visits-and-leaves", S, R),
        ("nothing-reachable", S, P),
        ("hand-visits-and-leaves", R, S),
        ("object-stays-lost", R, L),
        ("cornered", R, P),
        ("camera-30-hz", L, S),
        ("object-lost-and-found", L, R),
        ("nothing-reachable", P, S),
        ("cornered", P, S),
        ("lost-between-two-hands", L, P),
        ("lost-between-two-hands", P, L),
    ],
)
def test_a_row_of_the_state_table_happens_in_its_scenario(name: str, before: Mode, after: Mode) -> None:
    modes = trace_of(name).ticks["mode"]
    assert np.any((modes[:-1] == before) & (modes[1:] == after))


@pytest.mark.parametrize(
    ("name", "trigger"), [("hand-stays", Trigger.HAND_STILL_THERE), ("second-hand", Trigger.ANOTHER_HAND)]
)
def test_a_repulsion_follows_a_repulsion_for_the_stated_reason(name: str, trigger: Trigger) -> None:
    trace = trace_of(name)
    again = trace.decisions[trace.decisions["trigger"] == trigger]
    assert len(again) > 0
    assert np.all(trace.ticks["mode"][again["tick"] - 1] == R)
    assert np.all(trace.ticks["mode"][again["tick"]] == R)


def test_a_hand_that_returns_triggers_twice_from_servoing() -> None:
    assert np.sum(trace_of("hand-returns").decisions["trigger"] == Trigger.HAND_ENTERED) >= 2


def test_there_are_honest_violations_and_recorded_hands_among_them() -> None:
    scenarios = list(SHIPPED.values())
    assert len(scenarios) >= 25
    expected_violated = [s for s in scenarios if any(c.expected is Verdict.VIOLATED for c in s.claims)]
    assert len(expected_violated) >= 3
    recorded = [s for s in scenarios if any(isinstance(hand, RecordedHand) for hand in s.hands)]
    assert len({hand.recording for s in recorded for hand in s.hands if isinstance(hand, RecordedHand)}) == 6


FAULTY = [name for name in SHIPPED if name.startswith("fault-")]


def test_every_kind_of_fault_and_every_robot_is_in_a_shipped_scenario_and_acts_there() -> None:
    traces = [trace_of(name) for name in FAULTY]
    kinds = [type(fault) for trace in traces for fault in trace.scenario.faults]
    assert set(kinds) == set(EVERY_FAULT)
    for trace in traces:
        for k in range(len(trace.scenario.faults)):
            assert np.any(trace.ticks["faults"] >> k & 1), trace.scenario.name
    robots = {scenario.robot for scenario in SHIPPED.values()}
    assert robots >= set(Robot)
    own = {robot.label for robot in robots if isinstance(robot, OwnRobot)}
    assert own == {"iiwa14", "panda", "xarm6", "ur10e"}


def test_every_shipped_avoider_is_in_a_shipped_scenario() -> None:
    assert {scenario.avoider for scenario in SHIPPED.values()} == set(NAMES)


@pytest.mark.parametrize("name", FAULTY)
def test_what_a_fault_violates_is_not_violated_without_it(name: str) -> None:
    faulty = trace_of(name)
    healthy = run_kinematic(admit(replace(faulty.scenario, faults=())))
    for evaluation in judge(healthy):
        assert evaluation.verdict is not Verdict.VIOLATED, evaluation


def test_the_files_that_expect_a_violation_would_fail_if_they_expected_none() -> None:
    """The runs are judged, not believed: a wrong expectation is noticed."""
    trace = trace_of("fast-reach")
    claim, evaluation = trace.scenario.claims[0], judge(trace)[0]
    assert claim.expected is evaluation.verdict is Verdict.VIOLATED
    assert evaluation.margin is not None
    assert evaluation.margin < -0.05
