"""A searcher that fills empty cells of the coverage: MAP-Elites (Mouret and Clune, 2015).

Each cell keeps the run that came nearest to a violation, its *elite*. New points vary an elite along the line
to another elite (Vassiliades and Mouret, 2018). Elites of seldom visited cells are varied more often.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np

from safety_harness.base.normals import standard_normal
from safety_harness.base.seeds import Branch, generator
from safety_harness.search.cube import Cube, Point, Points, Scores
from safety_harness.search.sampling import Explorer
from safety_harness.search.search import least

_EXPLORING = 1.0 / 3.0  # fraction of the points; a choice
# Standard deviations: in each coordinate, and along the line as a fraction of its length.  A choice.
_STEP, _ALONG = 0.05, 0.2
_FIRST = 64  # points that explore before the first variation; a choice


@dataclass(eq=False)
class _Elite:
    point: Point
    score: float
    visits: int = 1


class Diverse:
    """The searcher that fills empty cells.

    If runs have no cells, the alternatives of a point and its nearest claim define the cell.

    Args:
        cube: The cube of the space.
        claims: The number of claims.
        seed: The root of all random numbers.

    """

    name = "diverse"

    def __init__(self, cube: Cube, *, claims: int, seed: int) -> None:
        self._cube = cube
        self._explorer = Explorer(cube, seed=seed)
        self._rng = generator(seed, Branch.SEARCH, 3)
        self._elites: dict[Hashable, _Elite] = {}
        self._proposed = 0

    def propose(self, count: int) -> Points:
        """Return ``count`` points (count, d).

        On average, a third of the points explore, and the other points vary elites.
        """
        exploring = count
        if self._proposed >= _FIRST and self._elites:
            exploring = int(self._rng.binomial(count, _EXPLORING))
        self._proposed += count
        points = self._explorer.points(exploring) if exploring else np.empty((0, self._cube.dimension))
        return np.concatenate([points, self._varied(count - exploring)])

    def _varied(self, count: int) -> Points:
        """Return variations (count, d) of elites."""
        elites = list(self._elites.values())
        if count == 0:
            return np.empty((0, self._cube.dimension))
        # Elites of seldom visited cells have a larger weight, because near them are more likely empty cells.
        weight = 1.0 / np.sqrt([elite.visits for elite in elites])
        parents = self._rng.choice(len(elites), size=(count, 2), p=weight / weight.sum())
        points = np.array([elite.point for elite in elites])
        first, second = points[parents[:, 0]], points[parents[:, 1]]
        along = _ALONG * standard_normal(self._rng, (count, 1)) * (second - first)
        around = _STEP * standard_normal(self._rng, first.shape)
        varied: Points = np.clip(first + along + around, 0.0, 1.0)
        return varied

    def learn(self, points: Points, scores: Scores, cells: Sequence[Hashable]) -> None:
        """Make a point the elite of its cell if it comes nearer to a violation than the present elite."""
        lowest = least(scores)
        alternatives = self._cube.canonical(points)[:, self._cube.flat_columns]
        nearest = np.where(np.isnan(scores), np.inf, scores).argmin(axis=1)
        for k, cell in enumerate(cells):
            key = (*alternatives[k].tolist(), int(nearest[k])) if cell is None else cell
            elite = self._elites.get(key)
            if elite is None:
                self._elites[key] = _Elite(points[k].copy(), float(lowest[k]))
                continue
            elite.visits += 1
            if lowest[k] < elite.score:
                elite.point, elite.score = points[k].copy(), float(lowest[k])
