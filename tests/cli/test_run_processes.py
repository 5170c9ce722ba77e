"""Runs of many files in several processes are those of one, and what is finished when it ends is kept."""

from __future__ import annotations

import json
from collections.abc import Iterator
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import pytest

from safety_harness.admission import run_processes as processes
from safety_harness.base import pool as base_pool
from safety_harness.cell.simulation.worlds import KINEMATIC
from safety_harness.cli.console import AS_EXPECTED, DIFFERS, INTERRUPTED
from safety_harness.cli.run import run
from safety_harness.trace.compare import first_difference
from safety_harness.trace.store import load_trace

SCENARIO = """\
scenario: number {k}
duration: 200 ms
avoider: {avoider}
tcp start:
  offset: [0 mm, {k} mm, 20 mm]
claims:
  joint speeds within limits: holds
"""
MINE = """\
from safety_harness import Proposal
class Mine:
    name = "mine"
    def propose(self, **_):
        return Proposal([0.7, 0.0, 0.4])
"""


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """Four of what ships and one of a user's own."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(processes, "FEWEST_RUNS", 4)
    (tmp_path / "mine.py").write_text(MINE)
    made = []
    for k in range(5):
        made.append(tmp_path / f"s{k}.yaml")
        avoider = "mine.py:Mine" if k == 2 else "opposite pose"
        made[-1].write_text(SCENARIO.format(k=k, avoider=avoider))
    return made


class AtOnce:
    """An executor that makes each run in this process when it is asked for, or never."""

    def __init__(self, most: int) -> None:
        self.most, self.asked = most, 0

    def submit(self, function: Any, *arguments: Any) -> Future[Any]:
        future: Future[Any] = Future()
        self.asked += 1
        if self.asked <= self.most:
            future.set_result(function(*arguments))
        else:
            future.result = lambda timeout=None: (_ for _ in ()).throw(KeyboardInterrupt)  # type: ignore[method-assign]
        return future


@pytest.fixture
def executor(monkeypatch: pytest.MonkeyPatch) -> AtOnce:
    made = AtOnce(most=100)

    def pool(jobs: int) -> Any:
        from contextlib import contextmanager

        @contextmanager
        def given() -> Iterator[AtOnce]:
            yield made

        return given()

    monkeypatch.setattr(base_pool, "pool", pool)
    return made


def test_the_traces_are_those_of_one_process(files: list[Path], tmp_path: Path) -> None:
    assert run(files, tmp_path / "one", world=KINEMATIC, jobs=1) == AS_EXPECTED
    assert run(files, tmp_path / "two", world=KINEMATIC, jobs=2) == AS_EXPECTED
    names = sorted(file.name for file in (tmp_path / "one" / "traces").iterdir())
    assert len(names) == 5
    for name in names:
        one, two = (load_trace(tmp_path / out / "traces" / name) for out in ("one", "two"))
        assert first_difference(one, two) is None
        assert one.scenario == two.scenario
    reports = [json.loads((tmp_path / out / "report.json").read_text())["runs"] for out in ("one", "two")]
    assert [one["scenario"] for one in reports[0]] == [one["scenario"] for one in reports[1]]


def test_what_is_not_ours_runs_in_this_process(files: list[Path], tmp_path: Path, executor: AtOnce) -> None:
    assert run(files, tmp_path / "out", world=KINEMATIC, jobs=2) == AS_EXPECTED
    assert executor.asked == 4


def test_few_runs_have_no_process_of_their_own(files: list[Path], tmp_path: Path, executor: AtOnce) -> None:
    assert run(files[:3], tmp_path / "out", world=KINEMATIC, jobs=2) == AS_EXPECTED
    assert executor.asked == 0


def test_after_ctrl_c_what_has_come_to_its_end_elsewhere_is_kept(
    files: list[Path], tmp_path: Path, executor: AtOnce
) -> None:
    executor.most = 1
    assert run(files, tmp_path / "out", world=KINEMATIC, jobs=2) == INTERRUPTED
    assert [file.name for file in (tmp_path / "out" / "traces").iterdir()] == ["s0.trace"]
    assert json.loads((tmp_path / "out" / "report.json").read_text())["interrupted"]


def test_what_is_raised_elsewhere_costs_its_run_alone(
    files: list[Path],
    tmp_path: Path,
    executor: AtOnce,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    class UnpicklableError(Exception):
        def __reduce__(self) -> Any:
            raise TypeError("no")

    def broken(admitted: Any, **_: Any) -> Any:
        raise UnpicklableError("the motor burns")

    monkeypatch.setattr(processes, "run_trial", broken)
    assert run(files, tmp_path / "out", world=KINEMATIC, jobs=2) == DIFFERS
    assert (
        capsys.readouterr().err.count("could not be run to its end: RuntimeError: UnpicklableError: the") == 4
    )
    assert [file.name for file in (tmp_path / "out" / "traces").iterdir()] == ["s2.trace"]
