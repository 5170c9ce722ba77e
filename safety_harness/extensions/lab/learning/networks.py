"""The regression ResNet of figures 3 and 4 in PyTorch: Chen et al. (2020), with dropout after Gal.

Dropout is never a hidden state of the module: a forward pass receives its masks, or it has no dropout.  One
Monte Carlo pass is a forward pass with masks in evaluation mode, in which batch normalisation uses running
statistics.  Another implementation can use the same masks.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from safety_harness.cell.avoidance.model_file import (
    BLOCKS,
    INPUTS,
    OUTPUTS,
    PERCEPTRON,
    PERCEPTRON_INPUTS,
    PLACES,
    STAGES,
    WIDTH,
    Dropout,
)
from safety_harness.extensions.lab.learning.recipes import Recipe

UNTRACKED = "num_batches_tracked"  # a counter of PyTorch that a trained network does not need

Masks = Sequence[Tensor] | Tensor
Drop = Callable[[Tensor], Tensor]


def _keep(x: Tensor) -> Tensor:
    """Return ``x`` unchanged, for a place without dropout."""
    return x


def _next_masks(masks: Masks, probability: float) -> Drop:
    """Return inverted dropout: each call applies the next mask and divides by the kept share of units."""
    left, scale = iter(masks), 1.0 / (1.0 - probability)
    return lambda x: x * (next(left)[..., : x.shape[-1]] * scale)


class Block(nn.Module):
    """Three fully connected layers beside a shortcut (figure 4); the shortcut is dense or the identity."""

    def __init__(self, inputs: int, *, dense: bool) -> None:
        super().__init__()
        self.fc1, self.bn1 = nn.Linear(inputs, WIDTH), nn.BatchNorm1d(WIDTH)
        self.fc2, self.bn2 = nn.Linear(WIDTH, WIDTH), nn.BatchNorm1d(WIDTH)
        self.fc3, self.bn3 = nn.Linear(WIDTH, WIDTH), nn.BatchNorm1d(WIDTH)
        self.dense = dense
        if dense:
            self.fcs, self.bns = nn.Linear(inputs, WIDTH), nn.BatchNorm1d(WIDTH)

    def forward(self, x: Tensor, drop: Drop) -> Tensor:
        """Return relu(bn3 fc3 relu(bn2 fc2 relu(bn1 fc1 x)) + shortcut(x)), (n, WIDTH).

        The shortcut is bns fcs x, or x itself.

        Args:
            x: (n, inputs) the input.
            drop: The dropout before fc1, fc2, fc3 and fcs, in this order.

        """
        h = torch.relu(self.bn1(self.fc1(drop(x))))
        h = torch.relu(self.bn2(self.fc2(drop(h))))
        h = self.bn3(self.fc3(drop(h)))
        shortcut = self.bns(self.fcs(drop(x))) if self.dense else x
        return torch.relu(h + shortcut)


class RegressionResNet(nn.Module):
    """Stages of one dense block and some identity blocks, then batch norm and a fully connected layer.

    Inputs (n, 7) and outputs (n, 3), which are positions, are float32, normalised or in raw millimetres.

    Args:
        dropout: The places of dropout: none, the output of each stage (INTER), or before every layer (FULL).
        probability: The probability of dropping a unit.

    Raises:
        ValueError: ``probability`` is not in [0, 1).

    """

    def __init__(
        self,
        *,
        dropout: Dropout = Dropout.NONE,
        probability: float = 0.1,
    ) -> None:
        super().__init__()
        if not 0.0 <= probability < 1.0:
            raise ValueError(f"a dropout probability lies in [0, 1): {probability}")
        self.dropout, self.probability = dropout, probability
        self.stages = nn.ModuleList(
            nn.ModuleList(Block(INPUTS if s == b == 0 else WIDTH, dense=b == 0) for b in range(BLOCKS))
            for s in range(STAGES)
        )
        self.bn_out = nn.BatchNorm1d(WIDTH)
        self.fc_out = nn.Linear(WIDTH, OUTPUTS)

    @property
    def places(self) -> int:
        """The number of dropout places, and so of masks: the outputs of stages, or the inputs of layers."""
        return PLACES[self.dropout]

    def draw_masks(self, rows: int, generator: torch.Generator) -> Tensor:
        """Return masks (places, rows, WIDTH) of 1 (keep) and 0 (drop), on the generator's device.

        Args:
            rows: The number of rows.
            generator: The generator of the draws.

        """
        masks = torch.empty((self.places, rows, WIDTH), device=generator.device)
        return masks.bernoulli_(1.0 - self.probability, generator=generator)

    def forward(self, x: Tensor, masks: Masks | None = None) -> Tensor:
        """Return the outputs (n, 3).

        Args:
            x: (n, 7) the inputs.
            masks: A mask for each of ``places``; 1 or true keeps a unit.  Its shape is (n, WIDTH), or
                (WIDTH,) for all rows alike.  A place with fewer than ``WIDTH`` units (the seven inputs of the
                first layers) uses the first entries of its mask.  None means no dropout.

        Raises:
            ValueError: The number of masks is wrong.

        """
        if masks is not None and len(masks) != self.places:
            raise ValueError(f"expected {self.places} dropout masks, got {len(masks)}")
        drop: Drop = _next_masks(masks, self.probability) if masks is not None and self.places else _keep
        inside, at_stage = (drop, _keep) if self.dropout is Dropout.FULL else (_keep, drop)
        for stage in self.stages:
            for block in stage:  # type: ignore[attr-defined]
                x = block(x, inside)
            x = at_stage(x)
        y: Tensor = self.fc_out(inside(self.bn_out(x)))
        return y


class ReluPerceptron(nn.Module):
    """Two hidden layers with ReLU; the interface is the ResNet's, but masks and constant have no effect."""

    def __init__(self) -> None:
        super().__init__()
        self.fc1, self.fc2 = nn.Linear(PERCEPTRON_INPUTS, WIDTH), nn.Linear(WIDTH, WIDTH)
        self.fc_out = nn.Linear(WIDTH, OUTPUTS)

    def forward(self, x: Tensor, masks: Masks | None = None) -> Tensor:
        """Return the outputs (n, 3) for the inputs ``x`` (n, 7); ``masks`` have no effect."""
        h = torch.relu(self.fc1(x[:, :PERCEPTRON_INPUTS]))
        y: Tensor = self.fc_out(torch.relu(self.fc2(h)))
        return y


Network = RegressionResNet | ReluPerceptron


def network_of(kind: str, dropout: Dropout, probability: float) -> Network:
    """Return a network of one of the two kinds that a model file can hold.

    Args:
        kind: The kind.
        dropout: The places of dropout.
        probability: The probability of dropping a unit.

    """
    return (
        ReluPerceptron() if kind == PERCEPTRON else RegressionResNet(dropout=dropout, probability=probability)
    )


def fresh_network(recipe: Recipe, seed: int) -> Network:
    """Return a network of ``recipe`` with PyTorch's usual initial weights, drawn from ``seed`` alone."""
    with torch.random.fork_rng(devices=[]):  # layers draw from the global generator; this restores its state
        torch.default_generator.manual_seed(seed)
        return network_of(recipe.kind, recipe.dropout, recipe.dropout_probability)


def to_tensors(network: Network) -> dict[str, NDArray[np.float32]]:
    """Return copies of the weights and running statistics of ``network``, float32, by state-dict name."""
    return {
        name: tensor.detach().cpu().numpy().copy()
        for name, tensor in network.state_dict().items()
        if not name.endswith(UNTRACKED)
    }


def load_tensors(network: Network, tensors: Mapping[str, NDArray[np.float32]]) -> None:
    """Load the tensors of ``to_tensors`` into ``network``; raise RuntimeError for a wrong name or shape."""
    state = {name: torch.from_numpy(np.array(array)) for name, array in tensors.items()}
    counters = {name: t for name, t in network.state_dict().items() if name.endswith(UNTRACKED)}
    network.load_state_dict(state | counters)
