"""Nothing that happens after the runs of a plan loses its report: every part of it is broken once."""

from __future__ import annotations

import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import pytest

from safety_harness.admission.repeatability import Repeatability, RepeatabilityResult
from safety_harness.cli.console import DIFFERS, INTERRUPTED
from safety_harness.extensions.assurance.campaign import session
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.summary import fingerprint_of
from safety_harness.extensions.assurance.certification import (
    certify as certification,
)
from safety_harness.extensions.assurance.certification import (
    counterexamples,
    credibility,
    folder,
    gather,
    page,
    results,
    stored,
    whose_fault,
)
from safety_harness.extensions.assurance.certification.evidence import read_evidence
from safety_harness.extensions.assurance.certification.folder import read_manifest
from safety_harness.extensions.assurance.commands import campaign as campaign_command
from safety_harness.extensions.assurance.commands.certify import certify
from safety_harness.extensions.assurance.pages import campaign_page
from safety_harness.extensions.attribution import search_attribution as attribution
from safety_harness.extensions.attribution.search_attribution import SearchAttribution
from safety_harness.report.search_job import SearchResult
from safety_harness.search import session as search_session
from safety_harness.search.counterexample import Explanation
from tests.assurance.campaign.plans import PLAN, plan_in

SMALL = PLAN.replace("runs: 30", "runs: 8").replace("runs: 20", "runs: 8") + "search:\n  runs: 8\n"
# A claim that nothing tests: what came nearest is looked up in the stored runs.
UNTESTED = SMALL.replace(
    "  - claim: joint speeds within limits\n",
    "  - claim: joint speeds within limits\n  - claim: uncertain answers fall back within 2 cycles\n",
)
# Whatever a report is made of after its last run, by where it is looked up.
PARTS = [
    (gather, "random_traces"),
    (gather, "searches_of"),
    (gather, "declared_counterexamples"),
    (gather, "searched_counterexamples"),
    (gather, "overruling_of"),
    (gather, "system_of"),
    (gather, "separation_of"),
    (gather, "calibration_of"),
    (gather, "coverage_of"),
    (gather, "search_evidence"),
    (gather, "hazards_of"),
    (gather, "learned_of"),
    (gather, "untried_in"),
    (gather, "limited_in"),
    (gather, "findings_of"),
    (gather, "stored_proof"),
    (gather, "read_notes"),
    (stored, "trace_of"),
    (counterexamples, "trace_of"),
    (counterexamples, "load_trace"),
    (results, "came_nearest"),
    (whose_fault, "violated_episodes"),
    (whose_fault, "attribute"),
    (folder, "unpacked"),
    (folder, "write_traces"),
    (folder, "junit_xml"),
    (folder, "argument_texts"),
    (page, "argument_of"),
    (page, "argument_svg"),
    (page, "bounds_figure"),
    (page, "margins_figure"),
    (page, "separation_figure"),
    (page, "coverage_map"),
    (page, "cells_of"),
    (page, "draw_attributions"),
    (page, "path_views"),
    (page, "timeline"),
    (page, "shown_moment"),
    (page, "_proven"),
    (page, "key_of"),
    (page, "render_page"),
]
# What is said of these in place of an open finding of their own.
ELSEWHERE = [
    (counterexamples, "circumstances"),
    (credibility, "run_trial"),
    (attribution, "attribute"),
    (session, "trace_of"),
    (Repeatability, "check"),
]
PLANTED = "planted by a test"
EXPLAIN = SearchAttribution.explain


def broken(*_: object, **__: object) -> Any:
    raise RuntimeError(PLANTED)


def interrupted(*_: object, **__: object) -> Any:
    raise KeyboardInterrupt


def named(part: tuple[Any, str]) -> str:
    return f"{part[0].__name__.rpartition('.')[2]}.{part[1]}"


def shrinks_little(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(search_session, "SHRINKING_RUNS", 5)
    patch.setattr(search_session, "MOST_SHRUNK", 1)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a plan whose report was made once."""
    where = tmp_path_factory.mktemp("made")
    plan_in(where, UNTESTED)
    with pytest.MonkeyPatch.context() as patch:
        shrinks_little(patch)
        assert certify(where / "plan.yaml", out=where / "report", workers=1) == DIFFERS
    evidence = read_evidence(where / "report" / "evidence.json")
    assert not evidence.unmade
    assert {one.independent for one in evidence.counterexamples} == {True, False}
    return where


@pytest.fixture
def again(made: Path, tmp_path: Path) -> Path:
    """A copy of it, without the page."""
    where = Path(shutil.copytree(made, tmp_path / "again"))
    for name in ("evidence.html", "evidence.json", "junit.xml", "manifest.json"):
        (where / "report" / name).unlink()
    return where


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """What takes its time is not made again: each of these has its own test."""
    shrinks_little(monkeypatch)
    monkeypatch.setattr(Repeatability, "check", lambda _: RepeatabilityResult(questions=0))
    monkeypatch.setattr(credibility, "run_trial", broken)  # which is caught
    monkeypatch.setattr(SearchAttribution, "explain", lambda *_: Explanation())
    monkeypatch.setattr(whose_fault, "attribute", lambda *_: ())


def fingerprint(where: Path) -> str:
    with Ledger.open(where / "report" / "ledger.sqlite") as ledger:
        return fingerprint_of(ledger)


def refused_parts(where: Path) -> list[str]:
    """Make the report again, and return what it says of the parts that fail."""
    before = fingerprint(where)
    assert certify(where / "plan.yaml", out=where / "report", workers=1) == DIFFERS
    evidence = read_evidence(where / "report" / "evidence.json")
    said = [one.text for one in evidence.findings if PLANTED in one.text]
    assert all("cannot be" in text and f"RuntimeError: {PLANTED}" in text for text in said)
    assert PLANTED in (where / "report" / "evidence.html").read_text()
    assert "evidence.html" in read_manifest(where / "report")
    assert fingerprint(where) == before
    return said


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize(
    ("room", "findings"), [(gather, 8), (folder, 2), (page, 1)], ids=["gather", "folder", "page"]
)
def test_parts_that_fail_together_are_open_findings_of_the_report(
    room: Any, findings: int, again: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Some parts of a room are made for others, and a page is made as one."""
    for part in PARTS:
        if part[0] is room:
            monkeypatch.setattr(*part, broken)
    assert len(set(refused_parts(again))) >= findings


@pytest.mark.long  # those above break together
@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("part", PARTS, ids=named)
def test_a_part_that_fails_is_an_open_finding_of_the_report(
    part: tuple[Any, str], again: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(*part, broken)
    assert refused_parts(again)


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize("part", ELSEWHERE, ids=named)
def test_a_part_that_is_caught_within_leaves_a_report_too(
    part: tuple[Any, str], again: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = Mock(side_effect=RuntimeError(PLANTED))
    if part[0] is attribution:
        monkeypatch.setattr(SearchAttribution, "explain", EXPLAIN)
    monkeypatch.setattr(*part, asked)
    assert certify(again / "plan.yaml", out=again / "report", workers=1) == DIFFERS
    assert "evidence.html" in read_manifest(again / "report")
    assert asked.called, "the test can fail"


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize(
    "part", [PARTS[0], PARTS[6], (whose_fault, "attribute"), (folder, "write_traces")], ids=named
)
def test_ctrl_c_in_a_part_keeps_every_run(
    part: tuple[Any, str], again: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = fingerprint(again)
    with monkeypatch.context() as patch:
        patch.setattr(*part, interrupted)
        assert certify(again / "plan.yaml", out=again / "report", workers=1) == INTERRUPTED
    assert fingerprint(again) == before


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize(
    "part", [(certification, "read_space"), (certification, "fuzz"), (SearchResult, "write")], ids=named
)
def test_a_search_that_fails_is_an_open_finding(
    part: tuple[Any, str], again: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.rmtree(again / "report" / "search")
    monkeypatch.setattr(*part, broken)
    assert certify(again / "plan.yaml", out=again / "report", workers=1) == DIFFERS
    evidence = read_evidence(again / "report" / "evidence.json")
    assert [
        one for one in evidence.unmade if one.startswith("the search of near cannot be made: RuntimeError")
    ]


def test_a_page_of_a_campaign_that_fails_leaves_its_lines(
    again: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copy(again / "report" / "ledger.sqlite", again / "ledger.sqlite")
    monkeypatch.setattr(campaign_page, "render_page", broken)
    assert campaign_command.run(again / "plan.yaml", ledger=again / "ledger.sqlite", workers=1) == DIFFERS
    said = capsys.readouterr()
    assert "fingerprint of the results" in said.out
    assert f"the page cannot be written (RuntimeError: {PLANTED})" in said.err


def test_a_scenario_that_cannot_be_admitted_again_is_no_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    explaining = SearchAttribution()
    monkeypatch.setattr(explaining.admitter, "admit", broken, raising=False)
    scenario: Any = SimpleNamespace(name="near-1")
    (line,) = explaining.explain(scenario, None).lines  # type: ignore[arg-type]
    assert line.startswith("whose fault: cannot be told")
