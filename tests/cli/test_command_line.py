"""The command line as its user meets it: exit codes, output, mistakes, interruption."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from typer import Typer
from typer.testing import CliRunner

from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT, DIFFERS, INTERRUPTED
from safety_harness.cli.main import app
from safety_harness.cli.options import command as command_of
from safety_harness.cli.scenario_commands import judge as judge_again
from safety_harness.cli.scenario_commands import replay, run
from safety_harness.scenario.expand import gather

SCENARIOS = Path(__file__).parents[2] / "scenarios"
GOOD = """\
scenario: a short run
duration: 300 ms
tcp start:
  offset: [0 mm, -60 mm, 20 mm]
claims:
  joint speeds within limits: holds
"""


@pytest.fixture
def good(tmp_path: Path) -> Path:
    file = tmp_path / "good.yaml"
    file.write_text(GOOD)
    return file


def command(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "safety_harness", *map(str, arguments)],
        capture_output=True,
        text=True,
    )


def test_a_run_as_expected_ends_with_0_and_leaves_report_and_trace(
    good: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run([good], tmp_path / "out") == AS_EXPECTED
    out, err = capsys.readouterr()
    tested, line, closing = out.splitlines()
    assert tested == "tested in good: avoider MC dropout (inter, 10 passes), in PyBullet, seed 0"
    assert re.fullmatch(r"holds  joint speeds within limits  \+\d+\.\d deg/s at 0\.\d+ s", line)
    assert closing == "1 of 1 verdicts as expected (1 hold), 1 of 1 scenarios run"
    assert err.splitlines()[-1].startswith("next: safety-harness view ")
    assert (tmp_path / "out" / "report.json").is_file()
    assert (tmp_path / "out" / "traces" / "good.trace").is_file()


def test_a_verdict_that_differs_ends_with_1(
    good: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    good.write_text(GOOD.replace("limits: holds", "limits: violated"))
    assert run([good], tmp_path / "out") == DIFFERS
    assert re.search(r"^HOLDS  joint .* \(expected violated\)$", capsys.readouterr().out, re.MULTILINE)


def test_a_claim_that_no_run_puts_to_the_test_is_named_and_ends_with_1(
    good: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    never = "repulsion moves away from every hand"
    good.write_text(f"{GOOD}  {never}: holds\n")
    assert run([good], tmp_path / "out") == DIFFERS
    err = capsys.readouterr().err
    assert f"claims were never exercised, and nothing is shown of:\n  {never}\n" in err
    good.write_text(f"{GOOD}  {never}: inconclusive\n")
    assert run([good], tmp_path / "out") == AS_EXPECTED
    out, err = capsys.readouterr()
    assert "nothing is shown of" not in err
    inconclusive, reason = [
        line for line in out.splitlines() if "inconclusive, as" in line or "never" in line
    ]
    assert inconclusive.startswith(f"inconclusive, as expected  {never}")
    assert reason.strip().startswith("never exercised: ")


def test_bad_input_ends_with_2_names_every_mistake_and_runs_nothing(
    good: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    unit = tmp_path / "unit.yaml"
    unit.write_text(GOOD.replace("-60 mm", "-60"))
    claim = tmp_path / "claim.yaml"
    claim.write_text(GOOD.replace("joint speeds", "joint speed"))
    reach = tmp_path / "reach.yaml"
    reach.write_text(GOOD.replace("20 mm", "3 m"))
    assert run([good, unit, claim, reach, tmp_path / "missing.yaml"], tmp_path / "out") == BAD_INPUT
    out, err = capsys.readouterr()
    assert out == ""
    assert f"{unit}:4: tcp start.offset[1]" in err
    assert f"{claim}:6: " in err
    assert f"{reach}:4: tcp start" in err or f"{reach}:3: tcp start" in err
    assert str(tmp_path / "missing.yaml") in err
    assert "4 of the inputs cannot be used; nothing was run" in err
    assert not (tmp_path / "out").exists()


def test_two_files_of_one_name_are_refused(good: Path, tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    twin = tmp_path / "other" / "good.yaml"
    twin.write_text(GOOD)
    assert run([good, twin], tmp_path / "out") == BAD_INPUT


def test_a_folder_means_its_yaml_files_in_order() -> None:
    files = [scenario.file for scenario in gather([SCENARIOS]).scenarios]  # a matrix gives several a file
    assert list(dict.fromkeys(files)) == sorted(SCENARIOS.glob("*.yaml"))


def test_an_empty_folder_is_bad_input(tmp_path: Path) -> None:
    assert run([tmp_path], tmp_path / "out") == BAD_INPUT


def test_a_replay_is_identical_and_a_changed_trace_is_not(
    good: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run([good], tmp_path / "out")
    file = tmp_path / "out" / "traces" / "good.trace"
    capsys.readouterr()
    assert replay(file) == AS_EXPECTED
    assert capsys.readouterr().out.startswith("identical: good, 39 ticks")

    from dataclasses import replace

    from safety_harness import load_trace, save_trace

    trace = load_trace(file)
    ticks = trace.ticks.copy()
    ticks["joint_position_rad"][20, 3] += 1e-15
    save_trace(replace(trace, ticks=ticks), file)
    assert replay(file) == DIFFERS
    assert "first difference at tick 20 (t = 0.160 s) in joint_position_rad" in capsys.readouterr().out


def test_judging_again_gives_the_same_lines_without_simulating(
    good: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run([good], tmp_path / "out")
    first = capsys.readouterr().out
    assert judge_again([tmp_path / "out" / "traces" / "good.trace"]) == AS_EXPECTED
    assert capsys.readouterr().out == "".join(first.splitlines(keepends=True)[:-1])  # the totals of runs


def test_what_is_no_trace_ends_with_2(good: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert replay(good) == BAD_INPUT
    assert judge_again([good]) == BAD_INPUT
    assert "expected a trace\n  got      a scenario" in capsys.readouterr().err


def test_an_unwritable_folder_is_a_clear_error(good: Path, tmp_path: Path) -> None:
    (tmp_path / "out").write_text("a file stands where the folder should be")
    done = CliRunner().invoke(app, ["run", str(good), "--out", str(tmp_path / "out")])
    assert isinstance(done.exception, SystemExit)  # no other goes through to a user
    assert done.exit_code == BAD_INPUT
    assert "Traceback" not in done.stderr
    assert str(tmp_path / "out") in done.stderr


def test_help_teaches_and_no_arguments_are_no_traceback() -> None:
    assert "Exit codes:" in CliRunner().invoke(app, ["run", "--help"]).stdout
    assert "Traceback" not in command().stderr
    assert CliRunner().invoke(app, ["run"]).exit_code == BAD_INPUT


@pytest.mark.parametrize(  # one handler takes the last two
    "asked",
    [signal.SIGINT, signal.SIGHUP, pytest.param(signal.SIGTERM, marks=pytest.mark.long)],
    ids=lambda one: one.name,
)
def test_ctrl_c_and_signals_alike_keep_what_was_finished(
    good: Path, tmp_path: Path, asked: signal.Signals
) -> None:
    long = tmp_path / "long.yaml"
    long.write_text(GOOD.replace("300 ms", "1000 s"))
    process = subprocess.Popen(
        [
            sys.executable,
            "-m",
            "safety_harness",
            "run",
            str(good),
            str(long),
            "--out",
            str(tmp_path / "o"),
        ],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
        # A test run in the background, or by nohup, ignores the signal, and its children would too.
        preexec_fn=lambda: signal.signal(asked, signal.SIG_DFL),
    )
    finished = tmp_path / "o" / "traces" / "good.trace"
    deadline = time.monotonic() + 300.0
    while not finished.exists() and time.monotonic() < deadline and process.poll() is None:
        time.sleep(0.1)
    time.sleep(1.0)  # into the long run
    process.send_signal(asked)
    out, err = process.communicate(timeout=300)
    assert process.returncode == INTERRUPTED, err
    assert "stopped before the end" in err
    assert "Traceback" not in err
    assert "1 of 2 verdicts as expected (1 hold, 1 inconclusive), 2 of 2 scenarios run" in out
    assert (tmp_path / "o" / "report.json").is_file()


@pytest.mark.parametrize(
    ("code", "more", "told"), [(0, [], True), (1, [], True), (2, [], False), (0, ["--json"], False)]
)
def test_a_command_ends_with_the_next_one_unless_it_failed_or_answers_in_json(
    code: int, more: list[str], told: bool
) -> None:
    group = Typer()

    @command_of(group, "train", then="evaluate {out}")
    def train(out: Path = Path("a b")) -> int:
        """Train. Exit code 0."""
        return code

    @command_of(group, "other")
    def sample() -> int:
        """Have the name of a function with a next command. Exit code 0."""
        return 0

    found = CliRunner().invoke(group, ["train", *more])
    assert found.exit_code == code
    assert ("next: evaluate 'a b'" in found.stderr) == told
    assert CliRunner().invoke(group, ["other"]).stderr == ""


def test_the_next_command_has_all_of_several_files() -> None:
    group = Typer()

    @command_of(group, "fmt", then="validate {files}")
    def lay_out(files: list[Path]) -> int:
        """Lay out. Exit code 0."""
        return 0

    @command_of(group, "other")
    def other() -> int:
        """Exit code 0."""
        return 0

    assert "next: validate a 'b c'" in CliRunner().invoke(group, ["fmt", "a", "b c"]).stderr
