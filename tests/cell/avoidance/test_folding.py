from __future__ import annotations

import numpy as np
import pytest
from random_models import random_model

from safety_harness.cell.avoidance.model_file import (
    INPUTS,
    LAYERS,
    PLACES,
    STAGES,
    WIDTH,
    Dropout,
    layer_names,
)
from safety_harness.cell.avoidance.resnet_kernel import EPSILON, fold

MODEL = random_model(Dropout.NONE, members=2)
NETWORK = fold(MODEL)


@pytest.mark.parametrize("member", [0, 1])
def test_a_folded_layer_is_the_layer_and_then_its_batch_norm(member: int) -> None:
    rng = np.random.default_rng(1)
    for layer, (block, number) in enumerate(layer_names()):
        at = {
            part: MODEL.tensors[f"{member}/{block}.{part}"].astype(np.float64)
            for part in (f"fc{number}.weight", f"fc{number}.bias", f"bn{number}.weight", f"bn{number}.bias")
            + (f"bn{number}.running_mean", f"bn{number}.running_var")
        }
        x = rng.normal(size=at[f"fc{number}.weight"].shape[1])
        z = at[f"fc{number}.weight"] @ x + at[f"fc{number}.bias"]
        deviation = np.sqrt(at[f"bn{number}.running_var"] + EPSILON)
        expected = (z - at[f"bn{number}.running_mean"]) / deviation * at[f"bn{number}.weight"]
        expected += at[f"bn{number}.bias"]
        padded = np.append(x, np.zeros(WIDTH - len(x)))
        folded = padded @ NETWORK.weight[member, layer] + NETWORK.bias[member, layer]
        assert folded == pytest.approx(expected, abs=3e-6)


def test_only_the_two_first_layers_take_the_input_and_ignore_what_lies_beyond_it() -> None:
    first = [k for k, name in enumerate(layer_names()) if name in (("stages.0.0", "1"), ("stages.0.0", "s"))]
    assert first == [0, 3]
    for layer in range(LAYERS):
        unused = NETWORK.weight[:, layer, INPUTS:]
        assert (unused == 0.0).all() == (layer in first)


def test_layers_come_in_the_order_of_the_tensors_of_a_file() -> None:
    names = [name for name in MODEL.tensors if name.startswith("0/") and name.endswith(".weight")]
    layers = [name for name in names if ".fc" in name and "fc_out" not in name]
    assert layers == [f"0/{block}.fc{number}.weight" for block, number in layer_names()]


def test_dropout_has_a_place_after_each_stage_or_before_each_layer() -> None:
    assert PLACES[Dropout.NONE] == 0
    assert PLACES[Dropout.INTER] == STAGES
    assert PLACES[Dropout.FULL] == len(layer_names()) + 1


def test_the_kernel_gets_arrays_without_gaps() -> None:
    arrays = [one for one in NETWORK if isinstance(one, np.ndarray)]
    assert len(arrays) == 10
    assert all(array.flags.c_contiguous for array in arrays)
