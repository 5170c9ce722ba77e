"""The second process of a first run: what it compiles, when it starts, and that it ends with the first."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import pytest

from safety_harness.base.compiling import Compilation
from safety_harness.base.interpreted import calls_of
from safety_harness.report import compile_ahead
from safety_harness.report.compile_ahead import BRIEF_RUN, SecondProcess
from safety_harness.report.run_job import run
from safety_harness.scenario.read import parse_scenario

LOADED = """
from safety_harness.base import compiled
from safety_harness.report.compile_ahead import BRIEF_RUN
from safety_harness.report.run_job import run
from safety_harness.scenario.read import parse_scenario

run(parse_scenario(BRIEF_RUN))
print(*(made._cache.index_file().name for made in compiled._functions if made.signatures))
"""
COMPILING = Compilation(1, 0.2, going_on=True)


@pytest.fixture
def starts(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[int]:
    """The starts of a second process, with an empty cache."""
    made: list[int] = []
    monkeypatch.setattr(compile_ahead, "_start", lambda: made.append(1))
    monkeypatch.setattr(compile_ahead, "_is_cold", lambda: True)
    return made


def test_the_brief_run_calls_what_takes_a_first_run_longest() -> None:
    called = {function.py_func.__name__ for function, _ in calls_of(lambda: run(parse_scenario(BRIEF_RUN)))}
    longest = {"_nearest_of_each", "decide", "fill_truth", "sense", "watch", "act", "drive_on", "move_on"}
    assert called >= longest | {"_straight_reach", "_first_wrong", "_follow", "_closest_in_trace"}


def test_what_a_run_needs_is_known_before_it_is_compiled_and_it_ends_with_the_process_that_started_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    loaded = subprocess.run([sys.executable, "-c", LOADED], capture_output=True, text=True, check=True).stdout
    monkeypatch.setenv("SAFETY_HARNESS_CACHE", str(tmp_path))
    process = compile_ahead._start()
    assert process is not None
    assert process.stdin is not None
    second = SecondProcess(_checked=True, _process=process)
    while (part := second.finished_part()) is None:
        time.sleep(0.1)
    assert part[0] < part[1]
    assert set(loaded.split()) <= {file.name for file in second._needed or []}
    while process.poll() is None and not any(tmp_path.rglob("*.nbc")):
        time.sleep(0.1)
    assert process.poll() is None
    other = compile_ahead._start()
    assert other is not None
    assert other.wait(60.0) == 0  # one is enough
    process.stdin.close()  # as when the first process is killed
    assert process.wait(60.0) == 0


def test_a_second_process_that_ends_early_leaves_the_part_unknown() -> None:
    program = [sys.executable, "-c", "import sys; sys.stdout.write('[')"]
    with subprocess.Popen(program, stdout=subprocess.PIPE, text=True) as ended:
        ended.wait(60.0)
        second = SecondProcess(_checked=True, _process=ended)
        assert second.finished_part() is None
        assert second.finished_part() is None


def test_it_starts_once(starts: list[int]) -> None:
    watcher = SecondProcess()
    watcher(COMPILING)
    watcher(COMPILING)
    assert starts == [1]


def test_what_will_compile_starts_it_before_it_reads_anything(starts: list[int]) -> None:
    watcher = SecondProcess()
    watcher.start_if_cold()
    watcher(COMPILING)
    assert starts == [1]


def test_it_does_not_start_where_code_is_there(starts: list[int], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compile_ahead, "_is_cold", lambda: False)
    SecondProcess()(COMPILING)
    assert not starts


def test_it_does_not_start_where_code_cannot_be_kept(starts: list[int]) -> None:
    SecondProcess()(Compilation(1, 0.2, going_on=True, unwritable="a read-only disk"))
    assert not starts
