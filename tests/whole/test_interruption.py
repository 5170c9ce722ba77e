"""Ctrl-C and failures at every stage of a command: what was done is kept, and it is said."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from pathlib import Path

import pytest

from safety_harness.base.exceptions import SimulationError
from safety_harness.cell.simulation.pybullet_world import PyBulletWorld
from safety_harness.cli.console import AS_EXPECTED, DIFFERS, INTERRUPTED
from safety_harness.cli.scenario_commands import replay, run
from safety_harness.extensions.pages import run_page as html
from safety_harness.report import run_job as run_module

TEXT = """\
scenario: a short run
duration: 320 ms
tcp start:
  offset: [0 mm, -60 mm, 20 mm]
claims:
  joint speeds within limits: holds
"""


@pytest.fixture
def files(tmp_path: Path) -> list[Path]:
    names = ("first.yaml", "second.yaml", "third.yaml")
    for name in names:
        (tmp_path / name).write_text(TEXT)
    return [tmp_path / name for name in names]


def ctrl_c() -> None:
    os.kill(os.getpid(), signal.SIGINT)


def breaks(how: Callable[[], object], at: int) -> Callable[..., object]:
    """A step of the world that does ``how`` once, in its call number ``at``."""
    step, calls = PyBulletWorld.step, [0]

    def broken(world: PyBulletWorld, command: object) -> bool:
        calls[0] += 1
        if calls[0] == at:
            how()
        return step(world, command)  # type: ignore[arg-type]

    return broken


def fails() -> None:
    raise SimulationError("the world ended")


def has_a_defect() -> None:
    raise ZeroDivisionError("division by zero")


@pytest.mark.parametrize("how", [fails, has_a_defect])
def test_a_run_that_fails_costs_no_other_and_is_not_as_expected(
    how: Callable[[], object],
    files: list[Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(PyBulletWorld, "step", breaks(how, at=50))
    assert run(files, tmp_path / "out") == DIFFERS
    out, err = capsys.readouterr()
    assert (
        out == "2 of 2 verdicts as expected (2 hold), 2 of 3 scenarios run, 1 could not be run to the end\n"
    )
    assert "error: second could not be run to its end" in err
    assert (tmp_path / "out" / "report.html").is_file()


def test_ctrl_c_in_a_run_keeps_it_and_those_before(
    files: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(PyBulletWorld, "step", breaks(ctrl_c, at=50))
    assert run(files, tmp_path / "out") == INTERRUPTED
    out, err = capsys.readouterr()
    assert out.startswith("INCONCLUSIVE  second: ")
    assert "1 of 2 verdicts as expected (1 hold, 1 inconclusive), 2 of 3 scenarios run" in out
    assert "the results of 2 of 3 scenarios are kept; the same command repeats all" in err


def test_ctrl_c_while_files_are_read_runs_nothing(
    files: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(paths: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(run_module, "gather", interrupted)
    assert run(files, tmp_path / "out") == INTERRUPTED
    assert "nothing was run" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("times", [1, 2])
def test_ctrl_c_while_the_report_is_written_lets_it_end_and_a_second_one_gives_it_up(
    times: int,
    files: list[Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    render = html.render

    def interrupted(*arguments: object, **options: object) -> str:
        for _ in range(times):
            ctrl_c()
        return render(*arguments, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(html, "render", interrupted)
    assert run(files[:1], tmp_path / "out") == INTERRUPTED
    err = capsys.readouterr().err
    assert "Ctrl-C once more gives it up" in err
    assert (tmp_path / "out" / "report.html").is_file() == (times == 1)
    assert ("the traces are in" in err) == (times == 2)
    assert (tmp_path / "out" / "traces" / "first.trace").is_file()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_an_interrupted_replay_is_no_difference(
    files: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(files[:1], tmp_path / "out") == AS_EXPECTED
    capsys.readouterr()
    monkeypatch.setattr(PyBulletWorld, "step", breaks(ctrl_c, at=10))
    assert replay(tmp_path / "out" / "traces" / "first.trace") == INTERRUPTED
    out, err = capsys.readouterr()
    assert out == ""
    assert "interrupted by the user, after 9 of 41 ticks" in err
