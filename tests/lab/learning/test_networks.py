"""The PyTorch network against the figures, spelled out once more in numpy."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from safety_harness.cell.avoidance.masks import masks as counted_masks
from safety_harness.cell.avoidance.model_file import Dropout, tensor_shapes
from safety_harness.extensions.lab.learning.networks import (
    RegressionResNet,
    fresh_network,
    load_tensors,
    to_tensors,
)
from safety_harness.extensions.lab.learning.recipes import (
    OURS_DETERMINISTIC,
    OURS_MC_DROPOUT,
    OURS_MC_DROPOUT_FULL,
)

Floats = NDArray[np.float64]


def lively(dropout: Dropout) -> RegressionResNet:
    """A network whose batch normalisations are no identities."""
    recipe = {
        Dropout.NONE: OURS_DETERMINISTIC,
        Dropout.INTER: OURS_MC_DROPOUT,
        Dropout.FULL: OURS_MC_DROPOUT_FULL,
    }[dropout]
    network = fresh_network(recipe, 3)
    rng = np.random.default_rng(4)
    tensors = to_tensors(network)
    for name, tensor in tensors.items():
        if ".bn" in name or name.startswith("bn"):
            tensors[name] = rng.uniform(0.5, 1.5, tensor.shape).astype(np.float32)
    load_tensors(network, tensors)
    return network.eval()


def by_hand(network: RegressionResNet, x: Floats, masks: Floats | None) -> Floats:
    """Figures 3 and 4 in float64; ``masks`` (places, n, width), in the order of the layers."""
    t = {name: tensor.astype(np.float64) for name, tensor in to_tensors(network).items()}
    left: Iterator[Floats] = iter(()) if masks is None else iter(masks)

    def drop(h: Floats, where: Dropout) -> Floats:
        if masks is None or network.dropout is not where:
            return h
        return h * next(left)[:, : h.shape[1]] / 0.9

    def fc(name: str, h: Floats) -> Floats:
        return drop(h, Dropout.FULL) @ t[f"{name}.weight"].T + t[f"{name}.bias"]

    def bn(name: str, h: Floats) -> Floats:
        unit = (h - t[f"{name}.running_mean"]) / np.sqrt(t[f"{name}.running_var"] + 1e-5)
        return unit * t[f"{name}.weight"] + t[f"{name}.bias"]

    for s in range(3):
        for b in range(3):
            p = f"stages.{s}.{b}"
            h = np.maximum(bn(f"{p}.bn1", fc(f"{p}.fc1", x)), 0)
            h = np.maximum(bn(f"{p}.bn2", fc(f"{p}.fc2", h)), 0)
            h = bn(f"{p}.bn3", fc(f"{p}.fc3", h))
            x = np.maximum(h + (bn(f"{p}.bns", fc(f"{p}.fcs", x)) if b == 0 else x), 0)
        x = drop(x, Dropout.INTER)
    y = fc("fc_out", bn("bn_out", x))
    assert next(left, None) is None
    return y


INPUTS = np.random.default_rng(5).normal(size=(6, 7))


@pytest.mark.parametrize("dropout", list(Dropout))
def test_a_pass_is_that_of_the_figures(dropout: Dropout) -> None:
    network = lively(dropout)
    y = network(torch.from_numpy(INPUTS).float()).detach().numpy()
    assert y == pytest.approx(by_hand(network, INPUTS, None), rel=1e-4, abs=1e-4)


@pytest.mark.parametrize("dropout", [Dropout.INTER, Dropout.FULL])
def test_a_pass_with_given_masks_is_that_of_the_figures(dropout: Dropout) -> None:
    network = lively(dropout)
    keep = np.random.default_rng(6).random((network.places, len(INPUTS), 32)) < 0.9
    y = network(torch.from_numpy(INPUTS).float(), torch.from_numpy(keep)).detach().numpy()
    assert y == pytest.approx(by_hand(network, INPUTS, keep.astype(float)), rel=1e-4, abs=1e-4)
    without = network(torch.from_numpy(INPUTS).float()).detach().numpy()
    assert np.abs(y - without).max() > 0.01


@pytest.mark.parametrize("dropout", [Dropout.INTER, Dropout.FULL])
def test_masks_of_a_decision_apply_to_all_rows_alike(dropout: Dropout) -> None:
    network = lively(dropout)
    places = network.places
    (keep,) = torch.from_numpy(counted_masks(np.uint64(9), 1, places, 32, 0.1))
    x = torch.from_numpy(INPUTS).float()
    spread_out = keep[:, None].expand(places, len(INPUTS), 32)
    assert torch.equal(network(x, keep), network(x, spread_out))
    assert torch.equal(network(x, keep), network(x, list(keep.float())))


def test_places_are_three_between_the_stages_or_one_before_each_layer() -> None:
    layers = [name for name in tensor_shapes() if "fc" in name and name.endswith(".weight")]
    assert [lively(dropout).places for dropout in Dropout] == [0, 3, len(layers)]


def test_no_masks_of_a_network_without_dropout_are_no_dropout() -> None:
    network = lively(Dropout.NONE)
    x = torch.from_numpy(INPUTS).float()
    assert torch.equal(network(x, []), network(x))
    assert torch.equal(network(x, torch.ones(0, 32)), network(x))
    with pytest.raises(ValueError, match="expected 0 dropout masks, got 1"):
        network(x, torch.ones(1, 32))


def test_a_wrong_number_of_masks_is_refused() -> None:
    with pytest.raises(ValueError, match="expected 3 dropout masks, got 2"):
        lively(Dropout.INTER)(torch.ones(1, 7), torch.ones(2, 32))
    with pytest.raises(ValueError, match="probability"):
        RegressionResNet(probability=1.0)


def test_drawn_masks_keep_nine_units_in_ten_and_come_from_the_generator_alone() -> None:
    network = lively(Dropout.INTER)
    torch.manual_seed(1)
    first = network.draw_masks(4_000, torch.Generator().manual_seed(8))
    torch.manual_seed(2)
    again = network.draw_masks(4_000, torch.Generator().manual_seed(8))
    other = network.draw_masks(4_000, torch.Generator().manual_seed(9))
    assert first.shape == (3, 4_000, 32)
    assert torch.equal(first, again)
    assert not torch.equal(first, other)
    assert first.mean(dim=(1, 2)).numpy() == pytest.approx(0.9, abs=0.004)
    assert set(first.unique().tolist()) == {0.0, 1.0}


def test_passes_in_evaluation_mode_leave_the_running_statistics_alone() -> None:
    network = lively(Dropout.INTER)
    before = to_tensors(network)
    network(torch.from_numpy(INPUTS).float(), network.draw_masks(6, torch.Generator().manual_seed(1)))
    after = to_tensors(network)
    assert all(np.array_equal(before[name], after[name]) for name in before)
    network.train()(torch.from_numpy(INPUTS).float())
    assert not np.array_equal(before["bn_out.running_mean"], to_tensors(network)["bn_out.running_mean"])


def test_a_fresh_network_depends_on_its_seed_alone_and_leaves_the_global_generator() -> None:
    torch.manual_seed(11)
    first = to_tensors(fresh_network(OURS_DETERMINISTIC, 5))
    drawn = torch.rand(3)
    torch.manual_seed(11)
    assert torch.equal(torch.rand(3), drawn)
    again, other = (to_tensors(fresh_network(OURS_DETERMINISTIC, seed)) for seed in (5, 6))
    assert all(np.array_equal(first[name], again[name]) for name in first)
    assert not np.array_equal(first["fc_out.weight"], other["fc_out.weight"])


def test_tensors_have_the_names_and_shapes_of_the_model_file() -> None:
    tensors = to_tensors(lively(Dropout.FULL))
    assert {name: tensor.shape for name, tensor in tensors.items()} == tensor_shapes()
    assert {tensor.dtype for tensor in tensors.values()} == {np.dtype(np.float32)}


def test_tensors_and_back_is_the_same_network() -> None:
    network, other = lively(Dropout.NONE), fresh_network(OURS_DETERMINISTIC, 99).eval()
    load_tensors(other, to_tensors(network))
    x = torch.from_numpy(INPUTS).float()
    assert torch.equal(network(x), other(x))


def test_tensors_are_copies() -> None:
    network = lively(Dropout.NONE)
    tensors = to_tensors(network)
    tensors["fc_out.bias"] += 1.0
    assert not np.array_equal(tensors["fc_out.bias"], to_tensors(network)["fc_out.bias"])


@pytest.mark.parametrize("damage", ["missing", "unknown", "shape"])
def test_tensors_that_are_not_the_network_s_are_refused(damage: str) -> None:
    tensors = to_tensors(lively(Dropout.NONE))
    if damage == "missing":
        del tensors["fc_out.bias"]
    elif damage == "unknown":
        tensors["fc_more.bias"] = tensors["fc_out.bias"]
    else:
        tensors["fc_out.bias"] = np.zeros(4, np.float32)
    with pytest.raises(RuntimeError, match="fc_"):
        load_tensors(fresh_network(OURS_DETERMINISTIC, 1), tensors)
