"""Giving way is counted when the arm leaves its task, not at every decision."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

from examples import hand, run, scenario
from hypothesis import given
from hypothesis import strategies as st

from safety_harness.admission.claims import property_of
from safety_harness.claims.properties.reaction import GivesWayAtMost, gives_way_at
from safety_harness.scenario.model import Claim, Verdict
from safety_harness.scenario.moves import MoveTo, Wait, Withdraw
from safety_harness.trace.records import Mode
from safety_harness.trace.trace import Trace

TASK = {Mode.SERVOING, Mode.OBJECT_LOST}


@given(st.lists(st.tuples(st.sampled_from(Mode), st.integers(1, 60)), min_size=1, max_size=9))
def test_only_ways_out_of_the_task_count(visit: Trace, phases: list[tuple[Mode, int]]) -> None:
    modes = [mode for mode, ticks in phases for _ in range(ticks)]
    ticks = visit.ticks.copy()
    ticks["mode"] = (modes * (len(ticks) // len(modes) + 1))[: len(ticks)]
    edited = replace(visit, ticks=ticks)
    steps = pairwise([Mode.SERVOING, *(Mode(mode) for mode in ticks["mode"])])
    expected = sum(before in TASK and after not in TASK for before, after in steps)
    assert len(gives_way_at(edited)) == expected
    evaluation = GivesWayAtMost(most=3).evaluate(edited)
    if expected == 0:
        assert evaluation.verdict is Verdict.INCONCLUSIVE
    else:
        assert evaluation.margin == 3.0 - expected
        assert evaluation.verdict is (Verdict.HOLDS if expected <= 3 else Verdict.VIOLATED)


def test_a_hand_that_stays_makes_many_decisions_and_one_giving_way() -> None:
    stays = hand(MoveTo(position_in_base_m=(0.79, -0.27, 0.3), speed_mps=1.0), Wait(duration_s=9.0))
    trace = run(scenario(stays, duration_s=1.6))
    assert len(trace.decisions) > 1
    assert GivesWayAtMost(most=1).evaluate(trace).verdict is Verdict.HOLDS


def test_a_hand_that_comes_twice_makes_the_arm_give_way_twice() -> None:
    there = MoveTo(position_in_base_m=(0.84, -0.35, 0.25), speed_mps=1.5)
    twice = hand(there, Withdraw(speed_mps=1.5), Wait(duration_s=0.7), there, Withdraw(speed_mps=1.5))
    trace = run(scenario(twice, duration_s=4.0))
    first, second = gives_way_at(trace)
    once = GivesWayAtMost(most=1).evaluate(trace)
    assert (once.verdict, once.margin, once.worst_time_s) == (Verdict.VIOLATED, -1.0, trace.time_s[second])
    assert GivesWayAtMost(most=2).evaluate(trace).verdict is Verdict.HOLDS
    assert first < second


def test_once_is_one_time() -> None:
    sentence = "retreats at most 1 time"
    prop = property_of(Claim(sentence=sentence, expected=Verdict.HOLDS), scenario())
    assert prop == GivesWayAtMost(most=1)
    assert prop.sentence == sentence
