"""``--avoider``: another avoider for a whole run, recorded so that the run can be repeated."""

from __future__ import annotations

import shlex
import shutil
from pathlib import Path

import pytest

from safety_harness import load_trace
from safety_harness.cell.avoidance.shipped import SHIPPED
from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT, DIFFERS
from safety_harness.cli.scenario_commands import replay, run
from safety_harness.trace.compare import first_difference
from safety_harness.trace.records import DecisionOutcome
from tests.kinds_of_files import VISIT

ROOT = Path(__file__).parents[2]
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


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a run of an avoider of one's own; its tests have copies."""
    folder = tmp_path_factory.mktemp("made")
    (folder / "mine.py").write_text(MINE)
    (folder / "visit.yaml").write_text(VISIT)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert run([Path("visit.yaml")], Path("out"), "mine.py:Mine") == AS_EXPECTED
    return folder


@pytest.fixture
def _ran(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)


def trace_of(folder: str) -> Path:
    return Path(folder) / "traces" / "visit.trace"


def test_without_a_word_it_is_the_shipped_bayesian_network(visit: Path) -> None:
    assert run([visit], Path("out")) == AS_EXPECTED
    trace = load_trace(trace_of("out"))
    assert trace.scenario.avoider == "mc-dropout"
    assert trace.system.tested.name == "MC dropout (inter, 10 passes)"
    assert len(trace.decisions) > 0
    assert (trace.decisions["proposed_spread_m"] > 0.0).all()
    assert replay(trace_of("out")) == AS_EXPECTED


@pytest.mark.parametrize("name", SHIPPED)
def test_every_shipped_network_runs_behind_the_gate_with_its_own_threshold(name: str, visit: Path) -> None:
    assert run([visit], Path("out"), name) == AS_EXPECTED
    decisions = load_trace(trace_of("out")).decisions
    assert (decisions["spread_threshold_m"] >= 0.0).all()
    assert (decisions["fault"] == "").all()


@pytest.mark.usefixtures("_ran")
def test_a_trace_never_executes_the_program_that_it_names(capsys: pytest.CaptureFixture[str]) -> None:
    Path("mine.ran").unlink()
    assert replay(trace_of("out")) == BAD_INPUT
    assert not Path("mine.ran").exists()
    err = capsys.readouterr().err
    command = "safety-harness replay out/traces/visit.trace --avoider mine.py:Mine"
    assert command in err
    assert replay(trace_of("out"), shlex.split(command)[-1]) == AS_EXPECTED
    assert Path("mine.ran").exists()


@pytest.mark.usefixtures("_ran")
def test_a_replay_with_an_edited_program_says_that_it_was_edited(
    capsys: pytest.CaptureFixture[str],
) -> None:
    Path("mine.py").write_text(MINE.replace("0.07", "0.05"))
    assert replay(trace_of("out"), "mine.py:Mine") == DIFFERS
    out, err = capsys.readouterr()
    assert "first difference at decision 0" in out or "first difference at tick" in out
    assert "avoider: mine (sha256 " in err


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


def test_a_run_with_an_avoider_that_ends_its_process_comes_to_its_end_and_repeats(
    visit: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    fault = "its process ended with exit status 3"
    Path("mine.py").write_text(HOSTILE.replace("BAD", "os._exit(3)"))
    assert run([visit], Path("out"), "mine.py:Mine") == DIFFERS  # what the run shows is the fallback
    out, err = capfd.readouterr()
    trace = load_trace(trace_of("out"))
    assert trace.complete
    assert set(trace.decisions["fault"]) == {fault}
    assert set(trace.decisions["outcome"]) == {DecisionOutcome.OPPOSITE}
    assert "asked" not in out
    assert fault in err
    assert replay(trace_of("out"), "mine.py:Mine") == AS_EXPECTED


def test_a_run_with_an_avoider_that_hangs_has_failed_and_has_no_verdict(
    visit: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    visit.write_text(VISIT + "settings: {clock: {wall limit: 500 ms}}\n")
    Path("mine.py").write_text(HOSTILE.replace("BAD", "time.sleep(60)"))
    assert run([visit], Path("out"), "mine.py:Mine") == DIFFERS
    out, err = capfd.readouterr()
    assert "the avoider 'hostile' gave no answer within 0.5 s of wall time" in err
    assert "0 of 0 verdicts as expected, 0 of 1 scenarios run" in out
    assert "Traceback" not in err
    assert "holds" not in out
    assert not trace_of("out").exists()


SLEEPY = """
import time
from pathlib import Path
from safety_harness import Proposal
class Mine:
    name = "sleepy"
    decision_time_s = DECLARED
    def propose(self, *, hand_position_in_base_m, tcp_position_in_base_m, seed):
        time.sleep(float(Path(__file__).with_suffix(".s").read_text()))
        return Proposal(tcp_position_in_base_m + [0.0, 0.0, 0.1])
"""


@pytest.mark.parametrize(
    ("declared", "modelled", "limit"),
    [
        ("None", "computing time not modelled", "8 ms"),
        ("0.04", "40 ms a decision, as the avoider declares", "40 ms"),
    ],
)
def test_run_says_what_decisions_cost_and_when_they_take_longer_here_and_no_bit_depends_on_it(
    declared: str, modelled: str, limit: str, visit: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    visit.write_text(VISIT.replace("- withdraw: 1 m/s", "- wait: 5 s"))
    Path("mine.py").write_text(SLEEPY.replace("DECLARED", declared))
    found = {}
    for seconds in ("0", "0.13"):
        Path("mine.s").write_text(seconds)
        assert run([visit], Path(f"out{seconds}"), "mine.py:Mine") == AS_EXPECTED
        found[seconds] = capfd.readouterr()
    quick, slow = (load_trace(trace_of(f"out{seconds}")) for seconds in found)
    assert (slow.decision_latency_s > 0.1).any()
    assert first_difference(quick, slow) is None
    assert found["0"].out == found["0.13"].out
    assert found["0.13"].err.count(f"computing time: sleepy: {modelled}\n") == 1
    assert (
        f"answers (100 %) took longer than the {limit} that the runs allow, the slowest 1"
        in found["0.13"].err
    )
    assert replay(trace_of("out0.13"), "mine.py:Mine") == AS_EXPECTED
    for folder in ("out0", "out0.13"):
        assert modelled in (Path(folder) / "report.json").read_text()


def test_a_wrong_avoider_is_one_mistake_however_many_files(
    visit: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = visit.with_name("other.yaml")
    other.write_text(VISIT)
    assert run([visit, other], Path("out"), "mc-dropuot") == BAD_INPUT
    err = capsys.readouterr().err
    assert err.count("error:") == 1
    assert "--avoider" in err
    assert 'did you mean "mc-dropout"' in err
