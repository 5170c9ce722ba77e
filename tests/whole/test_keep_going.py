"""A bad file does not keep others from running, if asked: it is told, counted, and bad input at the end."""

from __future__ import annotations

import json
import os
import sys
import time
from pathlib import Path

import pytest

from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT
from safety_harness.cli.scenario_commands import judge, run
from safety_harness.report.run_job import RunSession
from safety_harness.report.run_result import RunResult
from tests.kinds_of_files import SCENARIO

Captured = pytest.CaptureFixture[str]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two files that run, one that cannot be used, and a plan, which another command takes."""
    texts = {
        "a-bad": SCENARIO.replace("-60 mm", "-60"),
        "b-good": SCENARIO,
        "c-plan": "plan: a plan\nstrata: []\n",
        "d-good": SCENARIO,
    }
    for name, text in texts.items():
        (tmp_path / f"{name}.yaml").write_text(text)
    return tmp_path


def test_the_others_are_run_and_the_end_is_bad_input(folder: Path, tmp_path: Path, capsys: Captured) -> None:
    assert run([folder], tmp_path / "out", keep_going=True) == BAD_INPUT
    out, err = capsys.readouterr()
    assert (
        out == "2 of 2 verdicts as expected (2 hold), 2 of 2 scenarios run, 1 of the inputs cannot be used\n"
    )
    assert f"{folder / 'a-bad.yaml'}:3: tcp start.offset[1]" in err
    assert "left aside, a plan: " in err
    assert sorted(one.name for one in (tmp_path / "out" / "traces").iterdir()) == [
        "b-good.trace",
        "d-good.trace",
    ]
    page = (tmp_path / "out" / "report.html").read_text()
    assert "--keep-going" in page
    assert "Refused." in page
    assert 'class="banner fine"' not in page
    assert 'class="banner doubt" role="note"><strong>2 of 2 verdicts as expected' in page
    refused = json.loads((tmp_path / "out" / "report.json").read_text())["refused"]
    assert [(Path(one["file"]).name, one["line"]) for one in refused] == [
        ("a-bad.yaml", 3),
    ]
    assert refused[0]["reason"].endswith("got -60, which has no unit")
    assert all(one["file"] in page for one in refused)
    assert str(tmp_path) not in page


def test_a_scenario_that_needs_a_package_keeps_others_from_running_only_without_the_option(
    folder: Path, tmp_path: Path, capsys: Captured, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "cv2", None)
    folder = tmp_path / "two"
    folder.mkdir()
    (folder / "good.yaml").write_text(SCENARIO)
    (folder / "rendered.yaml").write_text(SCENARIO + "hand sensor: {kind: overhead, detector: rendered}\n")
    assert run([folder], tmp_path / "out") == BAD_INPUT
    err = capsys.readouterr().err
    assert f"{folder / 'rendered.yaml'}: rendered images: needs cv2, which is not installed" in err
    assert "nothing was run; --keep-going runs the others." in err
    assert run([folder], tmp_path / "out", keep_going=True) == BAD_INPUT
    assert "1 of 1 scenarios run, 1 of the inputs cannot be used" in capsys.readouterr().out
    (refused,) = json.loads((tmp_path / "out" / "report.json").read_text())["refused"]
    assert Path(refused["file"]).name == "rendered.yaml"
    assert "pip install 'hand-safety-harness[images]'" in refused["hint"]


def test_without_the_option_nothing_is_run_and_the_option_is_named(
    folder: Path, tmp_path: Path, capsys: Captured
) -> None:
    assert run([folder], tmp_path / "out") == BAD_INPUT
    out, err = capsys.readouterr()
    assert out == ""
    assert "1 of the inputs cannot be used; nothing was run; --keep-going runs the others." in err
    assert not (tmp_path / "out").exists()


def test_with_nothing_bad_the_option_changes_nothing(folder: Path, tmp_path: Path) -> None:
    assert run([folder / "b-good.yaml"], tmp_path / "out", keep_going=True) == AS_EXPECTED


def test_with_nothing_good_nothing_is_run(folder: Path, tmp_path: Path, capsys: Captured) -> None:
    assert run([folder / "a-bad.yaml"], tmp_path / "out", keep_going=True) == BAD_INPUT
    assert "1 of the inputs cannot be used; nothing was run." in capsys.readouterr().err


def test_traces_that_can_be_judged_are_judged(folder: Path, tmp_path: Path, capsys: Captured) -> None:
    run([folder / "b-good.yaml"], tmp_path / "out")
    good, bad = tmp_path / "out" / "traces" / "b-good.trace", tmp_path / "bad.trace"
    bad.write_bytes(good.read_bytes()[:300])
    capsys.readouterr()
    assert judge([bad, good]) == BAD_INPUT
    assert capsys.readouterr().out == ""
    assert judge([bad, good], keep_going=True) == BAD_INPUT
    out, err = capsys.readouterr()
    assert "\nholds  joint speeds" in out
    assert "1 of 2 traces judged" in err


def test_a_trace_of_an_earlier_run_stays_but_no_pattern_takes_it_for_one_of_this_run(
    folder: Path, tmp_path: Path, capsys: Captured
) -> None:
    run([folder / "b-good.yaml"], tmp_path / "out")
    traces = tmp_path / "out" / "traces"
    bytes_then = (traces / "b-good.trace").read_bytes()
    (folder / "b-good.yaml").rename(folder / "renamed.yaml")
    (traces / "notes.txt").write_text("mine")
    time.sleep(0.2)
    assert run([folder / "renamed.yaml"], tmp_path / "out") == AS_EXPECTED
    assert sorted(one.name for one in traces.iterdir()) == [
        *("b-good.trace.earlier", "notes.txt", "renamed.trace")
    ]
    assert (traces / "b-good.trace.earlier").read_bytes() == bytes_then
    assert f"of an earlier run: {traces / 'b-good.trace'}" in capsys.readouterr().err
    assert judge([traces / "b-good.trace.earlier"]) == AS_EXPECTED  # whoever names it may


def test_of_earlier_runs_nothing_is_lost_and_no_foreign_folder_is_touched(tmp_path: Path) -> None:
    """A second run's trace does not take the place of the first one's; its MCAP file goes with it."""
    names = ("a.trace", "a.trace.earlier", "a/run.mcap", "a/LOG.yaml", "this.trace")
    for name in (*(f"traces/{name}" for name in names), "traces-mine/a.trace"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(name)
        os.utime(tmp_path / name, (1e9, 1e9))
    session = RunSession(RunResult(), tmp_path)
    session.written.add(tmp_path / "traces" / "this.trace")  # on a disk whose clock is behind
    session.run([])
    there = sorted(one for one in tmp_path.glob("traces*/**/*") if one.is_file())
    assert {one.relative_to(tmp_path).as_posix(): one.read_text() for one in there} == {
        "traces/a.trace.earlier": "traces/a.trace.earlier",
        "traces/a.trace.earlier-2": "traces/a.trace",
        "traces/a/run.mcap.earlier": "traces/a/run.mcap",
        "traces/a/LOG.yaml.earlier": "traces/a/LOG.yaml",
        "traces/this.trace": "traces/this.trace",
        "traces-mine/a.trace": "traces-mine/a.trace",
    }


def test_a_link_to_a_trace_that_is_gone_is_renamed_too(tmp_path: Path) -> None:
    link = tmp_path / "traces" / "gone.trace"
    link.parent.mkdir()
    link.symlink_to("nowhere")
    os.utime(link, (1e9, 1e9), follow_symlinks=False)
    RunSession(RunResult(), tmp_path).run([])
    assert link.with_name("gone.trace.earlier").is_symlink()
