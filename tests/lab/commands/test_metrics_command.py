"""``safety-harness metrics``: what is printed and written are the figures; mistakes are explained."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from cell.avoidance.random_models import random_model

from safety_harness.base.settings import DEFAULTS
from safety_harness.cell.avoidance.model_file import Calibration, Dropout, save_model
from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT, INTERRUPTED
from safety_harness.extensions.lab.commands.learning import metrics
from safety_harness.extensions.lab.learning import evaluation_file as module
from safety_harness.extensions.lab.learning.dataset import generate, seen
from safety_harness.extensions.lab.learning.evaluation_file import SCHEMA
from safety_harness.extensions.lab.learning.manifest import data_hash

SETS = ["seen, new TCPs", "seen, test part by sample", "unseen hand", "unseen tcp", "unseen both"]
CALIBRATION = Calibration(
    interval_multiplier=2.0, spread_threshold_m=0.02, residual_std_m=(0.01, 0.01, 0.01), samples=9
)


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Random weights, with a card of a data set that can be made again."""
    data = generate(DEFAULTS, seen(DEFAULTS), seed=5, tcps=30, candidates=20, hands=4)
    about = {"seed": 5, "tcps": 30, "candidates": 20, "hands": 4, "space": "seen", "split": "by sample"}
    card = {"data": about | {"sha256": data_hash(data)}}
    path = tmp_path_factory.mktemp("mine") / "model.safetensors"
    save_model(replace(random_model(Dropout.INTER), card=card, calibration=CALIBRATION), path)
    return path


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Neither calibrated nor with a card of ours, and without a spread."""
    path = tmp_path_factory.mktemp("models") / "plain.safetensors"
    save_model(random_model(Dropout.NONE), path)
    return path


def written(out: Path) -> dict[str, Any]:
    document: dict[str, Any] = json.loads(out.read_text())
    return document


def test_models_stand_side_by_side_in_tables_and_whole_in_json(
    model: Path, plain: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "new" / "evaluation.json"
    assert metrics([model, plain], samples=50, seed=2, out=out) == AS_EXPECTED
    printed = capsys.readouterr()
    document = written(out)
    assert (document["schema"], document["samples"], document["seed"]) == (SCHEMA, 50, 2)
    first, second = document["models"]
    assert first["sha256"] == hashlib.sha256(model.read_bytes()).hexdigest()
    assert [one["set"] for one in first["sets"]] == SETS
    assert [one["set"] for one in second["sets"]] == [SETS[0], *SETS[2:]]
    assert [one["rows"] for one in first["sets"]] == [50, 12, 50, 50, 50]  # a tenth of 30 x 4 samples
    assert second["calibration"] is None
    assert second["sets"][0]["intervals_95"] is None
    label = model.parent.name
    for text in (f"{label}: MC dropout", "plain: not calibrated", "plain: no test part of the training data"):
        assert text in printed.out
    for one in first["sets"]:
        (errors, intervals, doubt) = [
            line for line in printed.out.splitlines() if line.startswith(one["set"]) and f" {label} " in line
        ][:3]
        rmse = [f"{1e3 * value:.2f}" for value in one["errors_m"]["rmse"]]
        assert errors.split(label)[1].split()[:3] == rmse
        covered = one["intervals_95"]["joint"]
        limits = f"[{100 * covered['low']:.1f}, {100 * covered['high']:.1f}]"
        assert f"{100 * covered['share']:.1f}% {limits}" in " ".join(intervals.split())
        above = one["above_spread_threshold"]
        assert f"{100 * above['count'] / above['trials']:.1f}%" in doubt
        assert (one["auroc_against_seen"] is None) == one["seen"]
    assert "(floor)" in printed.out
    assert "drawing 50 TCPs and hands: seen" in printed.err
    assert "drawing" not in printed.out


def test_the_same_seed_gives_the_same_figures_whatever_stands_beside_a_model(
    model: Path, plain: Path, tmp_path: Path
) -> None:
    assert metrics([model, plain], samples=20, seed=2, out=tmp_path / "a.json") == AS_EXPECTED
    assert metrics([plain, model, model], samples=20, seed=2, out=tmp_path / "b.json") == AS_EXPECTED
    assert metrics([model], samples=20, seed=3, out=tmp_path / "c.json") == AS_EXPECTED
    a, b, c = (written(tmp_path / f"{name}.json")["models"] for name in "abc")
    assert a[0]["sets"] == b[1]["sets"] == b[2]["sets"]
    assert a[1]["sets"] == b[0]["sets"]
    assert a[0]["sets"] != c[0]["sets"]
    assert [one["label"] for one in b] == ["plain", model.parent.name, f"{model.parent.name} #2"]


def test_a_shipped_model_is_evaluated_by_its_name(capsys: pytest.CaptureFixture[str]) -> None:
    assert metrics(["deterministic"], samples=20) == AS_EXPECTED
    printed = capsys.readouterr().out
    assert "deterministic: deterministic network" in printed
    assert "seen, test part by TCP" in printed


def test_mistakes_are_explained_and_nothing_is_written(
    model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    broken = tmp_path / "broken.safetensors"
    broken.write_bytes(b"import os")
    elsewhere = tmp_path / "elsewhere.safetensors"
    other = random_model(Dropout.NONE)
    save_model(replace(other, seen=replace(other.seen, tcp_low_m=(0.60, -0.15, 0.25))), elsewhere)
    out = tmp_path / "out.json"
    for models, options, said in (
        ([], {}, "at least one model"),
        ([tmp_path / "none.safetensors"], {}, "no such file"),
        ([model, broken], {}, "broken.safetensors"),
        ([elsewhere], {}, "seen.tcp_low_m"),
        ([model], {"samples": 9}, "--samples"),
        ([model], {"samples": 10**7}, "--samples"),
        ([model], {"seed": -1}, "--seed"),
    ):
        assert metrics(models, out=out, **options) == BAD_INPUT  # type: ignore[arg-type]
        printed = capsys.readouterr()
        assert said in printed.err
        assert printed.out == ""
    assert not out.exists()
    assert metrics([model], samples=10, out=model / "out.json") == BAD_INPUT
    assert "can be written" in capsys.readouterr().err


def test_ctrl_c_ends_without_a_file(
    model: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(module, "evaluate_model", interrupted)
    assert metrics([model], samples=10, out=tmp_path / "out.json") == INTERRUPTED
    assert "interrupted" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
