"""Define searchers that ignore scores: uniform sampling, quasi-random sequences and exploration."""

from __future__ import annotations

import warnings
from collections.abc import Hashable, Sequence

import numpy as np
import scipy
from numpy.typing import NDArray

from safety_harness.base.elementary import log
from safety_harness.base.seeds import Branch, generator
from safety_harness.search.cube import Cube, Points, Scores


class UniformSampling:
    """A searcher that draws independent points from the space's own distribution.

    Uniform sampling is the baseline of every search.
    """

    name = "uniform"

    def __init__(self, cube: Cube, *, claims: int, seed: int) -> None:
        self._dimension = cube.dimension
        self._rng = generator(seed, Branch.SEARCH)

    def propose(self, count: int) -> Points:
        """Return ``count`` independent points (count, d)."""
        return self._rng.random((count, self._dimension))

    def learn(self, points: Points, scores: Scores, cells: Sequence[Hashable]) -> None:
        """Ignore the scores."""


class QuasiRandom:
    """A searcher that uses a scrambled Sobol sequence.

    In any few coordinates, the points of a Sobol sequence are distributed more evenly than random points.
    """

    name = "quasi-random"

    def __init__(self, cube: Cube, *, claims: int, seed: int) -> None:
        self._sequence = scipy.stats.qmc.Sobol(
            cube.dimension, scramble=True, rng=generator(seed, Branch.SEARCH)
        )

    def propose(self, count: int) -> Points:
        """Return the next ``count`` points of the sequence (count, d)."""
        with warnings.catch_warnings():
            # The sequence is balanced only after a power of two of points; a search may end at any number.
            warnings.filterwarnings("ignore", message="The balance properties of Sobol", category=UserWarning)
            points: Points = self._sequence.random(count)
        return points

    def learn(self, points: Points, scores: Scores, cells: Sequence[Hashable]) -> None:
        """Ignore the scores."""


_AT_ENDS, _UNTIL = 1.0 / 3.0, 400.0  # a third of the first 400 points; then the share falls as 1 / number


class Explorer:
    """An endless sequence of points that can find faults to which no margin leads.

    There are three kinds of points. The first kind follows the space's own distribution. The second kind is
    called *even*. For these points, all alternatives and repetitions have the same probability, even if they
    are improbable in the space. The third kind is called *at the ends*. These points are also even, but a
    random fraction of the coordinates of each point lies at an end of an interval. Such points reveal
    mistakes in ranges, masks and comparisons.

    There are few ends, so that a search soon finds a fault at an end. Initially, a third of the points are at
    the ends. This fraction decreases during the search. The other points alternate between the first two
    kinds.

    Args:
        cube: The cube of the space.
        seed: The root of all random numbers.

    """

    def __init__(self, cube: Cube, *, seed: int) -> None:
        self._cube = cube
        self._rng = generator(seed, Branch.SEARCH, 1)
        self._made = 0

    def points(self, count: int) -> Points:
        """Return the next ``count`` points (count, d)."""
        # Random, because a Sobol sequence missed a region in three coordinates for more than 13,000 points.
        points = self._rng.random((count, self._cube.dimension))
        number = self._made + np.arange(count + 1)
        self._made += count
        at_ends = np.flatnonzero(np.diff(np.floor(_points_at_ends(number))) > 0)
        even = np.union1d(np.flatnonzero(number[:-1] % 2), at_ends)
        points[even] = self._evened(points[even])
        points[at_ends] = self._at_ends(points[at_ends])
        return points

    def _evened(self, points: Points) -> Points:
        """Move ``points`` so that all intervals of a coordinate are equally likely, and return them."""
        for number, column in enumerate(self._cube.columns):
            edges = np.array(column.edges)
            count = len(edges) - 1
            if count > 1:
                place = points[:, number] * count
                interval = np.minimum(place.astype(int), count - 1)
                points[:, number] = edges[interval] + (place - interval) * np.diff(edges)[interval]
        return np.clip(points, 0.0, 1.0)

    def _at_ends(self, points: Points) -> Points:
        """Return ``points`` with some coordinates at an end of their interval.

        The fraction of these coordinates is random for each point.
        """
        share = self._rng.random(len(points))  # of the coordinates, drawn for each point
        for number, column in enumerate(self._cube.columns):
            if column.flat:
                continue
            chosen = self._rng.random(len(points)) < share
            upper = self._rng.random(len(points)) < 0.5
            edges = np.array(column.edges)
            interval = column.interval_of(points[:, number])
            # The upper edge itself belongs to the next interval, except in the last one.
            end = np.where(upper, np.nextafter(edges[interval + 1], 0.0), edges[interval])
            end[upper & (interval == len(edges) - 2)] = 1.0
            points[:, number] = np.where(chosen, end, points[:, number])
        return points


def _points_at_ends(number: NDArray[np.int64]) -> Points:
    """Return how many of the first ``number`` points are at the ends.

    ``number`` and the result have the shape (n,).
    """
    first = np.minimum(number, _UNTIL)
    at_ends: Points = _AT_ENDS * (first + _UNTIL * log(np.maximum(number, _UNTIL) / _UNTIL))
    return at_ends
