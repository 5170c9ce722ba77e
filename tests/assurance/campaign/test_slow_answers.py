"""A controller that is slower than its period: measured wherever it is asked, and part of no result."""

from __future__ import annotations

import json
import shutil
import sqlite3
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from typer.testing import CliRunner

from safety_harness.admission.admit import Admitter
from safety_harness.admission.avoiders import with_avoider
from safety_harness.admission.repeatability import Repeatability, RepeatabilityResult
from safety_harness.admission.trial import run_all
from safety_harness.cell.simulation.worlds import KINEMATIC
from safety_harness.cli.console import DIFFERS
from safety_harness.cli.main import app
from safety_harness.extensions.assurance.campaign import rare
from safety_harness.extensions.assurance.campaign.episodes import EpisodeRunner
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.merging import merge
from safety_harness.extensions.assurance.campaign.plan import Plan
from safety_harness.extensions.assurance.campaign.summary import fingerprint_of, root_of
from safety_harness.extensions.assurance.campaign.watch import AvoiderWatch
from safety_harness.extensions.assurance.certification import credibility, whose_fault
from safety_harness.extensions.assurance.certification.evidence import read_evidence
from safety_harness.extensions.attribution.search_attribution import SearchAttribution
from safety_harness.scenario.model import Driver
from safety_harness.search import session as search_session
from safety_harness.search.counterexample import Explanation
from safety_harness.trace.answer_times import AnswersTook
from safety_harness.trace.trace import Trace
from tests.assurance.campaign.plans import PLAN, ledger_in, plan_in
from tests.search.short_space import SHORT, TEXT

SLOW_S = 0.010
FILE = f"""\
import time

from safety_harness import Moves, Stop


class Slow:
    name, sees = "slow", ()

    def reset(self, **begins):
        pass

    def act(self, seen):
        time.sleep({SLOW_S})
        return Stop()


class Quick(Slow):
    def act(self, seen):
        return Stop()


class Together(Slow):
    @staticmethod
    def act_many(controllers, seen):
        time.sleep({SLOW_S})
        return Moves(stop=[True] * len(controllers))
"""
RUNS, TICKS = 2, 51  # of a run of 0.4 s
PLANNED = 2  # in each stratum, enough for no target
SMALL = (
    PLAN.replace("runs: 30", f"runs: {PLANNED}")
    .replace("runs: 20", f"runs: {PLANNED}")
    .replace("    violated in at most: 50 %\n", "")
)


def small(folder: Path, name: str = "Slow") -> Plan:
    folder.mkdir(exist_ok=True)
    (folder / "slow.py").write_text(FILE)
    return plan_in(folder, SMALL.replace("avoider: opposite pose", f"controller: slow.py:{name}"))


def filled(folder: Path, plan: Plan, name: str = "slow") -> Path:
    """A ledger of both strata, the first of them run one by one."""
    with ledger_in(folder, plan) as ledger:
        bench = EpisodeRunner(plan)
        ledger.record(row for k in range(RUNS) for row in bench.run(0, [k]))
        ledger.record(bench.run(1, range(RUNS)))
        return ledger.path


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The ledger of the slow one."""
    folder = tmp_path_factory.mktemp("slow")
    return filled(folder, small(folder))


@pytest.fixture
def path(made: Path, tmp_path: Path) -> Path:
    """A copy of it, to be altered."""
    return Path(shutil.copy(made, tmp_path / "ledger.sqlite"))


@pytest.fixture
def asked_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Not again, and not whose fault it was: both take their time with a slow controller."""
    monkeypatch.setattr(Repeatability, "check", lambda _: RepeatabilityResult(questions=0))
    monkeypatch.setattr(SearchAttribution, "explain", lambda *_: Explanation())


@pytest.mark.parametrize(("name", "slow"), [("Slow", True), ("Quick", False)])
def test_every_answer_is_timed_alone_and_beside_others(
    made: Path, tmp_path: Path, name: str, slow: bool
) -> None:
    with Ledger.open(made if slow else filled(tmp_path, small(tmp_path, name))) as ledger:
        each = [ledger.times(stratum) for stratum in range(2)]
        assert [one.answers for one in each] == [RUNS * TICKS] * 2
        assert [one.limit_s for one in each] == [0.008] * 2
        if not slow:  # but for what a busy machine delays
            assert all(one.slow < one.answers for one in each)
        else:
            assert all(one.slow == one.answers and one.slowest_s >= SLOW_S for one in each)
            assert ledger.slow[0].startswith(
                f"near: on this machine {RUNS * TICKS} of {RUNS * TICKS} answers (100 %)"
            )


def test_one_call_for_all_says_nothing_of_one_answer(tmp_path: Path) -> None:
    plan = small(tmp_path, "Together")
    with Ledger.open(filled(tmp_path, plan)) as ledger:
        assert ledger.times(0).slow == ledger.times(0).answers == RUNS * TICKS
        assert ledger.times(1) == AnswersTook(limit_s=ledger.times(1).limit_s)


def test_times_are_part_of_no_result(path: Path) -> None:
    with Ledger.open(path) as ledger:
        before = fingerprint_of(ledger), root_of(ledger)
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("UPDATE answering SET slowest_s = 1.0, slow = 1")
    with Ledger.open(path) as ledger:
        assert (fingerprint_of(ledger), root_of(ledger)) == before
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("DROP TABLE answering")
    with Ledger.open(path, alone=True) as ledger:  # as an older program made it
        assert (fingerprint_of(ledger), root_of(ledger)) == before
        assert (ledger.times(0).answers, ledger.slow) == (0, [])


def test_a_strangers_times_are_numbers(path: Path) -> None:
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute(
            "UPDATE answering SET slowest_s = 'long', limit_s = x'00', answers = 'many', slow = 3"
        )
    with Ledger.open(path, alone=True) as ledger:
        assert ledger.times(0).slowest_s == 0.0
        assert all(isinstance(line, str) for line in ledger.slow)


def test_merged_ledgers_have_all_times(tmp_path: Path) -> None:
    plan = small(tmp_path)
    paths, bench = [], EpisodeRunner(plan)
    for part in range(2):
        with ledger_in(tmp_path / str(part), plan) as ledger:
            ledger.record(bench.run(part, range(RUNS)))
            paths.append(ledger.path)
    merge(tmp_path / "whole.sqlite", paths)
    with Ledger.open(tmp_path / "whole.sqlite") as ledger:
        assert [ledger.times(k).answers for k in range(2)] == [RUNS * TICKS] * 2


@pytest.mark.usefixtures("asked_once")
def test_certify_and_campaign_say_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(whose_fault, "attribute", lambda *_: ())
    monkeypatch.setattr(credibility, "run_trial", Mock(side_effect=RuntimeError("not made here")))
    small(tmp_path)
    words = ["certify", str(tmp_path / "plan.yaml"), "--out", str(tmp_path / "report"), "--workers", "1"]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == DIFFERS, result.output
    answers = PLANNED * TICKS
    said = f"near: on this machine {answers} of {answers} answers (100 %) took longer than the 8 ms"
    assert f"note: {said}" in result.output
    evidence = read_evidence(tmp_path / "report" / "evidence.json")
    assert any(one.text.startswith(said) for one in evidence.findings)
    assert said in (tmp_path / "report" / "evidence.html").read_text()
    ledger = str(tmp_path / "report" / "ledger.sqlite")
    page = str(tmp_path / "page.html")
    result = CliRunner().invoke(app, ["campaign", "status", ledger, "--html", page])
    assert f"computing time: {said}" in result.output
    assert said in Path(page).read_text()
    with closing(sqlite3.connect(ledger)) as connection, connection:
        connection.execute("DELETE FROM answering")
    result = CliRunner().invoke(app, words)
    evidence = read_evidence(tmp_path / "report" / "evidence.json")
    assert any(
        "how long the controller takes to answer was not measured" in one.text for one in evidence.findings
    )


@pytest.mark.usefixtures("asked_once")
def test_fuzz_says_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(search_session, "SHRINKING_RUNS", 2)
    monkeypatch.setattr(search_session, "MOST_SHRUNK", 1)
    monkeypatch.setattr(SearchAttribution, "of_search", lambda *_: None)
    small(tmp_path)
    (tmp_path / "space.yaml").write_text(TEXT)
    controller = f"{tmp_path / 'slow.py'}:Slow"
    words = ["fuzz", str(tmp_path / "space.yaml"), "--controller", controller, "--budget", "2"]
    result = CliRunner().invoke(app, [*words, "--out", str(tmp_path / "found")])
    said = f"on this machine {2 * TICKS} of {2 * TICKS} answers (100 %) took longer than the 8 ms"
    assert f"computing time: {said}" in result.output
    assert said in json.loads((tmp_path / "found" / "findings.json").read_text())["computing_time"]
    assert said in (tmp_path / "found" / "fuzz.html").read_text()


@pytest.mark.usefixtures("asked_once")
def test_pilot_and_rare_say_it(tmp_path: Path) -> None:
    plan = small(tmp_path)
    result = CliRunner().invoke(
        app, ["campaign", "pilot", str(tmp_path / "plan.yaml"), "--runs", "1", "--workers", "1"]
    )
    said = f"on this machine {2 * TICKS} of {2 * TICKS} answers (100 %) took longer than the 8 ms"
    assert f"\ncomputing time: {said}" in result.output
    watch = AvoiderWatch()
    draws = rare._Draws(plan, plan.strata[0], plan.claims[0], 1, watch=watch)
    draws(np.full((1, plan.strata[0].space.dimension), 0.5))
    (said,) = watch.time_lines
    assert said.startswith(f"computing time: on this machine {TICKS} of {TICKS} answers (100 %)")


def test_an_avoider_is_held_against_what_its_decisions_cost(tmp_path: Path) -> None:
    (tmp_path / "slow.py").write_text(FILE)
    scenario = with_avoider(SHORT.simplest, Driver(f"{tmp_path / 'slow.py'}:Quick"))
    (driven,) = run_all([Admitter().admit(scenario)], KINEMATIC)
    assert isinstance(driven, Trace)
    timed = replace(driven, answer_s=np.array([0.009] + [0.001] * (TICKS - 1)))
    assert AnswersTook.from_trace(timed) == AnswersTook(TICKS, 1, 0.009, 0.008)
    assert (
        AnswersTook.from_trace(timed).summary == ""
    )  # one in fifty-one: the 95th percentile is within the period
    times = AnswersTook(20, 2, 0.2, 0.1) + AnswersTook(20, 0, 0.05, 0.1)
    assert times == AnswersTook(40, 2, 0.2, 0.1)
    assert times.summary == ""
    assert (times + AnswersTook(1, 1, 0.3, 0.1)).summary == (
        "on this machine 3 of 41 answers (7.3 %) took longer than the 100 ms that the runs allow, "
        "the slowest 300.0 ms (3 times): it was tested as if it answered in time"
    )
