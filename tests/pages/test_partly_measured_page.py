"""A page on a run of which not all was measured: it says so, and draws nothing in its place."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import factory
import numpy as np
import pytest
from browsing import forget, show
from page import parse
from partly_measured import partly_measured

from safety_harness.claims.properties.base import Evaluation, inconclusive
from safety_harness.extensions.pages.replay import replay_data
from safety_harness.extensions.pages.run_page import render, write_report
from safety_harness.report.evidence import JudgedRun
from safety_harness.report.machine import report_data
from safety_harness.trace.known import COLUMNS_OF_A_TRACE, NOT_MEASURED, OF_DECISIONS
from safety_harness.trace.trace import Trace
from safety_harness.trace.unmeasured import knowing

WHEN = datetime(2025, 11, 21, 9, 30, tzinfo=UTC)
SAID = {"title": "Report", "command": "judge", "interrupted": False, "generated_at": WHEN}


def lacking(evaluation: Evaluation) -> Evaluation:
    no_verdict = inconclusive(evaluation, "not measured: mode", exercised=3)
    return replace(no_verdict, unmeasured=("mode",))


def partly() -> JudgedRun:
    run = factory.violated_run()
    evaluations = (lacking(run.evaluations[0]), *run.evaluations[1:])
    return replace(run, trace=partly_measured(run.trace), evaluations=evaluations)


def page(*runs: JudgedRun) -> str:
    return render(runs, title="Report", command="judge", interrupted=False, generated_at=WHEN)


def of_anything(trace: Trace) -> Trace:
    """Numbers where nothing was measured."""
    ticks, decisions = trace.ticks.copy(), trace.decisions.copy()
    for name in trace.known.missing(COLUMNS_OF_A_TRACE):
        field = name.removeprefix(OF_DECISIONS)
        values = (ticks if field == name else decisions)[field]
        values[...] = "x" if values.dtype.kind == "U" else 3
    return replace(trace, ticks=ticks, decisions=decisions)


def test_it_says_what_was_measured_and_whole_runs_need_not(tmp_path: Path) -> None:
    text = page(partly())
    assert "Measurements" in text
    assert "8 mm" in text
    assert "from 0.800 to 1.440 s of right hand" in text
    assert "It cannot be repeated" in text
    assert "Measurements" not in page(factory.violated_run())


def test_what_stands_where_nothing_was_measured_is_shown_nowhere() -> None:
    run = partly()
    other = replace(run, trace=of_anything(run.trace))
    assert page(other) == page(run)
    assert replay_data(other) == replay_data(run)


def test_modes_decisions_and_limits_are_not_measured_instead_of_none() -> None:
    text = page(partly())
    assert text.count("<p>Not measured.</p>") == 3
    assert "No limit acted." not in text
    assert "The run has no decision." not in text
    assert "protective stop 0 %" not in text
    assert "<dt>Decisions</dt><dd> not measured in 1 run</dd>" in text
    assert "For 1 claim, some inputs were not measured." in text


@pytest.mark.parametrize("first", range(4))
def test_any_column_may_be_lacking(first: int) -> None:
    columns = COLUMNS_OF_A_TRACE[first::4]
    run = factory.violated_run()
    run = replace(run, trace=knowing(run.trace, dict.fromkeys(columns, NOT_MEASURED)))
    with np.errstate(all="raise"):
        data = json.dumps(report_data([run], interrupted=False), allow_nan=False)
    assert all(f'"{column}"' in data for column in columns)
    article = page(run).partition("<article")[2].partition("</article>")[0]
    assert len(article) > 1_000
    assert re.search(r"\bnan\b", article, re.IGNORECASE) is None
    assert replay_data(run)["columns"]


def test_decisions_of_which_something_was_not_measured_have_a_dash_there() -> None:
    run = factory.violated_run()
    text = page(replace(run, trace=knowing(run.trace, {"decision.outcome": NOT_MEASURED})))
    assert "the results of decisions were not measured" in text
    (table,) = parse(text).all("table", "decisions")
    column = [cell.text for cell in table.all("thead")[0].all("th")].index("Outcome")
    rows = [row.all("th") + row.all("td") for row in table.all("tbody")[0].all("tr")]
    assert [row[column].text for row in rows] == ["\u2013"] * len(run.trace.decisions)


def test_claims_that_were_not_measured_are_told_apart_in_the_table_of_all_runs() -> None:
    data = report_data([partly()], interrupted=False)
    first = data["coverage"][0]
    assert (first["unmeasured"], first["exercised"], first["untested"]) == (1, 0, True)
    assert "(1 not measured)" in page(partly())
    assert "not measured" not in page(factory.violated_run())


@pytest.mark.parametrize("width", [390, 1280, 1920])
def test_it_fits_every_screen(browser: Any, tmp_path: Path, width: int) -> None:
    write_report(tmp_path / "report.html", [partly()], **SAID)  # type: ignore[arg-type]
    forget(browser)
    show(browser, (tmp_path / "report.html").as_uri(), width=width)
    assert browser.execute_script("return document.documentElement.scrollWidth") <= width
    heads = "return [...document.querySelectorAll('.measured tbody th')].map(e => e.offsetHeight)"
    assert len(browser.execute_script(heads)) == 7
    assert browser.get_log("browser") == []
