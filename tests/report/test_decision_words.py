"""What a reader sees of a decision that was refused, or that an avoider spoilt."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime

import factory
import numpy as np
from page import parse

from safety_harness.report.evidence import JudgedRun
from safety_harness.report.html import render
from safety_harness.report.view import MOST_FAULT_NOTES, decision_rows, fault_notes
from safety_harness.report.words import failed_words
from safety_harness.trace.records import Check
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


def test_a_spread_is_shown_with_what_it_may_be_if_there_is_a_threshold() -> None:
    rows = decision_rows(changed(spread_threshold_m=[0.0095, np.nan, 0.0]))
    assert [row.spread for row in rows] == [
        "11, 11, 11 (at most 9.5)",
        "11, 11, 11",
        "11, 11, 11 (at most 0.0)",
    ]


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


def test_the_page_has_the_fault_in_its_notes_and_beside_its_decision() -> None:
    run = factory.holds_run()
    faulty = JudgedRun(changed(fault=["", FAULT, ""]), run.evaluations, "again")
    page = render(
        [faulty],
        title="t",
        command="c",
        interrupted=False,
        generated_at=datetime(2025, 11, 21, tzinfo=UTC),
    )
    assert "<b>division</b>" not in page
    section = parse(page).one("run-1")
    (note,) = fault_notes(faulty.trace)
    assert note in section.text
    row = section.all("table", "decisions")[0].all("tbody")[0].all("tr")[1]
    assert f"fault: {FAULT}" in row.text
