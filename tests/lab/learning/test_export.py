"""Exported files against the original: other questions than those that they were tried with when written."""

from __future__ import annotations

import hashlib
import json
import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import torch
from cell.avoidance.random_models import random_inputs, random_model, random_perceptron
from disagreement import noted

from safety_harness.base.exceptions import AvoiderError, ModelError, OutputError
from safety_harness.cell.avoidance.avoider import checked
from safety_harness.cell.avoidance.learned import LearnedAvoider
from safety_harness.cell.avoidance.model_file import KEY, Calibration, Dropout, Model
from safety_harness.cell.avoidance.onnx_file import open_session
from safety_harness.cell.avoidance.onnx_model import OnnxAvoider
from safety_harness.extensions.lab.learning import export as module
from safety_harness.extensions.lab.learning.export import WholeFunction, difference, drawn_masks, write_export

ROOT = Path(__file__).parents[3]
SOURCE = b"the bytes of a model file"
CALIBRATION = Calibration(
    interval_multiplier=2.0, spread_threshold_m=0.02, residual_std_m=(0.01, 0.01, 0.01), samples=9
)
# PyTorch takes seconds for a ResNet and not one for a perceptron: so of these is what needs no certain one.
KINDS = {
    "deterministic": random_model(Dropout.NONE, seed=1),
    "ensemble": random_perceptron(members=2, seed=2),
    "inter": replace(random_model(Dropout.INTER, seed=3), calibration=CALIBRATION),
    "full": random_model(Dropout.FULL, seed=4, passes=4),
}


class Exports:
    """A file of each kind, made when it is first asked for."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.differences_m: dict[str, float] = {}

    def file(self, kind: str) -> Path:
        file = self.folder / "made" / f"{kind}.onnx"
        if kind not in self.differences_m:
            self.differences_m[kind] = write_export(KINDS[kind], SOURCE, file, seed=0)
        return file


@pytest.fixture(scope="module", autouse=True)
def one_thread() -> Iterator[None]:
    """Small networks: a second thread only waits for its turn when tests run side by side."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="module")
def exports(tmp_path_factory: pytest.TempPathFactory) -> Exports:
    return Exports(tmp_path_factory.mktemp("exports"))


class Again(NamedTuple):
    file: Path
    filters: list[list[object]]  # of warnings, before and after


@pytest.fixture(scope="module")
def again(exports: Exports) -> Again:
    """A second export of a model; the first one imports what adds filters."""
    exports.file("ensemble")
    file, before = exports.folder / "again.onnx", list(warnings.filters)
    write_export(KINDS["ensemble"], SOURCE, file, seed=1)
    return Again(file, [before, list(warnings.filters)])


# Every day a ResNet with masks and networks without: masks in every layer, and a ResNet without, take longer.
each = pytest.mark.parametrize(
    "kind",
    [pytest.param(kind, marks=[pytest.mark.long] * (kind in ("full", "deterministic"))) for kind in KINDS],
)


@each
def test_an_export_is_the_original_to_a_thousandth_of_a_millimetre(exports: Exports, kind: str) -> None:
    file = exports.file(kind)
    assert 0.0 < exports.differences_m[kind] < 1e-6
    assert difference(KINDS[kind], module.load_onnx(file), seed=11) < 1e-6


@each
def test_an_exported_avoider_proposes_what_the_learned_one_does(exports: Exports, kind: str) -> None:
    learned = LearnedAvoider.from_model(KINDS[kind])
    file = exports.file(kind)
    hands, tcps, seeds = random_inputs(20, seed=5)
    avoider = OnnxAvoider.load(file, file.read_bytes(), hand=hands[0], tcp=tcps[0])
    assert avoider.spread_threshold_m == learned.spread_threshold_m
    for hand, tcp, seed in zip(hands, tcps, seeds, strict=True):
        ours, theirs = (
            checked(one.propose(hand_position_in_base_m=hand, tcp_position_in_base_m=tcp, seed=int(seed)))
            for one in (learned, avoider)
        )
        noted("onnxruntime", "decisions", "mm", ours.position_in_base_m, theirs.position_in_base_m, 1e3)
        assert theirs.position_in_base_m == pytest.approx(ours.position_in_base_m, abs=1e-6)
        assert theirs.spread_m == pytest.approx(ours.spread_m, abs=1e-6)
    with pytest.raises(AvoiderError, match="not finite"):
        checked(
            avoider.propose(
                hand_position_in_base_m=np.full(3, np.inf), tcp_position_in_base_m=tcps[0], seed=1
            )
        )


def test_masks_matter_and_are_those_of_each_row_s_own_seed(exports: Exports) -> None:
    model = KINDS["inter"]
    hands, tcps, seeds = random_inputs(6, seed=6)
    function = module.load_onnx(exports.file("inter"))
    positions, _ = function(hands, tcps, drawn_masks(model, seeds))
    others, _ = function(hands, tcps, drawn_masks(model, seeds[::-1].copy()))
    assert np.abs(positions - others).max() > 1e-4
    assert positions == pytest.approx(
        LearnedAvoider.from_model(model).propose_many(hands, tcps, seeds)[0], abs=1e-6
    )


def test_an_onnx_file_holds_the_model_s_metadata_and_no_path_of_this_machine(exports: Exports) -> None:
    file = exports.file("inter")
    session = open_session(file, file.read_bytes())
    about = json.loads(session.get_modelmeta().custom_metadata_map[KEY])
    assert about["source_sha256"] == hashlib.sha256(SOURCE).hexdigest()
    assert about["card"] == KINDS["inter"].card
    assert about["calibration"]["spread_threshold_m"] == 0.02
    assert str(ROOT).encode() not in file.read_bytes()
    assert [(one.name, one.shape) for one in session.get_inputs()] == [
        ("hand_position_in_base_m", ["n", 3]),
        ("tcp_position_in_base_m", ["n", 3]),
        ("masks", ["n", 10, 3, 32]),
    ]


def test_exporting_twice_gives_the_same_onnx_file(exports: Exports, again: Again) -> None:
    assert again.file.read_bytes() == exports.file("ensemble").read_bytes()


def test_an_export_that_answers_otherwise_is_refused_and_the_file_before_stays(
    exports: Exports, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = exports.file("ensemble").read_bytes()
    monkeypatch.setattr(module, "_onnx_bytes", lambda model, about: other)
    file = tmp_path / "model.onnx"
    file.write_text("before")
    with pytest.raises(ModelError, match=r"the original's answers to 0\.001 mm; got a difference of"):
        write_export(KINDS["deterministic"], SOURCE, file, seed=0)
    assert [path.name for path in tmp_path.iterdir()] == ["model.onnx"]
    assert file.read_text() == "before"


def function_of(model: Model, *, swallow_nan: bool = False, rows: int | None = None) -> module.Function:
    def function(hands: np.ndarray, tcps: np.ndarray, masks: np.ndarray | None) -> module.Arrays:
        if swallow_nan:
            hands = np.nan_to_num(hands)
        given = [hands, tcps] if masks is None else [hands, tcps, masks]
        with torch.no_grad():
            position, spread = WholeFunction(model)(*map(torch.from_numpy, given))
        return position.numpy()[:rows], spread.numpy()[:rows]

    return function


def test_the_trial_sees_a_swallowed_nan_a_lost_row_and_a_shift_of_a_hundredth_of_a_millimetre() -> None:
    model = KINDS["ensemble"]
    assert difference(model, function_of(model), seed=2) < 1e-6
    assert difference(model, function_of(model, swallow_nan=True), seed=2) == np.inf
    assert difference(model, function_of(model, rows=5), seed=2) == np.inf
    x, y, z = model.target_mean
    shifted = replace(model, target_mean=(x, y + 1e-5, z))
    assert difference(model, function_of(shifted), seed=2) == pytest.approx(1e-5, rel=0.1)
    broken = replace(model, target_mean=(x, np.nan, z))
    assert difference(model, function_of(broken), seed=2) == np.inf


def test_a_place_that_cannot_be_written_or_has_another_ending_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "_onnx_bytes", lambda model, about: b"an export")
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="can be written"):
        write_export(KINDS["deterministic"], SOURCE, tmp_path / "file" / "m.onnx", seed=0)
    with pytest.raises(OutputError, match=r"ends in \.onnx; got 'm\.pt'"):
        write_export(KINDS["deterministic"], SOURCE, tmp_path / "m.pt", seed=0)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_exporting_leaves_warnings_as_they_were(again: Again) -> None:
    before, after = again.filters
    assert after == before
