"""Findings of a search, repeated in every installed reference: whether they agree, and what physics adds."""

from __future__ import annotations

import json
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

import pytest
from examples import VISIT, scenario

from safety_harness.admission.admit import admit
from safety_harness.admission.trial import run_trial
from safety_harness.base.exceptions import SimulationError
from safety_harness.cell.simulation.worlds import (
    KINEMATIC,
    PYBULLET,
    OpensWorld,
    WorldEntry,
    defaulted,
    references,
)
from safety_harness.cli.console import AS_EXPECTED, DIFFERS
from safety_harness.cli.fuzz import fuzz
from safety_harness.cli.scenario_commands import run
from safety_harness.extensions.attribution import search_attribution
from safety_harness.extensions.worlds.mujoco_entry import MUJOCO
from safety_harness.scenario.read import read_scenario
from safety_harness.search import session as search_session
from safety_harness.search.confirm import physics_of
from tests.search.short_space import TEXT
from tests.whole.test_without_pybullet import SHORT


@pytest.fixture
def space(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(search_session, "SHRINKING_RUNS", 25)
    monkeypatch.setattr(search_session, "MOST_SHRUNK", 1)
    monkeypatch.setattr(search_attribution, "MOST_ATTRIBUTED", 1)
    path = tmp_path / "space.yaml"
    path.write_text(TEXT)
    return path


def _fails() -> OpensWorld:
    raise SimulationError("an engine that fails")


def test_both_references_repeat_a_finding_and_say_that_physics_had_no_part(
    space: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert fuzz(space, out=tmp_path / "out", budget=12) == DIFFERS
    found = json.loads((tmp_path / "out" / "findings.json").read_text())
    assert found["confirmed_in"] == ["PyBullet", "MuJoCo"]
    assert found["confirmed"] >= 1
    assert found["physics_had_a_part"] == 0
    (file,) = (tmp_path / "out").glob("*.yaml")
    assert "repeated in PyBullet and MuJoCo; physics had no part: joints at most" in file.read_text()
    assert "physics had a part in 0" in capsys.readouterr().err


def test_references_that_disagree_are_a_finding_and_confirm_nothing(
    space: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    other = WorldEntry(name="other", label="other", load=_fails, reference=True)
    monkeypatch.setattr(search_session, "references", lambda: iter((PYBULLET, other)))
    fuzz(space, out=tmp_path / "out", budget=12)
    found = json.loads((tmp_path / "out" / "findings.json").read_text())
    assert found["confirmed"] == 0
    assert found["not_confirmed"]
    assert not list((tmp_path / "out").glob("*.yaml"))
    assert "REFERENCES DISAGREE" in capsys.readouterr().out


def test_a_reference_without_a_renderer_has_no_say_about_rendered_images() -> None:
    rendered = read_scenario("shipped:rendered-images")
    assert [world.label for world in references() if world.makes_images_of(rendered)] == ["PyBullet"]
    assert [world.label for world in references() if world.makes_images_of(scenario())] == [
        "PyBullet",
        "MuJoCo",
    ]


def test_evidence_has_the_hash_of_the_engine_and_not_of_its_binding() -> None:
    made = run_trial(admit(replace(scenario(VISIT), duration_s=0.1)), world=MUJOCO).provenance
    assert any("libmujoco.so" in name for name, _ in made.files)
    assert dict(made.libraries)["mujoco-core"] == version("mujoco-core")


def test_physics_has_a_part_where_motors_are_too_weak() -> None:
    strong = admit(replace(scenario(VISIT), duration_s=1.0))
    weak = replace(strong, arm=replace(strong.arm, effort_limit=0.2 * strong.arm.effort_limit))
    model = run_trial(strong, world=KINEMATIC)
    assert physics_of(run_trial(strong, world=MUJOCO), model)[0] is False
    assert physics_of(run_trial(weak, world=MUJOCO), model)[0] is True
    assert physics_of(SimulationError("no run"), model)[0] is True
    assert physics_of(model, SimulationError("no renderer"))[1].startswith(
        "whether physics had a part is unknown"
    )


def test_without_pybullet_a_run_takes_mujoco_and_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "short.yaml").write_text(SHORT)
    monkeypatch.setattr(type(PYBULLET), "is_installed", property(lambda world: world is not PYBULLET))
    assert run([tmp_path / "short.yaml"], tmp_path / "out") == AS_EXPECTED
    out, err = capsys.readouterr()
    assert err.splitlines()[0] == defaulted(MUJOCO)
    assert "in MuJoCo, seed 0" in out.splitlines()[0]
