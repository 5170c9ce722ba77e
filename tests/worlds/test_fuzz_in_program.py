"""``fuzz`` and ``attribute`` in the user's own simulator: searched and repeated there."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import safety_harness
from safety_harness.base.exceptions import InadmissibleError
from safety_harness.cli.console import BAD_INPUT, DIFFERS
from safety_harness.cli.fuzz import fuzz
from safety_harness.extensions.worlds.program import simulator
from safety_harness.search import session as search_session
from tests.search.short_space import TEXT

KINEMATIC_CELL = Path(__file__).parents[2] / "examples" / "worlds" / "kinematic_cell.py"


@pytest.fixture(autouse=True)
def _short(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(search_session, "SHRINKING_RUNS", 5)
    monkeypatch.setattr(search_session, "MOST_SHRUNK", 1)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "short.yaml").write_text(TEXT)
    yield
    simulator.cache_clear()


def command(file: Path) -> str:
    return f"exec:{sys.executable} {file}"


def found_in(folder: Path) -> dict[str, object]:
    """Return what a search found, without its world; margins to 1e-12, as bounds are another sum there."""
    text = (folder / "findings.json").read_text()
    data = json.loads(text, parse_float=lambda number: round(float(number), 12))
    assert isinstance(data, dict)
    keys = ("tried", "claims", "distinct", "confirmed", "confirmed_in", "not_confirmed")
    return {key: data[key] for key in keys}


def test_a_simulator_that_moves_as_our_own_world_has_the_findings_of_our_own_world() -> None:
    theirs, ours = Path("theirs"), Path("ours")
    assert fuzz(Path("short.yaml"), out=ours, budget=12) == DIFFERS
    assert fuzz(Path("short.yaml"), out=theirs, budget=12, world=command(KINEMATIC_CELL)) == DIFFERS
    assert found_in(theirs) == found_in(ours)
    page = (theirs / "fuzz.html").read_text()
    assert f"The search runs in the simulator {command(KINEMATIC_CELL)}" in page
    assert "No verdict differs between the two" not in page  # that was measured of another world
    assert f"--world '{command(KINEMATIC_CELL)}'" in page.replace("&#39;", "'")


def test_a_simulator_whose_joints_do_not_follow_is_refused_before_any_run() -> None:
    text = KINEMATIC_CELL.read_text()
    lame = text.replace('speeds_radps = message["joint_velocity_radps"]', "speeds_radps = [0.0] * 6")
    assert lame != text
    Path("lame.py").write_text(lame)
    with pytest.raises(InadmissibleError, match="while its set point asks for"):
        safety_harness.fuzz("short.yaml", budget=4, world=command(Path("lame.py")))


def test_a_world_does_not_confirm_its_own_findings() -> None:
    found = safety_harness.fuzz("short.yaml", budget=4, world="PyBullet")
    assert found.findings.found_any
    assert "PyBullet" not in found.session.confirmed_in
    assert "PyBullet" not in map(str, found.session.references)


@pytest.mark.parametrize("program", ["no_such_file.py", "silent.py"])
def test_a_program_that_is_no_simulator_is_bad_input_before_any_run(
    program: str, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("silent.py").write_text("print('hello')\n")
    assert fuzz(Path("short.yaml"), budget=4, world=command(Path(program))) == BAD_INPUT
    assert "tried" not in capsys.readouterr().err


def test_the_cause_of_a_violation_is_the_same_in_a_simulator_that_moves_as_our_own_world() -> None:
    fuzz(Path("short.yaml"), out=Path("found"), budget=12)
    (file,) = Path("found").glob("*.yaml")
    theirs, ours = (safety_harness.attribute(file, world=world) for world in (command(KINEMATIC_CELL), None))
    assert [cause.summary for cause in theirs.attributions] == [cause.summary for cause in ours.attributions]
    assert theirs.attributions
    assert command(KINEMATIC_CELL) in repr(theirs)


def test_a_violation_that_the_named_world_does_not_show_is_not_attributed_there() -> None:
    fuzz(Path("short.yaml"), out=Path("found"), budget=12)
    (file,) = Path("found").glob("*.yaml")
    Path("fails.py").write_text(KINEMATIC_CELL.read_text().replace("tick=tick,", "tick=tick + (tick == 30),"))
    (cause,) = safety_harness.attribute(file, world=command(Path("fails.py"))).attributions
    assert cause.summary.startswith(
        f"not attributed: the replay in the simulator {command(Path('fails.py'))} fails: "
    )
