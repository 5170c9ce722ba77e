from __future__ import annotations

import json
import pickle
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import fields, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_models import random_model
from safetensors.numpy import load, save_file

from safety_harness.base.exceptions import ModelError, OutputError
from safety_harness.base.settings import DEFAULTS
from safety_harness.cell.avoidance.learned import LearnedAvoider
from safety_harness.cell.avoidance.model_file import (
    KEY,
    LARGEST_BYTES,
    Calibration,
    Dropout,
    Model,
    load_model,
    refuse_foreign_cell,
    save_model,
    tensor_shapes,
)

CALIBRATION = Calibration(
    interval_multiplier=2.7,
    spread_threshold_m=0.021,
    residual_std_m=(0.012, 0.008, 0.009),
    samples=1000,
    more={"coverage": 0.95, "by": "TCP"},
)
MODEL = replace(random_model(Dropout.INTER), calibration=CALIBRATION)

Edit = Callable[[dict[str, Any]], object]


def bytes_of(model: Model = MODEL) -> bytes:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "model.safetensors"
        save_model(model, path)
        return path.read_bytes()


def parts(model: Model = MODEL) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """The metadata and the tensors of a file of ``model``."""
    data = bytes_of(model)
    header = json.loads(data[8 : 8 + struct.unpack("<Q", data[:8])[0]])
    return json.loads(header["__metadata__"][KEY]), load(data)


def written(tmp_path: Path, metadata: object, tensors: dict[str, np.ndarray], key: str = KEY) -> Path:
    path = tmp_path / "model.safetensors"
    save_file(tensors, path, metadata={key: json.dumps(metadata)})
    return path


def refusal(path: Path) -> ModelError:
    with pytest.raises(ModelError) as caught:
        load_model(path)
    assert caught.value.place.file == path
    assert str(path) in str(caught.value)
    return caught.value


@pytest.mark.parametrize(
    "model",
    [MODEL, random_model(Dropout.NONE), random_model(Dropout.FULL), random_model(Dropout.NONE, members=5)],
)
def test_a_model_comes_back_as_it_was_saved(model: Model, tmp_path: Path) -> None:
    save_model(model, tmp_path / "a.safetensors")
    again = load_model(tmp_path / "a.safetensors")
    for one in fields(Model):
        if one.name != "tensors":
            assert getattr(again, one.name) == getattr(model, one.name), one.name
    assert list(again.tensors) == list(model.tensors)
    for name, tensor in model.tensors.items():
        assert again.tensors[name].dtype == np.float32
        assert np.array_equal(again.tensors[name], tensor)


def test_what_a_decision_costs_stands_on_the_card(tmp_path: Path) -> None:
    assert LearnedAvoider.from_model(MODEL).decision_time_s == 0.0
    save_model(replace(MODEL, card={"decision_time_s": 0.04}), tmp_path / "slow.safetensors")
    assert LearnedAvoider.from_model(load_model(tmp_path / "slow.safetensors")).decision_time_s == 0.04


def test_the_tensors_of_a_model_cannot_be_written_into(tmp_path: Path) -> None:
    save_model(MODEL, tmp_path / "a.safetensors")
    for tensor in load_model(tmp_path / "a.safetensors").tensors.values():
        with pytest.raises(ValueError, match="read-only"):
            tensor[0] = 0.0


def test_the_same_model_makes_the_same_bytes_and_nothing_is_left_beside_the_file(tmp_path: Path) -> None:
    for name in ("a.safetensors", "b.safetensors"):
        save_model(MODEL, tmp_path / name)
    assert (tmp_path / "a.safetensors").read_bytes() == (tmp_path / "b.safetensors").read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.safetensors", "b.safetensors"]


def test_an_interrupted_save_leaves_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.safetensors"
    save_model(MODEL, path)
    before = path.read_bytes()

    def lights_out(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("safety_harness.base.whole_file.os.fsync", lights_out)
    with pytest.raises(KeyboardInterrupt):
        save_model(random_model(Dropout.FULL), path)
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    "broken",
    [
        replace(MODEL, input_std=(0.0,) * 6),
        replace(MODEL, members=2),
        replace(MODEL, passes=1),
        replace(MODEL, card={"note": float("nan")}),
        replace(MODEL, card={"note": {1, 2}}),
        replace(MODEL, tensors={name: t.astype(np.float64) for name, t in MODEL.tensors.items()}),
    ],
    ids=["std", "members", "passes", "nan", "set", "float64"],
)
def test_what_could_not_be_loaded_is_not_saved(broken: Model, tmp_path: Path) -> None:
    with pytest.raises(ModelError):
        save_model(broken, tmp_path / "a.safetensors")
    assert not list(tmp_path.iterdir())


METADATA_MISTAKES: dict[str, tuple[Edit, str, str]] = {
    "another format": (lambda m: m.update(format="safety-harness model 2"), "format", "model 1"),
    "another kind": (lambda m: m.update(kind="transformer"), "kind", "regression resnet"),
    "another width": (lambda m: m.update(width=64), "width", "32"),
    "a width in text": (lambda m: m.update(width="32"), "width", "int"),
    "a true width": (lambda m: m.update(stages=True), "stages", "int"),
    "another dropout": (lambda m: m.update(dropout="outer"), "dropout", "this version knows"),
    "a list as dropout": (lambda m: m.update(dropout=["inter"]), "dropout", "str"),
    "certain dropout": (lambda m: m.update(dropout_probability=1.0), "dropout_probability", "<= 0.9"),
    "no dropout": (lambda m: m.update(dropout_probability=0.0), "dropout_probability", "above 0"),
    "a single pass": (lambda m: m.update(passes=1), "passes", "at least 2"),
    "no end of passes": (lambda m: m.update(passes=10**9), "passes", "<= 1000"),
    "two members with dropout": (lambda m: m.update(members=2), "members", "1 with dropout"),
    "no normalisation": (lambda m: m.pop("input_mean"), "input_mean", "this field"),
    "a short normalisation": (lambda m: m["input_mean"].pop(), "input_mean", "length >= 6"),
    "a text as mean": (lambda m: m.update(target_mean=["0", 0, 0]), "target_mean[0]", "float"),
    "a mean beyond floats": (lambda m: m.update(target_mean=[0, 10**400, 0]), "target_mean[1]", "finite"),
    "zero deviation": (lambda m: m["input_std"].__setitem__(4, 0.0), "input_std[4]", "> 0.0"),
    "negative deviation": (lambda m: m["target_std"].__setitem__(2, -0.1), "target_std[2]", "> 0.0"),
    "no seen space": (lambda m: m.pop("seen"), "seen", "this field"),
    "a number as seen space": (lambda m: m.update(seen=3), "seen", "object"),
    "empty seen space": (lambda m: m["seen"].update(tcp_low_m=[0.7, 0.2, 0.3]), "seen", "tcp_low_m below"),
    "seen space in mm": (
        lambda m: m["seen"].update(hand_high_m=[1140, -50, 305]),
        "seen.hand_high_m[0]",
        "10",
    ),
    "more seen space": (lambda m: m["seen"].update(elbow_low_m=[0, 0, 0]), "seen", "only the fields"),
    "no calibration": (lambda m: m.pop("calibration"), "calibration", "this field"),
    "half a calibration": (lambda m: m["calibration"].pop("samples"), "calibration.samples", "this field"),
    "negative threshold": (
        lambda m: m["calibration"].update(spread_threshold_m=-0.01),
        "calibration.spread_threshold_m",
        ">= 0.0",
    ),
    "no card": (lambda m: m.update(card="trust me"), "card", "object"),
    "a card of no time": (
        lambda m: m["card"].update(decision_time_s=-1.0),
        "card.decision_time_s",
        "from 0 s to 60 s",
    ),
    "an unknown field": (lambda m: m.update(activation="gelu"), None, "only the fields"),
}


@pytest.mark.parametrize("mistake", METADATA_MISTAKES.values(), ids=METADATA_MISTAKES.keys())
def test_wrong_metadata_is_refused_with_the_field_that_is_wrong(
    mistake: tuple[Edit, str | None, str], tmp_path: Path
) -> None:
    edit, field, expected = mistake
    metadata, tensors = parts()
    assert load_model(written(tmp_path, metadata, tensors)).passes == MODEL.passes  # it is the edit's fault
    edit(metadata)
    error = refusal(written(tmp_path, metadata, tensors))
    assert error.place.field == field
    assert expected in error.expected


@pytest.mark.parametrize(
    "text", ["", "{", "[]", "3", "null", '{"width": NaN}', "[" * 100_000, '{"a": ' + "9" * 5000 + "}"]
)
def test_metadata_that_is_no_json_object_is_refused(text: str, tmp_path: Path) -> None:
    path = tmp_path / "model.safetensors"
    save_file(parts()[1], path, metadata={KEY: text})
    assert "JSON" in refusal(path).expected


def test_tensors_of_somebody_else_are_refused(tmp_path: Path) -> None:
    metadata, tensors = parts()
    assert refusal(written(tmp_path, metadata, tensors, key="format")).place.field == KEY
    save_file(tensors, tmp_path / "bare.safetensors")
    assert refusal(tmp_path / "bare.safetensors").place.field == KEY


def changed(name: str, value: Any) -> Edit:
    def edit(tensors: dict[str, Any]) -> None:
        tensors[name] = value(tensors[name])

    return edit


def with_value(value: float) -> Callable[[np.ndarray], np.ndarray]:
    def edit(tensor: np.ndarray) -> np.ndarray:
        other = tensor.copy()
        other.flat[5] = value
        return other

    return edit


TENSOR_MISTAKES: dict[str, tuple[Edit, str, str]] = {
    "missing": (lambda t: t.pop("0/bn_out.weight"), "0/bn_out.weight", "shape [32]"),
    "one too many": (
        lambda t: t.update({"0/fc_in.bias": np.zeros(3, np.float32)}),
        "0/fc_in.bias",
        "only tensors",
    ),
    "another member": (
        lambda t: t.update({"1/fc_out.bias": t["0/fc_out.bias"]}),
        "1/fc_out.bias",
        "1 member",
    ),
    "transposed": (changed("0/fc_out.weight", lambda w: w.T.copy()), "0/fc_out.weight", "shape [3, 32]"),
    "six inputs": (
        changed("0/stages.0.0.fcs.weight", lambda w: w[:, :6].copy()),
        "0/stages.0.0.fcs.weight",
        "[32, 7]",
    ),
    "doubles": (changed("0/bn_out.bias", lambda w: w.astype(np.float64)), "0/bn_out.bias", "F32"),
    "halves": (changed("0/bn_out.bias", lambda w: w.astype(np.float16)), "0/bn_out.bias", "F32"),
    "NaN": (changed("0/stages.1.2.fc2.weight", with_value(np.nan)), "0/stages.1.2.fc2.weight", "finite"),
    "infinity": (changed("0/stages.2.0.fcs.bias", with_value(-np.inf)), "0/stages.2.0.fcs.bias", "finite"),
    "negative variance": (
        changed("0/bn_out.running_var", with_value(-1e-6)),
        "0/bn_out.running_var",
        "at least 0",
    ),
}


@pytest.mark.parametrize("mistake", TENSOR_MISTAKES.values(), ids=TENSOR_MISTAKES.keys())
def test_wrong_tensors_are_refused_with_the_tensor_that_is_wrong(
    mistake: tuple[Edit, str, str], tmp_path: Path
) -> None:
    edit, name, expected = mistake
    metadata, tensors = parts()
    edit(tensors)
    error = refusal(written(tmp_path, metadata, tensors))
    assert error.place.field == name
    assert expected in error.expected


def test_an_ensemble_lacks_no_member(tmp_path: Path) -> None:
    metadata, tensors = parts(random_model(Dropout.NONE, members=3))
    metadata["members"] = 4
    assert refusal(written(tmp_path, metadata, tensors)).place.field == "3/" + next(iter(tensor_shapes()))


def test_a_place_that_cannot_be_written_is_an_output_error(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="file"):
        save_model(MODEL, tmp_path / "file" / "a.safetensors")


class Booby:
    """Unpickled, it would make a file."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (self.path,)


def test_a_pickle_is_refused_and_not_executed(tmp_path: Path) -> None:
    trap = tmp_path / "sprung"
    path = tmp_path / "model.safetensors"
    path.write_bytes(pickle.dumps(Booby(trap)))
    assert refusal(path).expected == "a safetensors file"
    assert not trap.exists()
    pickle.loads(path.read_bytes())
    assert trap.exists()  # the trap is a real one


def test_a_missing_file_and_a_folder_are_refused(tmp_path: Path) -> None:
    assert refusal(tmp_path / "none.safetensors").expected == "a file that can be read"
    assert refusal(tmp_path).got == "a folder"


def test_a_file_too_large_to_be_a_model_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "model.safetensors"
    with path.open("wb") as file:
        file.truncate(LARGEST_BYTES + 1)
    assert str(LARGEST_BYTES) in refusal(path).expected


GOOD = bytes_of()


@contextmanager
def file_of(data: bytes) -> Iterator[Path]:
    """A file in a folder of its own (hypothesis runs many examples in one tmp_path)."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "model.safetensors"
        path.write_bytes(data)
        yield path


@given(st.integers(0, len(GOOD) - 1))
@settings(max_examples=50, deadline=None)
def test_a_truncated_file_is_refused(length: int) -> None:
    with file_of(GOOD[:length]) as path:
        refusal(path)


@given(st.integers(0, struct.unpack("<Q", GOOD[:8])[0] + 7), st.integers(0, 255))
@settings(max_examples=200, deadline=None)
def test_a_damaged_header_is_refused_or_still_makes_a_sound_model(position: int, byte: int) -> None:
    with file_of(GOOD[:position] + bytes([byte]) + GOOD[position + 1 :]) as path:
        try:
            model = load_model(path)
        except ModelError:
            return
    assert np.isfinite(model.target_mean).all()
    assert min(model.input_std) > 0.0


def test_a_model_of_another_workspace_is_refused(tmp_path: Path) -> None:
    refuse_foreign_cell(MODEL, DEFAULTS, tmp_path)
    elsewhere = replace(MODEL.seen, tcp_low_m=(-0.7, -0.2, 0.2), tcp_high_m=(-0.5, 0.2, 0.5))
    with pytest.raises(ModelError, match="another workspace") as caught:
        refuse_foreign_cell(replace(MODEL, seen=elsewhere), DEFAULTS, tmp_path)
    assert "tcp" in str(caught.value.place.field)
    elsewhere = replace(MODEL.seen, hand_low_m=(0.5, 0.1, -0.3), hand_high_m=(1.2, 0.7, 0.3))
    with pytest.raises(ModelError, match="another workspace") as caught:
        refuse_foreign_cell(replace(MODEL, seen=elsewhere), DEFAULTS, tmp_path)
    assert "hand" in str(caught.value.place.field)
    assert "of the arm UR10" in str(caught.value)
