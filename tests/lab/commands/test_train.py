"""``safety-harness train`` from a data set to a model file, on a data set of 30 TCPs and 10 hands."""

from __future__ import annotations

from pathlib import Path

import pytest

from safety_harness.base.settings import DEFAULTS
from safety_harness.cell.avoidance.model_file import Dropout, load_model
from safety_harness.extensions.lab.commands.learning import MODEL, train
from safety_harness.extensions.lab.learning.dataset import generate, seen
from safety_harness.extensions.lab.learning.manifest import data_hash, load_dataset, save_dataset


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("data")
    save_dataset(generate(DEFAULTS, seen(DEFAULTS), seed=2, tcps=30, candidates=10, hands=10), folder)
    return folder


def test_a_recipe_and_a_data_set_make_a_model_file_that_says_how(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert train("trial-mc-dropout", data=data, seed=4, out=tmp_path) == 0
    model = load_model(tmp_path / MODEL)
    assert (model.dropout, model.members, model.passes) == (Dropout.INTER, 1, 10)
    assert model.calibration is not None
    assert model.calibration.samples == 10_000
    box = seen(DEFAULTS)
    assert model.seen.tcp_low_m == box.tcp.outer.low_m
    assert model.seen.hand_high_m == box.hand.outer.high_m
    assert model.card["data"]["sha256"] == data_hash(load_dataset(data))
    assert model.card["command"].startswith("safety-harness train trial-mc-dropout --seed 4")
    out, err = capsys.readouterr()
    assert out.splitlines()[-1] == f"model: {tmp_path / MODEL}"
    assert f"spread threshold: {1e3 * model.calibration.spread_threshold_m:.2f} mm" in out
    assert "epoch 1/8" in err
    assert "epoch 8/8" in err


def test_an_ensemble_is_one_file_with_five_members(data: Path, tmp_path: Path) -> None:
    assert train("trial-ensemble", data=data, out=tmp_path / "ensemble") == 0
    assert load_model(tmp_path / "ensemble" / MODEL).members == 5


def test_ctrl_c_ends_with_the_command_that_goes_on_and_that_gives_the_same_model(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    assert train("trial-deterministic", data=data, out=whole) == 0
    capsys.readouterr()

    def interrupted(text: str) -> None:
        if "epoch 3/8" in text:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("safety_harness.cli.progress.EVERY_S", 0.0)
        patch.setattr("safety_harness.cli.progress.say", interrupted)
        assert train("trial-deterministic", data=data, out=parts) == 130
    assert f"--data {data} --resume" in capsys.readouterr().err
    assert not (parts / MODEL).exists()
    assert train("trial-deterministic", data=data, out=parts, resume=True) == 0
    said = capsys.readouterr().err
    assert "epoch 3/8" not in said
    assert "from the start" not in said
    tensors = [load_model(folder / MODEL).tensors for folder in (whole, parts)]
    assert {n: t.tobytes() for n, t in tensors[0].items()} == {n: t.tobytes() for n, t in tensors[1].items()}


def test_to_go_on_from_nothing_is_to_begin_and_that_is_said(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert train("trial-deterministic", data=data, out=tmp_path / "new", resume=True) == 0
    assert f"{tmp_path / 'new'} has no checkpoint to go on from" in capsys.readouterr().err


def test_mistakes_are_explained_with_exit_code_2(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert train("trial", data=data, out=tmp_path) == 2
    assert "trial-deterministic" in capsys.readouterr().err
    assert train("trial-deterministic", data=tmp_path / "nowhere", out=tmp_path) == 2
    assert "nowhere" in capsys.readouterr().err
    assert not (tmp_path / MODEL).exists()
