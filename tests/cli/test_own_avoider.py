"""``--avoider``: another avoider for a whole run, recorded so that the run can be repeated."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest

from safety_harness import load_trace
from safety_harness.avoidance.shipped import SHIPPED
from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT, DIFFERS
from safety_harness.cli.replay import replay
from safety_harness.cli.run import run
from safety_harness.trace.records import Outcome

ROOT = Path(__file__).parents[2]
VISIT = """\
scenario: a hand passes
duration: 1.6 s
tcp start:
  offset: [40 mm, -120 mm, 60 mm]
hands:
  - hand: right hand
    starts at: [1100 mm, -750 mm, 200 mm]
    elbow towards: [1600 mm, -1200 mm, 300 mm]
    moves:
      - move to: [840 mm, -350 mm, 250 mm]
        speed: 1 m/s
      - withdraw: 1 m/s
claims:
  joint speeds within limits: holds
"""
MINE = """\
from pathlib import Path
from safety_harness import Proposal
Path(__file__).with_suffix(".ran").touch()
class Mine:
    name = "mine"
    def propose(self, *, hand_position_in_base_m, tcp_position_in_base_m, seed):
        return Proposal(tcp_position_in_base_m + [0.0, 0.0, 0.07])
"""


@pytest.fixture
def visit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "scenarios").mkdir()
    (tmp_path / "mine.py").write_text(MINE)
    file = tmp_path / "scenarios" / "visit.yaml"
    file.write_text(VISIT)
    monkeypatch.chdir(tmp_path)
    return file


def trace_of(folder: str) -> Path:
    return Path(folder) / "traces" / "visit.trace"


def test_without_a_word_it_is_the_shipped_bayesian_network(visit: Path) -> None:
    assert run([visit], Path("out")) == AS_EXPECTED
    trace = load_trace(trace_of("out"))
    assert trace.scenario.avoider == "mc-dropout"
    assert trace.provenance.avoider == "MC dropout (inter, 10 passes)"
    assert len(trace.decisions) > 0
    assert (trace.decisions["proposed_spread_m"] > 0.0).all()
    assert replay(trace_of("out")) == AS_EXPECTED


@pytest.mark.parametrize("name", SHIPPED)
def test_every_shipped_network_runs_behind_the_gate_with_its_own_threshold(name: str, visit: Path) -> None:
    assert run([visit], Path("out"), name) == AS_EXPECTED
    decisions = load_trace(trace_of("out")).decisions
    assert (decisions["spread_threshold_m"] >= 0.0).all()
    assert (decisions["fault"] == "").all()


def test_the_report_repeats_the_command_with_its_avoider(visit: Path) -> None:
    run([visit], Path("out"), "mine.py:Mine")
    page = Path("out/report.html").read_text()
    assert "safety-harness run scenarios/visit.yaml --out out --avoider mine.py:Mine" in page or (
        str(visit) in page and "--avoider mine.py:Mine" in page
    )
    assert "safety-harness replay out/traces/visit.trace --avoider mine.py:Mine" in page


def test_a_trace_never_executes_the_program_that_it_names(
    visit: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run([visit], Path("out"), "mine.py:Mine")
    Path("mine.ran").unlink()
    capsys.readouterr()
    assert replay(trace_of("out")) == BAD_INPUT
    assert not Path("mine.ran").exists()
    err = capsys.readouterr().err
    command = "safety-harness replay out/traces/visit.trace --avoider mine.py:Mine"
    assert command in err
    assert replay(trace_of("out"), shlex.split(command)[-1]) == AS_EXPECTED
    assert Path("mine.ran").exists()


def test_a_replay_with_an_edited_program_says_that_it_was_edited(
    visit: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run([visit], Path("out"), "mine.py:Mine")
    Path("mine.py").write_text(MINE.replace("0.07", "0.05"))
    assert replay(trace_of("out"), "mine.py:Mine") == DIFFERS
    out, err = capsys.readouterr()
    assert "first difference at decision 0" in out or "first difference at tick" in out
    assert "avoider_sha256" in err


HOSTILE = """\
import os, time
from safety_harness import Proposal
class Mine:
    name = "hostile"
    def propose(self, *, hand_position_in_base_m, tcp_position_in_base_m, seed):
        print("asked")
        while seed != 0:
            try:
                BAD
            except BaseException:
                pass
        return Proposal(tcp_position_in_base_m)
"""


@pytest.mark.parametrize(
    ("bad", "fault"),
    [
        ("os._exit(3)", "its process ended with exit status 3"),
        ("time.sleep(60)", "no answer within 100 ms, nor 2 s later: its process was ended"),
    ],
)
def test_a_run_with_an_avoider_that_ends_or_hangs_comes_to_its_end_and_repeats(
    bad: str, fault: str, visit: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    Path("mine.py").write_text(HOSTILE.replace("BAD", bad))
    assert run([visit], Path("out"), "mine.py:Mine") == AS_EXPECTED
    out, err = capfd.readouterr()
    trace = load_trace(trace_of("out"))
    assert trace.complete
    assert set(trace.decisions["fault"]) == {fault}
    assert set(trace.decisions["outcome"]) == {Outcome.OPPOSITE}
    assert "asked" not in out
    assert fault in err
    assert replay(trace_of("out"), "mine.py:Mine") == AS_EXPECTED


def test_a_wrong_avoider_is_one_mistake_however_many_files(
    visit: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = visit.with_name("other.yaml")
    other.write_text(VISIT)
    assert run([visit, other], Path("out"), "mc-dropuot") == BAD_INPUT
    err = capsys.readouterr().err
    assert err.count("error:") == 1
    assert "--avoider" in err
    assert "did you mean 'mc-dropout'" in err
