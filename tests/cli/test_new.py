"""``safety-harness new``: every template runs as it is, exercises what it claims, and overwrites nothing."""

from __future__ import annotations

import io
import sys
from pathlib import Path

import pytest
from pytest_sessions import Sessions
from typer.testing import CliRunner

from safety_harness.admission.admit import admit
from safety_harness.admission.trial import judge, run_kinematic
from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT, DIFFERS, INTERRUPTED
from safety_harness.cli.main import app
from safety_harness.cli.new import FOLDER, TEMPLATES, new
from safety_harness.cli.run import run
from safety_harness.cli.validate import validate
from safety_harness.scenario.layout import laid_out
from safety_harness.scenario.read import read_scenario
from safety_harness.space.read import read_space

Captured = pytest.CaptureFixture[str]


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture(params=sorted({*TEMPLATES} - {"space"}))
def written(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """The scenario that a template writes, in a folder and under a name with spaces."""
    folder = tmp_path / "a cell"
    folder.mkdir()
    assert new(request.param, folder / "my 1st cell.yaml") == AS_EXPECTED
    return folder / "my 1st cell.yaml"


def test_a_template_is_valid_commented_and_laid_out_well(written: Path) -> None:
    assert validate([written]) == AS_EXPECTED
    text = written.read_text()
    assert "safety-harness run 'my 1st cell.yaml'" in text
    assert "@" not in "".join(file.read_text() for file in written.parent.iterdir() if file.suffix != ".py")
    assert laid_out(text) == text


def test_every_claim_of_a_template_is_exercised_in_the_kinematic_world(written: Path) -> None:
    scenario = read_scenario(written)
    evaluations = judge(run_kinematic(admit(scenario)))
    assert len(evaluations) >= 4
    for claim, evaluation in zip(scenario.claims, evaluations, strict=True):
        assert evaluation.exercised, evaluation
        assert evaluation.verdict is claim.expected, evaluation


def test_a_template_runs_as_it_is(written: Path) -> None:
    pytest.importorskip("pybullet")
    assert run([written], written.parent / "out") == AS_EXPECTED


def test_a_space_is_laid_out_well_and_exercises_every_claim_in_every_draw(tmp_path: Path) -> None:
    file = tmp_path / "my cell.yaml"
    assert new("space", file) == AS_EXPECTED
    text = file.read_text()
    assert "safety-harness fuzz 'my cell.yaml'" in text
    assert laid_out(text) == text
    for scenario in read_space(file).draws(1, 5):
        assert all(evaluation.exercised for evaluation in judge(run_kinematic(admit(scenario)))), scenario


def test_the_suite_of_an_avoider_passes_and_sees_a_broken_one(tmp_path: Path, sessions: Sessions) -> None:
    pytest.importorskip("pybullet")
    assert new("policy", tmp_path / "my cell.yaml") == AS_EXPECTED
    avoider = tmp_path / "my_cell_avoider.py"
    suite = ("-q", "-p", "no:cacheprovider", "test_my_cell.py")
    done = sessions(tmp_path, *suite)
    assert (done.returncode, "3 passed" in done.stdout) == (0, True), done.stdout
    avoider.write_text(avoider.read_text().replace("STEP_M = 0.1", "STEP_M = 100.0"))
    done = sessions(tmp_path, *suite)
    assert (done.returncode, "1 failed" in done.stdout) == (1, True), done.stdout


def test_two_people_of_whom_nobody_comes_near_are_told_so(tmp_path: Path, capsys: Captured) -> None:
    pytest.importorskip("pybullet")
    file = tmp_path / "two.yaml"
    assert new("two-people", file) == AS_EXPECTED
    text = file.read_text().replace("stop at distance: 100 mm", "stop at distance: 600 mm")
    file.write_text(
        text.replace("[1050 mm, -500 mm", "[1350 mm, -800 mm").replace("[1150 mm, 150", "[1390 mm, 190")
    )
    assert run([file], tmp_path / "out") == DIFFERS
    told = capsys.readouterr().err
    assert "error: 4 of 4 claims were never exercised, and nothing is shown of:" in told
    assert told.count("mm exercises it") >= 4
    assert "safety-harness show" in told


def test_every_file_of_the_folder_belongs_to_a_template() -> None:
    known = {f"{name}.yaml" for name in TEMPLATES}
    known |= {source for template in TEMPLATES.values() for source, _ in template.beside}
    assert known == {file.name for file in FOLDER.iterdir()}


def test_nothing_is_overwritten_and_then_nothing_is_written(tmp_path: Path, capsys: Captured) -> None:
    beside = tmp_path / "mine_avoider.py"
    beside.write_text("keep me\n")
    assert new("policy", tmp_path / "mine.yaml") == BAD_INPUT
    assert [file.name for file in tmp_path.iterdir()] == [beside.name]
    assert beside.read_text() == "keep me\n"
    (tmp_path / "link.yaml").symlink_to(tmp_path / "gone")
    assert new("reaching", tmp_path / "link.yaml") == BAD_INPUT
    assert new("reaching", tmp_path / "gone" / "mine.yaml") == BAD_INPUT
    assert "Traceback" not in capsys.readouterr().err


@pytest.mark.parametrize("name", ["mine.py", "a\nb.yaml", "..", "/"])
def test_a_name_that_is_none_of_a_scenario_is_refused(name: str, tmp_path: Path, capsys: Captured) -> None:
    assert new("reaching", tmp_path / name) == BAD_INPUT
    assert "Traceback" not in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_name_without_a_suffix_gets_one(tmp_path: Path) -> None:
    assert new("reaching", tmp_path / "my-cell") == AS_EXPECTED
    assert (tmp_path / "my-cell.yaml").is_file()


@pytest.mark.parametrize("given", [["my-cell.yaml"], ["reachin", "x.yaml"], []])
def test_without_a_template_they_are_listed_where_nobody_can_be_asked(
    given: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(app, ["new", *given])
    assert done.exit_code == BAD_INPUT
    assert all(name in done.stderr for name in TEMPLATES)
    assert not list(tmp_path.iterdir())


def test_list_says_what_each_template_is() -> None:
    done = CliRunner().invoke(app, ["new", "--list"])
    assert done.exit_code == AS_EXPECTED
    assert [line.split()[0] for line in done.stdout.splitlines()] == list(TEMPLATES)


def test_a_terminal_is_asked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Captured) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "stdin", Terminal("two-people\nours.yaml\n"))
    assert new() == AS_EXPECTED
    assert (tmp_path / "ours.yaml").is_file()
    monkeypatch.setattr(sys, "stdin", Terminal("no such\n"))
    assert new() == BAD_INPUT
    monkeypatch.setattr(sys, "stdin", Terminal(""))
    assert new() == INTERRUPTED
    assert "nothing was written" in capsys.readouterr().err


def test_what_to_type_next_is_said_with_names_quoted(tmp_path: Path, capsys: Captured) -> None:
    assert new("policy", tmp_path / "my cell.yaml") == AS_EXPECTED
    told = capsys.readouterr()
    assert "my_cell_avoider.py" in told.out
    assert f"safety-harness run '{tmp_path}/my cell.yaml'" in told.err
    assert f"pytest {tmp_path}/test_my_cell.py" in told.err
