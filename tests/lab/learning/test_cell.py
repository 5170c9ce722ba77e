"""The cell that a network is made for, and that its file says so."""

from __future__ import annotations

from pathlib import Path

import pytest

from safety_harness.base.exceptions import DatasetError, ModelError
from safety_harness.base.settings import DEFAULTS
from safety_harness.base.shipped.contents import located
from safety_harness.cell.avoidance.model_file import load_model, refuse_foreign_cell
from safety_harness.extensions.lab.commands.learning import MODEL, dataset, train
from safety_harness.extensions.lab.learning.cell import UR10_CELL, training_cell
from safety_harness.extensions.lab.learning.dataset import seen
from safety_harness.extensions.lab.learning.manifest import load_dataset
from safety_harness.scenario.read import read_scenario

UR5 = "shipped:robot-ur5"


def test_without_a_scenario_it_is_the_ur10s() -> None:
    assert training_cell(None) is UR10_CELL
    assert UR10_CELL.arm == "UR10"


def test_a_scenario_gives_its_arm_and_settings() -> None:
    cell = training_cell(UR5)
    assert cell.arm == "UR5"
    assert cell.settings == read_scenario(located(UR5)).settings != DEFAULTS


def test_an_arm_that_does_not_reach_what_it_would_be_shown_is_refused(tmp_path: Path) -> None:
    text = located("shipped:hand-stays").read_text()
    (tmp_path / "far.yaml").write_text(text.replace("robot: UR10\n", "") + "robot: UR3\n")
    with pytest.raises(DatasetError, match="out of reach") as caught:
        training_cell(str(tmp_path / "far.yaml"))
    assert caught.value.place.field == "--robot"


def test_a_network_of_another_cell_is_for_that_arm_and_no_other(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    settings = training_cell(UR5).settings
    assert dataset(tmp_path / "data", tcps=30, candidates=10, hands=10, robot=UR5) == 0
    made = load_dataset(tmp_path / "data")
    assert (made.arm, made.settings.cell, made.space) == ("UR5", settings.cell, seen(settings))
    assert train("trial-deterministic", data=tmp_path / "data", out=tmp_path) == 0
    assert "made for the arm UR5" in capsys.readouterr().out
    model = load_model(tmp_path / MODEL)
    refuse_foreign_cell(model, settings, tmp_path / MODEL)
    with pytest.raises(ModelError, match="of the arm UR5"):
        refuse_foreign_cell(model, DEFAULTS, tmp_path / MODEL)


def test_data_have_their_cell_already(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert train(data=tmp_path, robot=UR5) == 2
    assert "--robot\n  expected no --data" in capsys.readouterr().err
