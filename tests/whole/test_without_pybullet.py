"""Without PyBullet: what needs it says so in one line, the rest works and says what was not confirmed."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from examples import VISIT, scenario

from safety_harness.admission.admit import admit
from safety_harness.admission.trial import run_all, run_trial
from safety_harness.base.exceptions import MissingPackageError
from safety_harness.cell.simulation.worlds import KINEMATIC, PYBULLET, defaulted
from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT, DIFFERS
from safety_harness.cli.fuzz import fuzz
from safety_harness.cli.scenario_commands import run, validate
from safety_harness.extensions.attribution import search_attribution
from safety_harness.extensions.attribution.commands.attribute_lines import attribute_runs
from safety_harness.search import session as search_session
from safety_harness.search.result_lines import nothing_confirmed
from safety_harness.testing.session import Session, begin
from safety_harness.testing.simulating import Simulate
from safety_harness.trace.provenance import provenance
from tests.search.short_space import TEXT

SHORT = """\
scenario: a hand far away
duration: 100 ms
avoider: opposite pose
tcp start:
  offset: [0 mm, -20 mm, 20 mm]
claims:
  joint speeds within limits: holds
"""
NEEDS = "the world PyBullet: needs pybullet, which is not installed: "


def without_pybullet(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    for engine in ("pybullet", "mujoco"):
        monkeypatch.setitem(sys.modules, engine, None)
    for name in ("cell.simulation.pybullet_world", "cell.simulation.cell", "cell.simulation.engine"):
        monkeypatch.delitem(sys.modules, f"safety_harness.{name}", raising=False)
    monkeypatch.delitem(sys.modules, "safety_harness.extensions.worlds.mujoco_world", raising=False)
    provenance.cache_clear()  # which was told of PyBullet, and is to forget that there is none
    yield
    provenance.cache_clear()


@pytest.fixture(autouse=True)
def _without_pybullet(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    yield from without_pybullet(monkeypatch)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "short.yaml"
    path.write_text(SHORT)
    return path


def test_run_takes_the_world_that_does_without_and_says_so_in_one_line(
    file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run([file], tmp_path / "out") == AS_EXPECTED
    out, err = capsys.readouterr()
    assert err.splitlines()[0] == defaulted(KINEMATIC)
    assert "in the kinematic world, seed 0" in out.splitlines()[0]
    assert '"world": "kinematic"' in (tmp_path / "out" / "report.json").read_text()
    assert "--world kinematic" in (tmp_path / "out" / "report.html").read_text()


def test_a_world_that_is_asked_for_is_not_replaced(
    file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run([file], tmp_path / "out", world="PyBullet") == BAD_INPUT
    assert NEEDS in capsys.readouterr().err
    assert run([file], tmp_path / "out", world="kinematik") == BAD_INPUT
    assert 'did you mean "kinematic"' in capsys.readouterr().err


def test_validate_needs_none(file: Path) -> None:
    assert validate([file]) == AS_EXPECTED


def test_a_world_that_is_missing_is_no_failure_of_a_run() -> None:
    admitted = admit(scenario(VISIT, duration_s=0.1))
    with pytest.raises(MissingPackageError, match=NEEDS):
        run_trial(admitted)
    with pytest.raises(MissingPackageError, match=NEEDS):
        list(run_all([admitted], PYBULLET))


def test_fuzz_works_and_says_everywhere_that_nothing_was_confirmed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(search_session, "SHRINKING_RUNS", 25)
    monkeypatch.setattr(search_session, "MOST_SHRUNK", 1)
    monkeypatch.setattr(search_attribution, "MOST_ATTRIBUTED", 1)
    (tmp_path / "space.yaml").write_text(TEXT)
    out = tmp_path / "out"
    assert fuzz(tmp_path / "space.yaml", out=out, budget=12) == DIFFERS
    said = capsys.readouterr().err
    reason = nothing_confirmed(KINEMATIC)
    assert reason in said
    (found,) = out.glob("*.yaml")
    assert f"run {found} --world kinematic" in said
    assert reason in found.read_text()
    assert "world kinematic" in found.read_text()
    assert json.loads((out / "findings.json").read_text())["confirmed"] == 0
    page = (out / "fuzz.html").read_text()
    assert reason in page
    assert "repeated in" not in page
    assert "below is confirmed" not in page
    assert run([found], tmp_path / "again", world="kinematic") == AS_EXPECTED


def test_attribute_confirms_only_where_it_can(
    file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(MissingPackageError, match=NEEDS):
        attribute_runs([file], None, None, confirm=True)
    assert attribute_runs([file], None, None, confirm=False) == AS_EXPECTED


def test_simulate_of_a_test_runs_in_the_world_of_its_session() -> None:
    example = scenario(duration_s=0.1)
    before = begin(Session(world="kinematic"))
    try:
        assert Simulate()(example).provenance.world == KINEMATIC.name
        begin(Session())
        assert Simulate()(example).provenance.world == KINEMATIC.name
        begin(Session(world="PyBullet"))
        with pytest.raises(MissingPackageError, match=NEEDS):
            Simulate()(example)
    finally:
        begin(before)
