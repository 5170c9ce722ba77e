"""The command: a pipe of lines in, lines of verdicts out, a log that ``judge`` reads, exit codes."""

from __future__ import annotations

import itertools
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from cells import cell, recorded, said
from stream_lines import lines
from typer.testing import CliRunner, Result

from safety_harness.base.exceptions import OutputError
from safety_harness.cli.main import app
from safety_harness.extensions.field.commands.monitor import follow, lines_of
from safety_harness.extensions.field.logs.judging import recorded as recorded_log
from safety_harness.extensions.field.monitoring.cell import cell_taken, read_cell
from safety_harness.extensions.field.monitoring.journal import Journal
from safety_harness.extensions.field.monitoring.monitor import Monitor
from safety_harness.scenario.robots import OwnRobot

LOW, NEAR = "always TCP height > 0 mm", "always hand distance > 10 mm"


@pytest.fixture(scope="session")
def a_stream() -> list[bytes]:
    rng = np.random.default_rng(3)
    return lines(recorded(cell(rng), rng, seconds=0.6, ahead_s=0.0), ahead_ns=0)


def monitor(stream: list[bytes], *words: str) -> Result:
    return CliRunner().invoke(app, ["monitor", *words], input=b"\n".join(stream) + b"\n")


def test_it_says_that_it_is_no_safety_function_and_what_it_takes_for_granted(a_stream: list[bytes]) -> None:
    done = monitor(a_stream, "--robot", "ur10", "--claim", LOW)
    assert done.exit_code == 0, done.output
    assert "no safety function" in done.stderr
    assert "accelerate at most: 40 rad/s2" in done.stderr
    (told,) = done.stdout.splitlines()
    assert told.startswith("1700000000.000 s  holds  always TCP height > 0 mm")


def test_lines_for_programs(a_stream: list[bytes]) -> None:
    done = monitor(a_stream, "--robot", "ur10", "--claim", LOW, "--claim", NEAR, "--json")
    assert "moves at most: 2 m/s" in done.stderr
    told = [json.loads(line) for line in done.stdout.splitlines()]
    assert {one["claim"] for one in told} == {LOW, NEAR}
    assert told[0].keys() == {"time_s", "claim", "verdict", "latest", "margin", "unit", "reason"}
    assert done.exit_code == 1  # no hand came near: never exercised


@pytest.mark.parametrize(
    ("stream", "words", "told"),
    [
        ([b"garbage"], ("--robot", "ur10", "--claim", LOW), "the stream has no usable joints"),
        ([], ("--robot", "ur10", "--claim", LOW), "the stream has no usable joints"),
        ([], ("--robot", "ur11", "--claim", LOW), "error: --robot\n  expected UR10, UR5 or UR3"),
        ([], ("--robot", "ur10", "--claim", LOW, "--period", "8"), "error: --period\n  expected a time"),
        ([], ("--robot", "ur10", "--claim", LOW, "--hand", "a", "--hand", "a"), "error: --hand\n"),
        ([], ("--robot", "ur10"), "a claim at least"),
        ([], ("--claim", LOW), "a LOG.yaml, or --robot"),
        ([], ("--robot", "ur10", "--claim", "always servoing"), "a signal that this stream has"),
        ([], ("--robot", "ur10", "--claim", LOW, "--wait", "1 h"), "a time"),
        ([], ("none.yaml",), "none.yaml"),
    ],
)
def test_bad_input_is_exit_code_2_with_the_reason(
    stream: list[bytes], words: tuple[str, ...], told: str
) -> None:
    done = monitor(stream, *words)
    assert done.exit_code == 2
    assert told in done.stderr


def test_its_log_is_judged_part_by_part_and_the_oldest_parts_go(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    (tmp_path / "CELL.yaml").write_text(said("joints.csv", "hand.csv", "elbow"))
    own = Monitor(cell=read_cell(tmp_path / "CELL.yaml", [LOW, NEAR]))
    out = tmp_path / "log"
    own.journal = Journal(cell=own.cell, claims=[LOW, NEAR], folder=out, most_bytes=8_000, keep=3)
    for line in lines(recorded(cell(rng), rng, seconds=1.2)):
        list(own.take(line))
    own.journal.close()
    parts = sorted(out.iterdir())
    assert len(parts) == 3
    assert own.journal.part > 3
    traces = [recorded_log(part / "LOG.yaml").trace for part in parts]
    for trace in traces:
        assert [claim.sentence for claim in trace.scenario.claims] == [LOW, NEAR]
        assert trace.known.recorded
    rows = [(part / "joints.csv").read_text().splitlines() for part in parts]
    for before, after in itertools.pairwise(rows):
        assert before[-1] == after[1]  # nothing between two parts is lost
    size = sum(one.stat().st_size for one in parts[0].iterdir() if one.suffix == ".csv")
    assert size < 9_000


def test_a_cell_without_hands_has_a_log_without_hands(tmp_path: Path, a_stream: list[bytes]) -> None:
    joints = [line for line in a_stream if b"joint" in line]
    done = monitor(joints, "--robot", "ur10", "--claim", LOW, "--out", str(tmp_path / "log"))
    assert done.exit_code == 0, done.output
    assert "hands:" not in done.stderr
    trace = recorded_log(tmp_path / "log" / "0001" / "LOG.yaml").trace
    assert not trace.scenario.hands
    assert len(trace.ticks) > 50


def test_the_log_names_the_files_of_an_arm_from_where_it_lies(tmp_path: Path) -> None:
    arm = (Path(__file__).parents[3] / "robots" / "ur10e.yaml").resolve()
    text = said("joints.csv", "hand.csv", "elbow").replace("UR10", os.path.relpath(arm, tmp_path))
    (tmp_path / "CELL.yaml").write_text(text)
    of_file = read_cell(tmp_path / "CELL.yaml", [LOW])
    (tmp_path / "below").mkdir()
    (tmp_path / "below" / "LOG.yaml").write_text(of_file.log_text("joints.csv", ["hand.csv"], [LOW]))
    again = read_cell(tmp_path / "below" / "LOG.yaml").scenario.robot
    assert isinstance(again, OwnRobot)
    assert isinstance(of_file.scenario.robot, OwnRobot)
    assert again.texts == of_file.scenario.robot.texts


def test_a_folder_with_files_in_it_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "mine").write_text("")
    cell_of_it = cell_taken("UR10", ["hand"], "8 ms", [LOW])
    with pytest.raises(OutputError, match="an empty folder"):
        Journal(cell=cell_of_it, claims=[LOW], folder=tmp_path, most_bytes=10**6, keep=2)


def test_lines_of_a_pipe_come_one_by_one_with_silence_and_without_end_between() -> None:
    read, write = os.pipe()
    with os.fdopen(read, "rb") as stream:
        found = lines_of(stream, 0.02)
        os.write(write, b"one\n\ntw")
        assert next(found) == b"one"
        assert next(found) is None
        os.write(write, b"o\n")
        assert next(found) == b"two"
        endless = []
        for _ in range(5):
            os.write(write, b"x" * 20_000)
            endless += [line for line in [next(found)] if line]
        os.write(write, b"x\nlast")
        os.close(write)
        assert [len(line) for line in endless] == [80_000]
        assert [line for line in found if line is not None] == [b"last"]


def test_lines_without_joints_are_silence(a_stream: list[bytes], capsys: pytest.CaptureFixture[str]) -> None:
    own = Monitor(cell=cell_taken("UR10", ["hand"], "8 ms", [LOW]))

    def stream() -> Iterator[bytes]:
        yield from a_stream
        for line in (b"garbage", a_stream[0]) * 4:
            time.sleep(0.02)
            yield line

    follow(own, stream(), 0.1, as_json=False)
    told = capsys.readouterr().out.splitlines()
    assert "holds" in told[0]
    assert "inconclusive" in told[-1]
    assert own.counts.silent == 1


def test_ctrl_c_keeps_the_log(tmp_path: Path, a_stream: list[bytes]) -> None:
    out = tmp_path / "log"
    words = [sys.executable, "-m", "safety_harness", "monitor", "--robot", "ur10", "--claim", LOW]
    pipes = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
    unfolded = {name: value for name, value in os.environ.items() if name != "COLUMNS"}
    with subprocess.Popen([*words, "--out", str(out)], env=unfolded, **pipes) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdin.write(b"\n".join(a_stream) + b"\n")
        process.stdin.flush()
        first, second = process.stdout.readline(), process.stdout.readline()
        assert b"holds" in first
        assert b"no joints that can be used came for 100 ms" in second
        time.sleep(0.1)
        process.send_signal(signal.SIGINT)
        assert process.wait(30) == 130
        assert b"the log stays" in process.stderr.read()
    judged = CliRunner().invoke(app, ["judge", str(out / "0001" / "LOG.yaml")])
    assert judged.exit_code == 0, judged.output


def test_help_teaches() -> None:
    told = " ".join(CliRunner().invoke(app, ["monitor", "--help"]).output.split())
    for words in ("no safety function", "time_s", "Exit codes", "inconclusive at once"):
        assert words in told


def test_a_stream_that_ends_within_a_line_or_a_claim_that_nobody_watched_is_no_success(
    a_stream: list[bytes], tmp_path: Path
) -> None:
    """A feeder that dies cuts its last line; what was garbage before is counted as ever."""
    words = ("--robot", "ur10", "--claim", LOW)
    assert monitor([*a_stream[:3], b"garbage", *a_stream[3:]], *words).exit_code == 0
    cut = monitor([*a_stream, a_stream[-1][:30]], *words)
    assert cut.exit_code == 1
    assert "the stream ends with a line that cannot be used" in cut.stderr
    file = tmp_path / "LOG.yaml"
    file.write_text(
        f"log: {{joints: joints.csv}}\nrobot: UR10\nclaims: [{LOW}, joint positions within limits]\n"
    )
    joints = [line for line in a_stream if b"hands" not in line]
    partly = monitor(joints, str(file))
    assert "holds  always TCP height > 0 mm" in partly.stderr
    assert "claims were not watched" in partly.stderr
    assert partly.exit_code == 1
    assert monitor(joints, str(file), "--claim", LOW).exit_code == 0
