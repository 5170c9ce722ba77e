"""Convert samples to a network's training data: float32, either normalised or in millimetres."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.exceptions import ModelError, Place
from safety_harness.extensions.lab.learning.dataset import CompactDataset
from safety_harness.extensions.lab.learning.recipes import Recipe

Index = NDArray[np.int64]
CHUNK = 200_000  # samples that are held as float64 at a time


class Samples(Protocol):
    """A set of training samples; a sample is selected by its number and may be computed on demand."""

    def inputs(self, index: Index, /) -> NDArray[np.float64]:
        """Return the positions of hand and TCP in the base frame, shape (n, 6) [m]."""
        ...

    def targets(self, index: Index, /) -> NDArray[np.float64]:
        """Return the repulsive positions in the base frame, shape (n, 3) [m]."""
        ...


@dataclass(frozen=True, eq=False)
class ArraySamples:
    """Samples in arrays: inputs (n, 6) and targets (n, 3), in metres and in the base frame."""

    all_inputs: NDArray[np.float64]
    all_targets: NDArray[np.float64]

    def inputs(self, index: Index) -> NDArray[np.float64]:
        """Return the inputs of the samples whose numbers are in ``index``, shape (len, 6)."""
        return self.all_inputs[index]

    def targets(self, index: Index) -> NDArray[np.float64]:
        """Return the targets of the samples whose numbers are in ``index``, shape (len, 3)."""
        return self.all_targets[index]


def samples_for(recipe: Recipe, dataset: CompactDataset) -> Samples:
    """Return the samples of ``dataset`` with the kind of target that ``recipe`` requires."""
    return dataset.without_noise() if recipe.target == "continuous" else dataset


@dataclass(frozen=True, eq=False)
class Normalisation:
    """The normalisation of a network's inputs and targets: (value - mean) / std.

    The values, means and standard deviations are in metres.
    """

    input_mean: NDArray[np.float64]  # (6,)
    input_std: NDArray[np.float64]  # (6,)
    target_mean: NDArray[np.float64]  # (3,)
    target_std: NDArray[np.float64]  # (3,)

    @classmethod
    def from_recipe(
        cls, recipe: Recipe, mean: NDArray[np.float64], std: NDArray[np.float64]
    ) -> Normalisation:
        """Return the normalisation for a recipe.

        It uses ``mean`` and ``std`` if the recipe normalises, and otherwise only converts to millimetres.

        Args:
            recipe: The recipe.
            mean: (9,) the means of inputs and targets [m].
            std: (9,) the standard deviations of inputs and targets [m].

        """
        if recipe.normalise:
            return cls(mean[:6], std[:6], mean[6:], std[6:])
        return cls(np.zeros(6), np.full(6, 1e-3), np.zeros(3), np.full(3, 1e-3))


def moments(samples: Samples, index: Index) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the means and standard deviations of the six inputs and three targets, shape (9,) each [m].

    Args:
        samples: The samples.
        index: (n,) the numbers of the samples to use.

    Raises:
        ModelError: One of the nine columns does not vary by more than 1 um.

    """
    origin = _columns(samples, index[:1])[0]  # an origin near the mean avoids cancellation in the squares
    total, squares = np.zeros(9), np.zeros(9)
    for start in range(0, len(index), CHUNK):
        shifted = _columns(samples, index[start : start + CHUNK]) - origin
        total += shifted.sum(axis=0)
        squares += (shifted**2).sum(axis=0)
    mean = total / len(index)
    variance = squares / len(index) - mean**2
    if not np.all(variance > 1e-12):
        column = int(np.argmin(variance > 1e-12))
        raise ModelError(
            place=Place(field="training samples"),
            expected="finite inputs and targets that vary along every axis by more than 1 um",
            got=f"a variance of {variance[column]:g} m^2 in column {column} of hand, TCP, target",
        )
    return origin + mean, np.sqrt(variance)


def _columns(samples: Samples, index: Index) -> NDArray[np.float64]:
    """Return the inputs and targets of samples as the columns of one array, shape (n, 9)."""
    return np.concatenate([samples.inputs(index), samples.targets(index)], axis=1)  # (n, 9)


def network_inputs(inputs: NDArray[np.float64], normalisation: Normalisation) -> NDArray[np.float32]:
    """Return the network's inputs, shape (n, 7).

    The first six columns are (x - mean)/std, where x is ``inputs`` of shape (n, 6) [m].  The last column is
    1.
    """
    x = np.ones((len(inputs), 7), dtype=np.float32)
    x[:, :6] = (inputs - normalisation.input_mean) / normalisation.input_std
    return x


def network_samples(
    samples: Samples, index: Index, normalisation: Normalisation
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return a network's inputs and targets for the samples ``index``, shapes (n, 7) and (n, 3)."""
    x = np.empty((len(index), 7), dtype=np.float32)
    y = np.empty((len(index), 3), dtype=np.float32)
    for start in range(0, len(index), CHUNK):
        part = index[start : start + CHUNK]
        rows = slice(start, start + len(part))
        x[rows] = network_inputs(samples.inputs(part), normalisation)
        y[rows] = (samples.targets(part) - normalisation.target_mean) / normalisation.target_std
    return x, y
