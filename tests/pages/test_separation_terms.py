"""The pages of a run list the terms of a required separation, which add up to the distance in the reason."""

from __future__ import annotations

import re
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import pytest
from examples import VISIT, scenario

from safety_harness import Trace, Verdict, admit, judge, run_kinematic
from safety_harness.extensions.pages.run_page import claim_rows, write_report
from safety_harness.report.evidence import JudgedRun
from safety_harness.scenario.model import Claim

NOW = datetime(2026, 1, 1, tzinfo=UTC)
REQUIRED = re.compile(r"require (\d+\.\d) mm")


def judged(*sentences: str) -> JudgedRun:
    claims = tuple(Claim(sentence=text, expected=Verdict.VIOLATED) for text in sentences)
    trace: Trace = run_kinematic(admit(replace(scenario(VISIT), claims=claims)))
    return JudgedRun(trace=trace, evaluations=judge(trace), replay_command="")


@pytest.fixture(scope="module")
def run() -> JudgedRun:
    return judged(
        "protective separation kept", "protective separation kept at 1.6 m/s", "hand distance > 50 mm"
    )


def test_the_terms_add_up_to_the_distance_that_the_reason_states(run: JudgedRun) -> None:
    rows = claim_rows(run)
    for row in rows[:2]:
        lengths_mm = [float(length.removesuffix(" mm")) for _, length, _ in row["terms"]]
        found = REQUIRED.search(row["found"].reason)
        assert found is not None
        assert len(lengths_mm) == 6
        assert sum(lengths_mm) == pytest.approx(float(found[1]), abs=0.35)  # each is rounded to 0.1 mm
    assert rows[0]["terms"] != rows[1]["terms"]
    assert rows[2]["terms"] == []


def test_the_report_shows_a_table_for_each_such_claim_and_none_for_another(
    run: JudgedRun, tmp_path: Path
) -> None:
    write_report(
        tmp_path / "report.html", [run], title="a run", command="", interrupted=False, generated_at=NOW
    )
    page = (tmp_path / "report.html").read_text()
    assert page.count("The terms of the required distance") == 2
    assert all(symbol in page for symbol in ("S_h", "S_r", "S_s", "Z_d", "Z_r"))
