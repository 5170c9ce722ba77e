"""What a reader sees of a decision that was refused, or that an avoider spoilt."""

from __future__ import annotations

from dataclasses import replace

import factory
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from safety_harness.report.decisions import (
    MOST_FAULT_NOTES,
    DecisionTally,
    avoiders,
    decision_rows,
    failed_checks,
    fault_notes,
    latency_words,
)
from safety_harness.report.words import CHECK_MEANINGS, failed_words, flag_words, spread_words
from safety_harness.trace.records import Check, DecisionOutcome
from safety_harness.trace.trace import Trace

FAULT = "ZeroDivisionError: <b>division</b> (mine.py:3)"


def changed(**fields: object) -> Trace:
    trace = factory.holds_run().trace
    decisions = trace.decisions.copy()
    for name, values in fields.items():
        decisions[name] = values
    return replace(trace, decisions=decisions)


def test_each_check_of_the_gate_is_named_in_words() -> None:
    every = Check.UNCERTAIN | Check.NEAR_REACH_LIMIT | Check.TOWARDS_A_HAND | Check.ROBOT_ITSELF
    words = failed_words(every, Check.TOWARDS_A_HAND)
    assert words == (
        "proposed: uncertain, near reach limit, towards a hand, robot itself; opposite: towards a hand"
    )
    assert failed_words(Check.NOT_FINITE, Check.NONE, "it broke") == "proposed: not finite; fault: it broke"


def test_every_check_has_a_meaning_in_words() -> None:
    assert set(CHECK_MEANINGS) == {check for check in Check if check}
    assert len({flag_words(check) for check in CHECK_MEANINGS}) == len(CHECK_MEANINGS)


def test_the_checks_that_failed_in_a_run_are_explained_and_no_others() -> None:
    named = [name for name, _ in failed_checks(factory.holds_run().trace)]
    assert named == ["unreachable", "path unreachable", "table"]
    assert failed_checks(factory.no_hands_run().trace) == []


def test_the_largest_axis_of_a_spread_is_shown_against_its_threshold_if_there_is_one() -> None:
    spreads = [[0.003, 0.011, 0.004], [0.011, 0.0, 0.001], [np.nan] * 3]
    rows = decision_rows(changed(proposed_spread_m=spreads, spread_threshold_m=[0.0095, np.nan, 0.02]))
    assert [row.spread for row in rows] == ["11.0 > 9.5", "11.0, no threshold", "\u2013"]
    rows = decision_rows(changed(proposed_spread_m=0.0, spread_threshold_m=[0.01, np.nan, np.nan]))
    assert [row.spread for row in rows] == ["0.0 \u2264 10.0", "", ""]


@given(
    spread_m=st.floats(0.0, 1.0),
    threshold_m=st.floats(0.0, 1.0),
    ulps=st.none() | st.integers(-3, 3),
)
def test_a_spread_above_its_threshold_never_looks_like_one_that_is_not(
    spread_m: float, threshold_m: float, ulps: int | None
) -> None:
    if ulps is not None:
        spread_m = max(0.0, threshold_m * (1.0 + ulps * 1e-7))
    words = spread_words(np.array([0.0, spread_m, 0.0]), threshold_m)
    assert (">" in words) == (spread_m > threshold_m)
    shown, allowed = (float(word) for word in words.replace("\u2264", ">").split(" > "))
    if abs(spread_m - threshold_m) > 1e-9:
        assert (shown > allowed) == (spread_m > threshold_m)


def test_the_outcomes_of_all_runs_are_counted_together() -> None:
    faulty = changed(fault=["", FAULT, ""])
    traces = [faulty, factory.no_hands_run().trace, factory.holds_run().trace]
    tally = DecisionTally.from_traces(traces)
    assert (tally.made, tally.proposed, tally.opposite, tally.stops, tally.faults) == (6, 2, 2, 2, 1)
    assert DecisionTally.from_traces([]).made == 0
    assert avoiders(traces) == [("opposite", 3)]


def test_what_went_otherwise_than_proposed_is_said_and_nothing_else() -> None:
    tally = DecisionTally.from_traces(
        [changed(outcome=int(DecisionOutcome.OPPOSITE), fault=[FAULT, FAULT, ""])]
    )
    assert tally.departures == ["3 of 3 decisions fell back to the opposite pose"]
    assert tally.fault_words == "2 faults"
    calm = DecisionTally.from_traces([changed(outcome=int(DecisionOutcome.PROPOSED))])
    assert (calm.departures, calm.fault_words) == ([], "")


def test_the_time_that_decisions_took_is_shown_but_none_that_was_not_measured() -> None:
    trace = factory.holds_run().trace
    timed = replace(trace, decision_latency_s=np.array([0.0001, 0.0123, 0.0002]))
    assert latency_words(timed) == "median decision 0.2 ms, slowest decision 12 ms"
    replayed = replace(trace, decision_latency_s=np.array([0.0, 0.0, 0.0002]))
    assert latency_words(replayed) == "slowest decision 0.2 ms"
    assert latency_words(replace(trace, decision_latency_s=np.zeros(3))) == ""
    assert latency_words(factory.no_hands_run().trace) == ""


def test_a_run_without_faults_has_no_note_of_them() -> None:
    assert fault_notes(factory.holds_run().trace) == []
    assert fault_notes(factory.no_hands_run().trace) == []


def test_faults_are_counted_and_the_first_of_each_kind_has_its_time() -> None:
    trace = changed(fault=["", FAULT, FAULT])
    (note,) = fault_notes(trace)
    first = trace.decisions["time_s"][1]
    assert note == f"The avoider gave no usable answer (2 of 3 decisions, first at {first:.3f} s): {FAULT}"


def test_many_kinds_of_faults_do_not_fill_the_page() -> None:
    trace = factory.holds_run().trace
    decisions = np.repeat(trace.decisions[:1], 40)
    decisions["fault"] = [f"fault {number}" for number in range(40)]
    found = fault_notes(replace(trace, decisions=decisions))
    assert len(found) == MOST_FAULT_NOTES + 1
    assert found[-1].startswith("and in 35 other ways")
