"""A fault of an avoider on the page of a run."""

from __future__ import annotations

from datetime import UTC, datetime

import factory
from page import parse

from safety_harness.extensions.pages.run_page import render
from safety_harness.report.decisions import fault_notes
from safety_harness.report.evidence import JudgedRun
from tests.report.test_decision_words import FAULT, changed


def test_the_page_has_the_fault_above_its_decisions_beside_its_own_and_in_the_table_of_verdicts() -> None:
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
    banners = section.all("div", "banner")
    assert [note in banner.text for banner in banners] == [True]
    assert section.all("span", "grave")[0].text == "1 fault"
    (first, *_) = parse(page).all("table", "verdicts")[0].all("tbody")[0].all("th")
    assert first.all("span", "grave")[0].text == "1 fault"
    row = section.all("table", "decisions")[0].all("tbody")[0].all("tr")[1]
    assert f"fault: {FAULT}" in row.text
