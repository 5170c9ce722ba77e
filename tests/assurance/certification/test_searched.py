"""A search that is missing, failed, or was cut short is said, stratum by stratum, and made anew."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest
from partly_measured import partly_measured

from safety_harness.base.exceptions import InputError, OutputError, SimulationError
from safety_harness.base.output import Output
from safety_harness.cli.console import INTERRUPTED
from safety_harness.extensions.assurance.certification import certify as certify_module
from safety_harness.extensions.assurance.certification import folder as folder_module
from safety_harness.extensions.assurance.certification.certify import Certification
from safety_harness.extensions.assurance.certification.counterexamples import (
    FINDINGS,
    read_findings,
    search_evidence,
    searched_counterexamples,
    searches_of,
)
from safety_harness.extensions.assurance.certification.evidence import read_evidence
from safety_harness.extensions.assurance.certification.findings import of_searches
from safety_harness.extensions.assurance.certification.guard import ReportGuard
from safety_harness.extensions.assurance.certification.tools import HarnessTrials
from safety_harness.extensions.assurance.commands.certify import certify
from safety_harness.scenario.model import Claim, Verdict
from safety_harness.scenario.write import write_scenario
from safety_harness.trace.store import save_trace
from safety_harness.trace.trace import Trace
from tests.assurance.campaign.plans import PLAN, plan_in

SEARCHING = PLAN + "search:\n  runs: 21\n"
FOUND: dict[str, Any] = {
    "tried": 11,
    "budget": 11,
    "seed": 7,
    "searcher": "default",
    "interrupted": False,
    "distinct": [{}, {}],
    "confirmed_in": ["PyBullet"],
    "confirmed": 1,
    "not_confirmed": [{}],
    "counterexamples": ["a.yaml"],
}


def put(folder: Path, name: str, **changes: Any) -> None:
    file = folder / "search" / name / FINDINGS
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps(FOUND | changes))


def said(folder: Path, text: str = SEARCHING) -> list[str]:
    plan = plan_in(folder, text)
    return [one.text for one in of_searches(searches_of(plan, folder), plan.search_runs)]


def test_every_run_that_the_plan_asks_for_goes_to_a_stratum(tmp_path: Path) -> None:
    assert [one.asked for one in searches_of(plan_in(tmp_path, SEARCHING), tmp_path)] == [11, 10]
    assert [one.asked for one in searches_of(plan_in(tmp_path, PLAN + "search: {runs: 1}\n"), tmp_path)] == [
        1
    ]
    assert searches_of(plan_in(tmp_path, PLAN), tmp_path) == ()
    assert said(tmp_path, PLAN) == []


def test_strata_whose_names_are_alike_have_folders_of_their_own(tmp_path: Path) -> None:
    plan = plan_in(tmp_path, SEARCHING.replace("stratum: nearer", "stratum: near!"))
    first, second = searches_of(plan, tmp_path)
    assert first.folder != second.folder


def test_a_search_that_is_missing_is_said_for_each_stratum(tmp_path: Path) -> None:
    put(tmp_path, "1-near")
    assert said(tmp_path) == [
        "near: 1 findings of the search were not confirmed in PyBullet",
        "nearer: the search was not made, or failed",
    ]
    known = search_evidence(searches_of(plan_in(tmp_path, SEARCHING), tmp_path))
    assert known is not None
    assert known.runs == 11
    assert "nearer: the search was not made, or failed" in known.lines


def test_whose_fault_the_violations_of_a_search_are_is_told_with_its_stratum(tmp_path: Path) -> None:
    put(tmp_path, "1-near", attribution={"words": "whose fault, of 2 violations: 2 avoider", "groups": {}})
    put(tmp_path, "2-nearer", budget=10)
    known = search_evidence(searches_of(plan_in(tmp_path, SEARCHING), tmp_path))
    assert known is not None
    assert [line for line in known.lines if "whose" in line] == [
        "near: whose fault, of 2 violations: 2 avoider"
    ]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"interrupted": True}, "was interrupted"),
        ({"budget": 5, "tried": 5}, "another search's than the plan's"),
        ({"seed": 5}, "another search's than the plan's"),
        ({"tried": "many"}, "cannot be read: tried"),
    ],
)
def test_a_search_that_is_not_the_whole_one_is_said_and_not_complete(
    tmp_path: Path, changes: dict[str, Any], words: str
) -> None:
    put(tmp_path, "1-near", **changes)
    assert words in said(tmp_path)[0]
    assert not searches_of(plan_in(tmp_path, SEARCHING), tmp_path)[0].complete


@pytest.mark.parametrize(
    "changes",
    [
        {"counterexamples": ["../../plan.yaml"]},
        {"counterexamples": ["/etc/passwd"]},
        {"counterexamples": [1]},
        {"distinct": 3},
        {"interrupted": "no"},
        {"tried": True},
    ],
)
def test_what_is_no_search_is_refused(tmp_path: Path, changes: dict[str, Any]) -> None:
    put(tmp_path, "x", **changes)
    with pytest.raises(InputError) as refused:
        read_findings(tmp_path / "search" / "x" / FINDINGS)
    assert (refused.value.place.field or "").startswith(next(iter(changes)))


@dataclass
class Made:
    """What a search that was made tells."""

    interrupted: bool = False
    unwritable: OutputError | None = None

    def kept(self, folder: Path, output: Output) -> Made:
        return self


def searching(answers: list[Callable[[], Made]], asked: list[Path]) -> Callable[..., Made]:
    def fuzz(*_: object, out: Path, budget: int, **__: object) -> Made:
        asked.append(out)
        made = answers[len(asked) - 1]()
        put(out.parents[1], out.name, budget=budget, tried=budget, interrupted=made.interrupted)
        return made

    return fuzz


def fails() -> Made:
    raise SimulationError("no world")


def test_a_search_that_fails_or_was_interrupted_is_made_anew_and_the_others_are_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    plan, asked = plan_in(tmp_path, SEARCHING), list[Path]()
    full = OutputError.from_os_error(tmp_path, OSError(28, "No space left on device"))
    answers = [fails, lambda: Made(interrupted=True), lambda: Made(unwritable=full), Made]
    monkeypatch.setattr(certify_module, "fuzz", searching(answers, asked))
    job = Certification(plan, tmp_path, HarnessTrials(), "certify")
    output = Output(say=print, result=print)
    guard = ReportGuard()
    assert not job.search(output, guard)  # the first fails, the second is interrupted
    stale = asked[1] / "as-found.yaml"
    stale.write_text("of the search that was interrupted")
    assert job.search(output, guard)
    assert job.search(output, guard)
    assert [folder.name for folder in asked] == ["1-near", "2-nearer", "1-near", "2-nearer"]
    assert not stale.exists()
    assert "no world" in capsys.readouterr().out


def test_ctrl_c_in_the_search_leaves_a_report_that_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    plan_in(tmp_path, SEARCHING.replace("runs: 30", "runs: 8").replace("runs: 20", "runs: 8"))
    monkeypatch.setattr(certify_module, "fuzz", searching([lambda: Made(interrupted=True)], []))
    monkeypatch.setattr(folder_module, "drawn", lambda evidence, _: ("", evidence))
    assert certify(tmp_path / "plan.yaml", out=tmp_path / "report", workers=1) == INTERRUPTED
    said = [one.text for one in read_evidence(tmp_path / "report" / "evidence.json").findings]
    assert "near: the search was interrupted" in said
    assert "nearer: the search was not made, or failed" in said
    assert (tmp_path / "report" / "manifest.json").is_file()
    assert "interrupted" in capsys.readouterr().err


def test_a_counterexample_that_was_not_simulated_is_not_shown(tmp_path: Path, visit: Trace) -> None:
    put(tmp_path, "1-near")
    plan = plan_in(tmp_path, SEARCHING)
    searches = searches_of(plan, tmp_path)
    file = searches[0].folder / "a.yaml"
    claimed = replace(
        visit.scenario, claims=(Claim(sentence="TCP speed never above 250 mm/s", expected=Verdict.HOLDS),)
    )
    file.write_text(f"# To be violated\n{write_scenario(claimed)}")
    other = replace(visit, scenario=replace(visit.scenario, seed=99))
    save_trace(other, file.with_suffix(".trace"))
    (found,) = searched_counterexamples(plan, searches, tmp_path)
    assert found == "near: the search's a.yaml cannot be shown: another than its trace has"
    for trace, shown in ((visit, True), (partly_measured(visit), False)):
        save_trace(trace, file.with_suffix(".trace"))
        (found,) = searched_counterexamples(plan, searches, tmp_path)
        assert (not isinstance(found, str)) is shown, found
    assert str(found).startswith("near: the search's a.yaml cannot be shown: columns that are ")
