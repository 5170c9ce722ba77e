"""``safety-harness reproduce`` from nothing to page and JSON, at the scale that exists for this."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from safety_harness.base.exceptions import MissingPackageError
from safety_harness.cli import main
from safety_harness.cli.main import app
from safety_harness_paper import reproduce as command
from safety_harness_paper.plan import PARTS
from safety_harness_paper.reproduce import DATA, PAGE, WORK, reproduce
from safety_harness_paper.safety import SYSTEMS
from safety_harness_paper.work import Done, Workshop

WORDS = {"reproduced", "direction only", "not reproduced", "no figure of the paper"}


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("reproduction")
    assert reproduce(["all"], scale="quick", out=out, jobs=1) == 0
    return out


def test_all_parts_are_measured_judged_and_on_a_page_that_needs_nothing_else(finished: Path) -> None:
    found = json.loads((finished / DATA).read_text("utf-8"))
    assert found["format"] == "safety-harness reproduction 1"
    assert [one["name"] for one in found["results"]] == [part.name for part in PARTS]
    assert found["about"]["missing"] == []
    for one in found["results"]:
        assert one["word"] in WORDS
        assert one["why"]
        assert one["claims"]
    table1 = found["results"][0]
    assert [row["paper"] for row in table1["comparisons"][:5]] == [0.80, 0.84, 0.85, 0.85, 0.85]
    assert all(row["ours"]["low"] <= row["ours"]["value"] for row in table1["comparisons"])
    page = (finished / PAGE).read_text("utf-8")
    for one in found["results"]:
        assert f'id="{one["name"]}"' in page
        for row in one["comparisons"]:
            assert row["ours_words"] in page
    assert "Quick scale." in page
    assert page.count("<svg") > 10
    assert 1 <= page.count('<figure class="replay"') <= len(SYSTEMS)
    assert not re.search(r"(src|href)=\"(?!#|data:)", page)
    ids = re.findall(r'\bid="([^"]+)"', page)
    assert len(ids) == len(set(ids))
    for reference in re.findall(r'href="#([^"]+)"', page):
        assert reference in ids


def test_asking_again_measures_nothing_and_says_the_same(
    finished: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    shutil.copytree(finished, tmp_path, dirs_exist_ok=True)
    data = tmp_path / DATA
    before = {one["name"]: one for one in json.loads(data.read_text("utf-8"))["results"]}

    def measure_nothing(*arguments: object) -> Done:
        raise AssertionError("measured again")

    monkeypatch.setattr("safety_harness_paper.work._do", measure_nothing)
    assert reproduce(["figure5", "table4"], scale="quick", out=tmp_path, jobs=1) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[-1] for line in lines] != []
    assert [("table4" in lines[0]), ("figure5" in lines[1]), len(lines)] == [True, True, 2]
    assert json.loads(data.read_text("utf-8"))["results"] == [before["table4"], before["figure5"]]
    assert reproduce(["table4"], scale="quick", out=tmp_path, jobs=1) == 0
    assert json.loads(data.read_text("utf-8"))["results"] == [before["table4"]]


def test_ctrl_c_keeps_what_is_finished_and_the_page_says_what_is_missing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def stop(self: Workshop, tasks: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Workshop, "run", stop)
        assert reproduce(["figure5"], scale="quick", out=tmp_path, jobs=1) == 130
    said = capsys.readouterr().err
    assert "To go on: safety-harness reproduce figure5 --scale quick" in said
    assert "figure5: 1 measurement is still to be made" in (tmp_path / PAGE).read_text("utf-8")
    assert reproduce(["figure5"], scale="quick", out=tmp_path, jobs=1) == 0
    assert "Not complete." not in (tmp_path / PAGE).read_text("utf-8")


def test_a_step_that_fails_is_on_the_page_and_in_the_exit_code(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*arguments: object) -> Done:
        raise ValueError("no candidates today")

    monkeypatch.setattr("safety_harness_paper.work._do", broken)
    assert reproduce(["figure5"], scale="quick", out=tmp_path, jobs=1) == 1
    assert "no candidates today" in (tmp_path / PAGE).read_text("utf-8")
    assert "missing: figure5" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["table6"], ["WHAT", "table1", "'table6'"]),
        (["all", "--scale", "huge"], ["--scale", "quick, default, paper", "'huge'"]),
        (["all", "--jobs", "0"], ["--jobs", "at least 1", "0"]),
    ],
)
def test_a_mistake_is_told_before_anything_is_measured(
    arguments: list[str], words: list[str], tmp_path: Path
) -> None:
    done = CliRunner().invoke(app, ["reproduce", *arguments, "--out", str(tmp_path / "out")])
    assert done.exit_code == 2
    for word in words:
        assert word in done.stderr
    assert not (tmp_path / "out").exists()


def test_without_pytorch_it_says_how_to_install_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(command, "find_spec", lambda name: None)
    assert reproduce(["figure5"], scale="quick", out=tmp_path) == 2
    assert "pip install ./paper" in capsys.readouterr().err


def test_a_place_that_cannot_be_written_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("")
    assert reproduce(["figure5"], scale="quick", out=tmp_path / "file", jobs=1) == 2
    assert "a place that can be written" in capsys.readouterr().err
    assert WORK == "work"


def test_without_the_package_the_command_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(main, "parts", lambda point: ())
    monkeypatch.setattr(typer.testing, "_get_command", typer.main.get_command)  # tests keep that of all parts
    answer = CliRunner().invoke(app, ["reproduce", "all", "--scale", "quick"])
    assert isinstance(answer.exception, MissingPackageError), repr(answer.exception) + answer.output
    assert "pip install ./paper" in str(answer.exception)
