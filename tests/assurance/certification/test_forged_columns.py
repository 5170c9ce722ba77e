"""A forger who makes every hash anew with the tool's own code, against a verifier who repeats all runs."""

from __future__ import annotations

import json
import sqlite3
import time
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from forging import every_episode

from safety_harness.base.exceptions import InputError
from safety_harness.extensions.assurance.campaign.episodes import trace_bytes, trace_of
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.plan import Plan
from safety_harness.extensions.assurance.certification.folder import (
    LARGEST_TRACE_BYTES,
    MANIFEST,
    read_manifest,
)
from safety_harness.extensions.assurance.certification.verify_files import Examination, check_files
from safety_harness.extensions.assurance.certification.verify_report import (
    differences,
    passed_in,
    verdicts_in,
)
from safety_harness.extensions.assurance.certification.verify_runs import Drawing, check_runs
from tests.assurance.campaign.plans import PLAN

SMALL = PLAN.replace("runs: 30", "runs: 6").replace("runs: 20", "runs: 4")


@pytest.fixture
def ran(tmp_path: Path) -> Iterator[tuple[Plan, Path]]:
    with every_episode(tmp_path, SMALL) as found:
        yield found


def again(plan: Plan, path: Path, *, same: bool = True, runs: int | None = 10) -> Examination:
    """All runs made again beside the ledger's rows and traces."""
    with Ledger.open(path) as ledger:
        return check_runs(plan, ledger, (), Drawing(runs=runs, miss=0.01, seed=1), same=same)


def alter(path: Path, statement: str, *values: object) -> None:
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute(statement, values)


def test_honest_runs_stand(ran: tuple[Plan, Path]) -> None:
    found = again(*ran)
    assert found.stands
    assert found.unchecked == ()


@pytest.mark.parametrize(
    "column",
    [
        "judgement SET exercised = exercised + 1",
        "judgement SET worst_time_s = worst_time_s + 0.5",
        "episode SET late = late + 1",
        "episode SET mishap = 'it hung'",
    ],
)
def test_no_column_that_comes_out_of_a_run_can_be_another(ran: tuple[Plan, Path], column: str) -> None:
    alter(ran[1], f"UPDATE {column} WHERE stratum = 0 AND episode = 3")
    (fault,) = again(*ran).faults
    assert fault.startswith("near, run 3: its ")
    assert fault.endswith("differ")


def forged_trace(plan: Plan, path: Path) -> None:
    """A stored trace whose decisions are ten times as sure: no claim of the plan looks there."""
    with Ledger.open(path) as ledger:
        for stratum, episode, _ in ledger.traces():
            trace = trace_of(plan, stratum, ledger.trace(stratum, episode) or b"")
            if len(trace.decisions):
                break
    decisions = trace.decisions.copy()
    decisions["proposed_spread_m"] = np.nan_to_num(decisions["proposed_spread_m"]) * 0.1 + 1e-3
    data = trace_bytes(replace(trace, decisions=decisions))
    alter(path, "UPDATE trace SET data = ? WHERE stratum = ? AND episode = ?", data, stratum, episode)


def test_every_stored_trace_is_made_again_and_compared_whole(ran: tuple[Plan, Path]) -> None:
    """Whatever is drawn besides: traces are what the page shows."""
    forged_trace(*ran)
    (fault,) = again(*ran, runs=1).faults
    assert "its stored trace: first difference at decision 0" in fault
    assert "proposed_spread_m" in fault


def test_a_trace_of_another_machine_with_equal_outcomes_is_open(ran: tuple[Plan, Path]) -> None:
    forged_trace(*ran)
    found = again(*ran, same=False, runs=1)
    assert found.stands
    assert "1 stored traces differ from the repeated runs" in found.unchecked[0]


@pytest.mark.parametrize("same", [True, False])
def test_no_other_software_explains_another_margin(ran: tuple[Plan, Path], same: bool) -> None:
    """200 mm are beyond what another machine's arithmetic may do."""
    alter(
        ran[1], "UPDATE judgement SET margin = margin + 0.2 WHERE stratum = 0 AND episode = 2 AND claim = 0"
    )
    (fault,) = again(*ran, same=same).faults
    assert fault.startswith("near, run 2, hand distance never below 150 mm: a margin of ")


BADGE = b'<span class="verdict %s"><svg class="icon"><use href="#i"/></svg>%s</span>'
ROWS = (
    b'<table class="cards verdicts"><tbody><tr><td class="number"><span>%s</span></td></tr></tbody></table>'
)


def test_verdicts_of_a_page_follow_from_the_evidence_whichever_version_made_it() -> None:
    page = BADGE % (b"violated", b"refuted") + ROWS % b"30.6 %"
    assert verdicts_in(page) == [b'span class="verdict violated"refuted', b"30.6 %"]
    for forged in (
        BADGE % (b"violated", b"shown") + ROWS % b"30.6 %",
        BADGE % (b"holds", b"refuted") + ROWS % b"30.6 %",
        BADGE % (b"violated", b"refuted") + ROWS % b"3.06 %",
        BADGE % (b"violated", b"refuted"),
        ROWS % b"30.6 %",
    ):
        assert verdicts_in(forged) != verdicts_in(page)


def test_which_claims_pass_in_junit_follows_from_the_evidence_whichever_version_wrote_it() -> None:
    case = '<testcase classname="near" name="a claim">{}</testcase>'
    failing, passing = (f"<testsuites>{case.format(one)}</testsuites>".encode() for one in ("<failure/>", ""))
    assert passed_in(failing) == []
    assert passed_in(passing) == [("near", "a claim")]
    assert passed_in(b"<testsuites>") is None


@pytest.mark.parametrize(
    "piece",
    [
        b'<svg role="img" ',
        b'<svg role="img">',
        b"<style>",
        b'<span class="verdict holds">',
        b'<table class="verdicts">',
        b'<ul class="answers">',
        b"<<<< ",
        b' d="',
    ],
)
def test_no_page_takes_quadratic_time(piece: bytes) -> None:
    """Four times the bytes take about four times as long, not sixteen: the least of three turns each."""

    def seconds(count: int) -> float:
        page, spent = piece * count, []
        for _ in range(3):
            begun_s = time.process_time()
            differences(page, page[:-1])
            verdicts_in(page)
            spent.append(time.process_time() - begun_s)
        return min(spent)

    few, many = seconds(2_500), seconds(10_000)
    assert many < 10.0 * few + 0.05


def test_a_manifest_of_too_many_names_is_refused_by_its_size(tmp_path: Path) -> None:
    names = {f"counterexamples/run-{k}.trace": "0" * 64 for k in range(180_000)}
    (tmp_path / MANIFEST).write_text(json.dumps({"format": "safety-harness manifest 1", "sha256": names}))
    with pytest.raises(InputError, match="bytes"):
        read_manifest(tmp_path)


def test_a_trace_that_is_too_large_is_refused_before_it_is_read(tmp_path: Path) -> None:
    with (tmp_path / "one.trace").open("wb") as file:
        file.truncate(LARGEST_TRACE_BYTES + 1)
    with pytest.raises(InputError, match=r"one\.trace: expected a trace of at most"):
        check_files(tmp_path, {"one.trace": "0" * 64})
