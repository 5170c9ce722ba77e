"""Searchers that do not learn: the baseline, and quasi-random sequences."""

from __future__ import annotations

import warnings
from collections.abc import Hashable, Sequence

from scipy.stats import qmc

from safety_harness.search.cube import Cube, Points
from safety_harness.seeds import Branch, generator


class UniformSampling:
    """Independent points, as the space's own distribution has them: what every search is compared to."""

    name = "uniform"

    def __init__(self, cube: Cube, *, claims: int, seed: int) -> None:
        self._dimension = cube.dimension
        self._rng = generator(seed, Branch.SEARCH)

    def propose(self, count: int) -> Points:
        """Independent points."""
        return self._rng.random((count, self._dimension))

    def learn(self, points: Points, scores: Points, cells: Sequence[Hashable]) -> None:
        """Nothing."""


class QuasiRandom:
    """A scrambled Sobol sequence: evener than chance, in every few coordinates of many."""

    name = "quasi-random"

    def __init__(self, cube: Cube, *, claims: int, seed: int) -> None:
        self._sequence = qmc.Sobol(cube.dimension, scramble=True, rng=generator(seed, Branch.SEARCH))

    def propose(self, count: int) -> Points:
        """The next points of the sequence."""
        with warnings.catch_warnings():
            # It is balanced after powers of two only, which a search that may end any time cannot keep.
            warnings.filterwarnings("ignore", message="The balance properties of Sobol", category=UserWarning)
            points: Points = self._sequence.random(count)
        return points

    def learn(self, points: Points, scores: Points, cells: Sequence[Hashable]) -> None:
        """Nothing."""
