"""The compiled network decides as PyTorch does with the same masks."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from disagreement import noted
from numpy.typing import NDArray

from safety_harness.cell.avoidance.masks import masks
from safety_harness.cell.avoidance.model_file import PLACES, WIDTH, Dropout, Model
from safety_harness.cell.avoidance.resnet_kernel import decide, fold
from tests.cell.avoidance.random_models import normalised_input, random_inputs, random_model

KINDS = [(Dropout.NONE, 1), (Dropout.NONE, 5), (Dropout.INTER, 1), (Dropout.FULL, 1)]
every_kind = pytest.mark.parametrize(("dropout", "members"), KINDS, ids=lambda value: str(value))

# Some thirty layers of float32 (6e-8 relative) with targets of 34 to 75 mm standard deviation.
ROUNDING_M = 2e-6


def decided(model: Model, hands: Any, tcps: Any, seeds: Any) -> tuple[NDArray[np.float64], ...]:
    positions, spreads = np.empty(hands.shape), np.empty(hands.shape)
    decide(fold(model), hands, tcps, seeds, positions, spreads)
    return positions, spreads


def masks_of(model: Model, seed: np.uint64) -> NDArray[np.bool_]:
    passes = model.passes if PLACES[model.dropout] else 1
    return masks(seed, passes, PLACES[model.dropout], WIDTH, model.dropout_probability)


def summary(model: Model, answers: Any) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean and standard deviation of normalised answers (n, 3), in metres."""
    positions = np.array(model.target_mean) + np.array(model.target_std) * np.asarray(answers, np.float64)
    return positions.mean(axis=0), positions.std(axis=0)


@every_kind
def test_a_decision_equals_that_of_pytorch_with_the_same_masks(dropout: Dropout, members: int) -> None:
    torch = pytest.importorskip("torch", reason="PyTorch is not installed (pip install -e '.[learning]')")
    from safety_harness.extensions.lab.learning.networks import RegressionResNet, load_tensors

    model = random_model(dropout, members=members, seed=4)
    hands, tcps, seeds = random_inputs(20, seed=2)
    positions, spreads = decided(model, hands, tcps, seeds)
    networks = []
    for member in range(members):
        network = RegressionResNet(dropout=dropout, probability=model.dropout_probability).eval()
        own = {name: t for name, t in model.tensors.items() if name.startswith(f"{member}/")}
        load_tensors(network, {name.removeprefix(f"{member}/"): t for name, t in own.items()})
        networks.append(network)
    for n in range(len(seeds)):
        x = torch.tensor(normalised_input(model, hands[n], tcps[n]), dtype=torch.float32)[None]
        answers = []
        with torch.no_grad():
            for network in networks:
                for mask in masks_of(model, seeds[n]):
                    given = torch.from_numpy(mask) if len(mask) else None
                    answers.append(network(x, given).numpy()[0])
        mean, deviation = summary(model, answers)
        noted("PyTorch", "decisions with the same masks", "mm", positions[n], mean, 1e3)
        assert positions[n] == pytest.approx(mean, abs=ROUNDING_M)
        assert spreads[n] == pytest.approx(deviation, abs=ROUNDING_M)
