"""Many reports as one page: what turned, since which revision, and overruling that grows."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from page import parse
from typer.testing import CliRunner

from safety_harness.base.exceptions import InputError
from safety_harness.cli.main import app
from safety_harness.extensions.assurance.pages.history import read_history
from safety_harness.report.machine import FORMAT


def report(verdict: str, margin_m: float | None, overruled: int = 0) -> dict[str, Any]:
    claim = {
        "claim": "hands apart",
        "expected": "holds",
        "verdict": verdict,
        "margin_si": margin_m,
        "unit": "m",
    }
    run = {"scenario": "<b>", "system": {"avoider": {"name": "a"}}, "source_hash": "f", "claims": [claim]}
    return {"format": FORMAT, "runs": [run], "overruling": {"a": {"overruled": overruled, "proposals": 10}}}


def written(folder: Path, **reports: dict[str, Any]) -> Path:
    for name, one in reports.items():
        (folder / name).mkdir(parents=True)
        (folder / name / "report.json").write_text(json.dumps(one))
    return folder


def test_the_first_revision_that_turned_a_verdict_is_named_and_numbers_are_in_their_order(
    tmp_path: Path,
) -> None:
    holds, violated = report("holds", 0.02), report("violated", -0.01)
    found = read_history(written(tmp_path, r10=violated, r9=violated, r2=holds, r1=holds))
    assert [one.name for one in found.revisions] == ["r1", "r2", "r9", "r10"]
    (course,) = found.unlike
    assert course.turns == [("r9", "holds", "violated")]
    assert found.sentence == "Result of 1 claim over 4 revisions: 1 turned, 1 to an unexpected verdict."


def test_the_order_is_that_in_which_reports_were_made_and_not_that_of_names(tmp_path: Path) -> None:
    at = "2026-11-0{}T12:00:00+0{}:00".format
    holds, violated = report("holds", 0.02), report("violated", -0.01)
    reports = {"b": holds | {"made_at": at(1, 0)}, "a": violated | {"made_at": at(2, 0)}}
    found = read_history(written(tmp_path, **reports))
    assert [one.name for one in found.revisions] == ["b", "a"]
    assert len(found.unlike) == 1  # by name it would have turned to what is expected
    (tmp_path / "b" / "report.json").write_text(json.dumps(holds | {"made_at": at(3, 5)}))
    assert [one.name for one in read_history(tmp_path).revisions] == ["a", "b"]
    (tmp_path / "b" / "report.json").write_text(json.dumps(holds))  # of an earlier version
    assert [one.name for one in read_history(tmp_path).revisions] == ["b", "a"]


def test_what_turned_back_to_what_is_expected_is_told_and_no_failure(tmp_path: Path) -> None:
    found = read_history(written(tmp_path, a=report("violated", -0.01), b=report("holds", 0.02)))
    assert found.unlike == []
    assert "1 turned, 0 to" in found.sentence


@pytest.mark.parametrize(
    ("shares", "grows"), [((1, 2, 3, 4, 6), True), ((3, 3, 3, 3, 3), False), ((4, 1, 5, 2, 3), False)]
)
def test_overruling_that_creeps_up_is_told(tmp_path: Path, shares: tuple[int, ...], grows: bool) -> None:
    reports = {f"r{k}": report("holds", 0.02, overruled) for k, overruled in enumerate(shares)}
    assert read_history(written(tmp_path, **reports)).growing == (("a",) if grows else ())


def test_the_command_writes_a_page_and_fails_with_what_turned(tmp_path: Path) -> None:
    folder = written(tmp_path / "ci", a=report("holds", 0.02), b=report("violated", None))
    page = tmp_path / "history.html"
    done = CliRunner().invoke(app, ["history", str(folder), "--out", str(page)])
    assert done.exit_code == 1, done.output
    text = page.read_text("utf-8")
    assert "<b>" not in text
    rows = parse(text).all("table")[0].all("tbody")[0].all("tr")
    cells = [cell.text for cell in rows[0].all("td")]
    assert cells == [
        "a",
        "hands apart",
        "violated",
        "holds",
        "2",
        "+20.0 mm",
        "\u2013",
        "b: holds → violated",
    ]


@pytest.mark.parametrize(
    "text", ["{", "[]", '{"format": "another"}', json.dumps({"format": FORMAT, "runs": 1})]
)
def test_a_file_that_is_no_report_is_named(tmp_path: Path, text: str) -> None:
    folder = written(tmp_path, a=report("holds", 0.02), b=report("holds", 0.02))
    (folder / "b" / "report.json").write_text(text)
    with pytest.raises(InputError, match=r"b/report\.json.*format"):
        read_history(folder)


def test_one_revision_is_no_history(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="two revisions at least"):
        read_history(written(tmp_path, a=report("holds", 0.02)))
