from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np

from safety_harness.trace.overruling import COUNTS, Overruling
from safety_harness.trace.records import Check, DecisionOutcome
from safety_harness.trace.trace import Trace
from tests.report import factory

TABLE_AND_DOUBT = int(Check.TABLE | Check.UNCERTAIN)


def decided(**fields: object) -> Trace:
    """Three decisions with other outcomes and checks."""
    trace = factory.holds_run().trace
    decisions = trace.decisions.copy()
    for name, values in fields.items():
        decisions[name] = values
    return replace(trace, decisions=decisions)


def test_a_proposal_that_fails_two_checks_is_overruled_once_for_two_reasons() -> None:
    outcomes = [
        int(one) for one in (DecisionOutcome.PROPOSED, DecisionOutcome.OPPOSITE, DecisionOutcome.STOP)
    ]
    trace = decided(
        proposed_position_in_base_m=0.5,
        outcome=outcomes,
        proposed_failed=[0, TABLE_AND_DOUBT, int(Check.UNCERTAIN)],
    )
    found = Overruling.from_traces([trace, trace])
    assert found == Overruling(6, 2, 2, Counter({Check.UNCERTAIN: 4, Check.TABLE: 2}))
    assert found.summary == (
        "overruled 4 of 6 proposals (66.7 %): 4 uncertain, 2 table; "
        "2 replaced by the opposite pose, 2 by a stop"
    )
    assert found.share == 4 / 6


def test_where_the_avoider_gave_no_answer_in_time_nothing_of_its_was_overruled() -> None:
    trace = decided(
        proposed_position_in_base_m=[[0.5] * 3, [np.nan] * 3, [0.5] * 3],
        fault=["it broke", "", ""],
        outcome=int(DecisionOutcome.STOP),
        proposed_failed=[int(Check.LATE), int(Check.NOT_FINITE), int(Check.TOWARDS_A_HAND)],
    )
    assert Overruling.from_traces([trace]) == Overruling(1, 0, 1, Counter({Check.TOWARDS_A_HAND: 1}))


def test_without_proposals_there_are_no_words_and_no_share() -> None:
    assert Overruling.from_traces([factory.no_hands_run().trace]) == Overruling()
    assert Overruling().summary == ""
    assert np.isnan(Overruling().share)
    assert Overruling(3).summary == "overruled 0 of 3 proposals (0 %)"
    assert Overruling(1, 0, 1).summary == "overruled 1 of 1 proposal (100 %); 1 replaced by a stop"


def test_plain_numbers_give_the_same_again() -> None:
    found = Overruling(9, 4, 2, Counter({Check.UNREACHABLE: 5, Check.ROBOT_ITSELF: 1}))
    assert Overruling.of_counts(found.counts) == found
    assert found.named["overruled"] == 6
    assert [name for name in COUNTS if found.named[name]] == [
        "proposals",
        "overruled_replaced",
        "overruled_stopped",
        "overruled_unreachable",
        "overruled_robot_itself",
    ]
