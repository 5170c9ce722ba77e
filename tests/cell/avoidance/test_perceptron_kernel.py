"""The small ReLU network: the same answers as plain numpy, and files that are another kind are refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from random_models import random_inputs, random_model, random_perceptron

from safety_harness.base.exceptions import ModelError
from safety_harness.base.settings import DEFAULTS
from safety_harness.cell.avoidance.candidates import continuous_optimum
from safety_harness.cell.avoidance.learned import LearnedAvoider
from safety_harness.cell.avoidance.model_file import PERCEPTRON, Dropout, Model, load_model, save_model
from safety_harness.cell.avoidance.shipped import shipped_model


def by_numpy(model: Model, hand: np.ndarray, tcp: np.ndarray) -> np.ndarray:
    """(members, 3) answers [m], with the normalisation as the file has it."""
    x = (np.append(hand, tcp) - model.input_mean) / model.input_std
    found = []
    for k in range(model.members):
        w = {name: model.tensors[f"{k}/{name}"].astype(float) for name in NAMES}
        h = np.maximum(w["fc1.weight"] @ x + w["fc1.bias"], 0.0)
        h = np.maximum(w["fc2.weight"] @ h + w["fc2.bias"], 0.0)
        found.append(
            np.add(model.target_mean, model.target_std * (w["fc_out.weight"] @ h + w["fc_out.bias"]))
        )
    return np.array(found)


NAMES = [f"{layer}.{part}" for layer in ("fc1", "fc2", "fc_out") for part in ("weight", "bias")]


@pytest.mark.parametrize("members", [1, 3])
def test_answers_are_those_of_plain_numpy(members: int) -> None:
    model = random_perceptron(members=members, seed=members)
    hands, tcps, seeds = random_inputs(50, seed=1)
    positions, spreads = LearnedAvoider.from_model(model).propose_many(hands, tcps, seeds)
    for n in range(50):
        expected = by_numpy(model, hands[n], tcps[n])
        assert positions[n] == pytest.approx(expected.mean(axis=0), abs=1e-12)
        assert spreads[n] == pytest.approx(expected.std(axis=0), abs=1e-12)
    assert spreads.any() == (members > 1)


def test_one_question_and_many_are_the_same_bits_and_nan_is_no_answer() -> None:
    avoider = LearnedAvoider.from_model(random_perceptron())
    hands, tcps, seeds = random_inputs(9, seed=2)
    many, _ = avoider.propose_many(hands, tcps, seeds)
    one, _ = avoider.propose_many(hands[4:5], tcps[4:5], seeds[4:5])
    assert np.array_equal(one[0], many[4])
    hands[0, 1] = np.nan
    assert np.isnan(avoider.propose_many(hands, tcps, seeds)[0][0]).all()


def test_a_file_of_it_is_read_as_it_was_written(tmp_path: Path) -> None:
    model = random_perceptron()
    save_model(model, tmp_path / "small.safetensors")
    found = load_model(tmp_path / "small.safetensors")
    assert found.kind == PERCEPTRON
    assert found.tensors.keys() == model.tensors.keys()
    assert all(np.array_equal(found.tensors[name], tensor) for name, tensor in model.tensors.items())


@pytest.mark.parametrize(
    ("wrong", "field"),
    [
        ({"stages": 3}, "stages"),
        ({"blocks": 3}, "blocks"),
        ({"dropout": Dropout.INTER}, "dropout"),
        ({"kind": "transformer"}, "kind"),
    ],
)
def test_what_a_perceptron_has_not_is_refused(tmp_path: Path, wrong: dict[str, object], field: str) -> None:
    with pytest.raises(ModelError, match=field):
        save_model(replace(random_perceptron(), **wrong), tmp_path / "wrong.safetensors")  # type: ignore[arg-type]


def test_tensors_of_the_other_kind_are_refused(tmp_path: Path) -> None:
    other = replace(random_perceptron(), tensors=random_model(Dropout.NONE).tensors)
    with pytest.raises(ModelError, match="relu perceptron"):
        save_model(other, tmp_path / "other.safetensors")


def test_the_student_ships_and_is_near_the_optimum_of_what_it_has_seen() -> None:
    model = load_model(shipped_model("student"))
    assert (model.kind, model.members) == (PERCEPTRON, 1)
    hands, tcps, seeds = random_inputs(20_000, seed=3)
    positions, _ = LearnedAvoider.from_model(model).propose_many(hands, tcps, seeds)
    wanted = continuous_optimum(DEFAULTS, tcps) + DEFAULTS.avoidance.hand_pull * (tcps - hands)
    off_m = np.linalg.norm(positions - wanted, axis=1)
    assert np.median(off_m) < 0.003
    assert np.mean(off_m > 0.010) < 0.01
