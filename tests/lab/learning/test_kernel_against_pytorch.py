"""The compiled network decides as PyTorch does with the same masks."""

from __future__ import annotations

import pytest
from disagreement import noted

from safety_harness.cell.avoidance.model_file import Dropout
from tests.cell.avoidance.random_models import normalised_input, random_inputs, random_model
from tests.cell.avoidance.test_resnet_kernel import ROUNDING_M, decided, every_kind, masks_of, summary


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
