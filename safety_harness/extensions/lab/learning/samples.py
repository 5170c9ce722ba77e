"""Samples as a network takes them: float32, in normalised variables or in millimetres."""

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
    """Numbered samples, made when they are asked for."""

    def inputs(self, index: Index, /) -> NDArray[np.float64]:
        """Hand and TCP position in the base frame [m], (n, 6)."""
        ...

    def targets(self, index: Index, /) -> NDArray[np.float64]:
        """Repulsive position in the base frame [m], (n, 3)."""
        ...


@dataclass(frozen=True, eq=False)
class ArraySamples:
    """Samples that lie in arrays: (n, 6) and (n, 3), metres, base frame."""

    all_inputs: NDArray[np.float64]
    all_targets: NDArray[np.float64]

    def inputs(self, index: Index) -> NDArray[np.float64]:
        """See ``Samples``."""
        return self.all_inputs[index]

    def targets(self, index: Index) -> NDArray[np.float64]:
        """See ``Samples``."""
        return self.all_targets[index]


def samples_for(recipe: Recipe, dataset: CompactDataset) -> Samples:
    """The samples of a data set with the target that the recipe names."""
    return dataset.without_noise() if recipe.target == "continuous" else dataset


@dataclass(frozen=True, eq=False)
class Normalisation:
    """network variable = (value [m] - mean) / std; means and stds in metres, float64."""

    input_mean: NDArray[np.float64]  # (6,)
    input_std: NDArray[np.float64]  # (6,)
    target_mean: NDArray[np.float64]  # (3,)
    target_std: NDArray[np.float64]  # (3,)

    @classmethod
    def of(cls, recipe: Recipe, mean: NDArray[np.float64], std: NDArray[np.float64]) -> Normalisation:
        """By ``mean`` and ``std`` (9,), or plain millimetres if the recipe does not normalise."""
        if recipe.normalise:
            return cls(mean[:6], std[:6], mean[6:], std[6:])
        return cls(np.zeros(6), np.full(6, 1e-3), np.zeros(3), np.full(3, 1e-3))


def moments(samples: Samples, index: Index) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean and standard deviation [m] of the six inputs and three targets, (9,) each, over ``index`` (n,).

    ModelError if one of the nine columns does not vary.
    """
    origin = _columns(samples, index[:1])[0]  # near the mean: no cancellation in the squares
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
    return np.concatenate([samples.inputs(index), samples.targets(index)], axis=1)  # (n, 9)


def network_inputs(inputs: NDArray[np.float64], normalisation: Normalisation) -> NDArray[np.float32]:
    """``inputs`` (n, 6) in metres to the network's (n, 7): (x - mean)/std, and the constant 1 at the end."""
    x = np.ones((len(inputs), 7), dtype=np.float32)
    x[:, :6] = (inputs - normalisation.input_mean) / normalisation.input_std
    return x


def network_samples(
    samples: Samples, index: Index, normalisation: Normalisation
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Inputs (n, 7) and targets (n, 3) of the samples of ``index``, as the network takes them."""
    x = np.empty((len(index), 7), dtype=np.float32)
    y = np.empty((len(index), 3), dtype=np.float32)
    for start in range(0, len(index), CHUNK):
        part = index[start : start + CHUNK]
        rows = slice(start, start + len(part))
        x[rows] = network_inputs(samples.inputs(part), normalisation)
        y[rows] = (samples.targets(part) - normalisation.target_mean) / normalisation.target_std
    return x, y
