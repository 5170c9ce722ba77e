"""The networks in PyTorch: the regression ResNet of figures 3 and 4, and a small perceptron.

The ResNet follows Chen et al. 2020, with dropout according to Gal.

The caller passes dropout masks to each forward pass; without masks, the pass has no dropout.  A Monte Carlo
pass is a forward pass with masks in evaluation mode, in which batch normalisation uses its running
statistics.  Because the masks are arguments, another implementation can use the same masks.
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
    """Return ``x`` unchanged, for the places where a network has no dropout."""
    return x


def _next_masks(masks: Masks, probability: float) -> Drop:
    """Return a function for inverted dropout.

    Each call applies the next mask and divides by the expected fraction of units that dropout keeps.
    """
    left, scale = iter(masks), 1.0 / (1.0 - probability)
    return lambda x: x * (next(left)[..., : x.shape[-1]] * scale)


class Block(nn.Module):
    """A residual block of three fully connected layers and a shortcut (figure 4).

    The shortcut is either a fully connected layer or the identity.
    """

    def __init__(self, inputs: int, *, dense: bool) -> None:
        super().__init__()
        self.fc1, self.bn1 = nn.Linear(inputs, WIDTH), nn.BatchNorm1d(WIDTH)
        self.fc2, self.bn2 = nn.Linear(WIDTH, WIDTH), nn.BatchNorm1d(WIDTH)
        self.fc3, self.bn3 = nn.Linear(WIDTH, WIDTH), nn.BatchNorm1d(WIDTH)
        self.dense = dense
        if dense:
            self.fcs, self.bns = nn.Linear(inputs, WIDTH), nn.BatchNorm1d(WIDTH)

    def forward(self, x: Tensor, drop: Drop) -> Tensor:
        """Return relu(bn3 fc3 relu(bn2 fc2 relu(bn1 fc1 x)) + shortcut(x)), shape (n, WIDTH).

        The shortcut is bns fcs x for a dense block, and otherwise x itself.

        Args:
            x: (n, inputs) the input.
            drop: A function that applies dropout to the inputs of fc1, fc2, fc3 and fcs, in this order.

        """
        h = torch.relu(self.bn1(self.fc1(drop(x))))
        h = torch.relu(self.bn2(self.fc2(drop(h))))
        h = self.bn3(self.fc3(drop(h)))
        shortcut = self.bns(self.fcs(drop(x))) if self.dense else x
        return torch.relu(h + shortcut)


class RegressionResNet(nn.Module):
    """A regression network of several stages, followed by batch normalisation and a fully connected layer.

    Each stage has one block with a dense shortcut and several blocks with an identity shortcut.

    The inputs, shape (n, 7), and the outputs, shape (n, 3), are float32 positions.  They are either
    normalised or in millimetres.  The seventh input is the constant 1.

    Args:
        dropout: Where the network applies dropout: nowhere (NONE), to the output of each stage (INTER), or to
            the input of every layer (FULL).
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
        """The number of places with dropout, which equals the number of masks."""
        return PLACES[self.dropout]

    def draw_masks(self, rows: int, generator: torch.Generator) -> Tensor:
        """Return random masks of shape (places, rows, WIDTH), on the generator's device.

        An entry 1 keeps a unit, and 0 drops it.

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
            masks: A mask for each of the ``places`` with dropout.  An entry of 1 or True keeps a unit.  A
                mask has the shape (n, WIDTH), or the shape (WIDTH,) if it applies to all rows.  A place with
                fewer than ``WIDTH`` units (the seven inputs of the first layers) uses the first entries of
                its mask.  None means no dropout.

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
    """A network with two hidden layers and ReLU.

    It has the same interface as the ResNet, but it ignores the masks and the constant input.
    """

    def __init__(self) -> None:
        super().__init__()
        self.fc1, self.fc2 = nn.Linear(PERCEPTRON_INPUTS, WIDTH), nn.Linear(WIDTH, WIDTH)
        self.fc_out = nn.Linear(WIDTH, OUTPUTS)

    def forward(self, x: Tensor, masks: Masks | None = None) -> Tensor:
        """Return the outputs for the inputs ``x``, shape (n, 3).

        ``x`` has the shape (n, 7).  The network ignores ``masks``.
        """
        h = torch.relu(self.fc1(x[:, :PERCEPTRON_INPUTS]))
        y: Tensor = self.fc_out(torch.relu(self.fc2(h)))
        return y


Network = RegressionResNet | ReluPerceptron


def network_of(kind: str, dropout: Dropout, probability: float) -> Network:
    """Return a network of one of the two kinds that a model file can hold.

    Args:
        kind: The kind.
        dropout: The places at which the network applies dropout.
        probability: The probability of dropping a unit.

    """
    return (
        ReluPerceptron() if kind == PERCEPTRON else RegressionResNet(dropout=dropout, probability=probability)
    )


def fresh_network(recipe: Recipe, seed: int) -> Network:
    """Return a network of ``recipe`` with random initial weights, which depend only on ``seed``.

    The weights have PyTorch's default distribution.
    """
    with torch.random.fork_rng(devices=[]):  # layers draw from the global generator; this restores its state
        torch.default_generator.manual_seed(seed)
        return network_of(recipe.kind, recipe.dropout, recipe.dropout_probability)


def to_tensors(network: Network) -> dict[str, NDArray[np.float32]]:
    """Return float32 copies of the weights and running statistics of ``network``.

    The keys are the names in PyTorch's state dictionary.
    """
    return {
        name: tensor.detach().cpu().numpy().copy()
        for name, tensor in network.state_dict().items()
        if not name.endswith(UNTRACKED)
    }


def load_tensors(network: Network, tensors: Mapping[str, NDArray[np.float32]]) -> None:
    """Load the tensors that ``to_tensors`` returned into ``network``.

    Raise RuntimeError if a tensor has a wrong name or shape.
    """
    state = {name: torch.from_numpy(np.array(array)) for name, array in tensors.items()}
    counters = {name: t for name, t in network.state_dict().items() if name.endswith(UNTRACKED)}
    network.load_state_dict(state | counters)
