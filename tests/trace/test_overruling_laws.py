"""How often the gate overrules, counted once more by a loop over the decisions."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from math import isnan

import numpy as np
import pytest
from examples import VISIT, Displaced, Raising, TowardsTheHand, run, scenario
from hypothesis import given
from hypothesis import strategies as st

from safety_harness.trace.overruling import REASONS, Overruling, answered, overruled
from safety_harness.trace.records import DECISION, Check, DecisionOutcome
from safety_harness.trace.trace import Trace

FLAGS = sum(Check)
A_DECISION = st.tuples(
    st.sampled_from(DecisionOutcome),
    st.integers(0, FLAGS),
    st.sampled_from(["", "", "", "ZeroDivisionError"]),
    st.sampled_from([0.5, 0.5, 0.5, np.nan, -np.inf, 1e100]),
)
DECISIONS = st.lists(A_DECISION, max_size=12)
BARE = run(scenario(duration_s=0.1))
Made = list[tuple[DecisionOutcome, int, str, float]]


def deciding(made: Made) -> Trace:
    decisions = np.zeros(len(made), DECISION)
    for one, (outcome, failed, fault, z) in zip(decisions, made, strict=True):
        one["outcome"], one["proposed_failed"], one["fault"] = outcome, failed, fault
        one["proposed_position_in_base_m"] = (0.5, 0.0, z)
    return replace(BARE, decisions=decisions, decision_latency_s=np.zeros(len(made)))


def counted(made: Made) -> Overruling:
    proposals = replaced = stopped = 0
    reasons: Counter[Check] = Counter()
    for outcome, failed, fault, z in made:
        if fault or not abs(z) < 1e100:
            continue  # no answer is no proposal
        proposals += 1
        replaced += outcome is DecisionOutcome.OPPOSITE
        stopped += outcome is DecisionOutcome.STOP
        if outcome is not DecisionOutcome.PROPOSED:
            reasons.update(check for check in REASONS if failed & check)
    return Overruling(proposals, replaced, stopped, reasons)


@given(DECISIONS)
def test_counts_are_those_of_a_loop(made: Made) -> None:
    trace, expected = deciding(made), counted(made)
    found = Overruling.from_traces([trace])
    assert found == expected
    assert int(answered(trace).sum()) == expected.proposals
    assert int(overruled(trace).sum()) == found.overruled == expected.replaced + expected.stopped
    assert not np.any(overruled(trace) & ~answered(trace))
    if expected.proposals:
        assert found.share == (expected.replaced + expected.stopped) / expected.proposals
    else:
        assert isnan(found.share)


@given(st.lists(DECISIONS, max_size=4))
def test_several_runs_count_as_if_all_decisions_were_of_one(runs: list[Made]) -> None:
    together = Overruling.from_traces(deciding(made) for made in runs)
    assert together == Overruling.from_traces([deciding([one for made in runs for one in made])])
    assert together == sum((counted(made) for made in runs), Overruling())


def test_no_answer_and_lateness_are_no_reason_to_overrule() -> None:
    assert {*REASONS, Check.NONE, Check.NOT_FINITE, Check.LATE} == {Check.NONE, *Check}
    assert Check.NOT_FINITE not in REASONS
    assert Check.LATE not in REASONS


@pytest.mark.parametrize(
    ("avoider", "proposals", "share", "reason"),
    [
        (TowardsTheHand(), 1, 1.0, Check.TOWARDS_A_HAND),
        (Displaced((0.0, 0.05, 0.08), spread_m=0.03, spread_threshold_m=0.02), 1, 1.0, Check.UNCERTAIN),
        (Displaced((0.0, 0.05, 0.08)), 1, 0.0, None),
    ],
    ids=["towards", "in-doubt", "used"],
)
def test_a_run_says_why_its_avoider_was_overruled(
    avoider: Displaced | TowardsTheHand, proposals: int, share: float, reason: Check | None
) -> None:
    found = Overruling.from_traces([run(scenario(VISIT), avoider=avoider)])
    assert found.proposals >= proposals
    assert found.share == share
    assert found.overruled == found.replaced
    assert (found.reasons[reason] == found.proposals) if reason else not found.reasons


def test_of_an_avoider_that_never_answers_nothing_is_overruled() -> None:
    trace = run(scenario(VISIT, duration_s=1.5), avoider=Raising())
    assert len(trace.decisions) > 0
    assert Overruling.from_traces([trace]) == Overruling()
    assert not overruled(trace).any()
