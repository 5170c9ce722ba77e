"""Points that assume little: where a mistake sits that margins do not lead to.

Three kinds in turn.  As the space has them.  *Even*: alternatives all alike, however improbable, and
repetitions too.  *At the ends*: even, and any number of coordinates, from none
to all, at the end of their interval, where ranges, masks and comparisons go wrong.
"""

from __future__ import annotations

import numpy as np

from safety_harness.search.cube import Cube, Points
from safety_harness.seeds import Branch, generator


class Explorer:
    """An endless sequence of such points."""

    def __init__(self, cube: Cube, *, seed: int) -> None:
        self._cube = cube
        self._rng = generator(seed, Branch.SEARCH, 1)
        self._made = 0

    def points(self, count: int) -> Points:
        """(count, d)."""
        # Not from a Sobol sequence: of three of many coordinates it may leave a place out for long.
        points = self._rng.random((count, self._cube.dimension))
        kind = (self._made + np.arange(count)) % 3
        self._made += count
        even, at_ends = np.flatnonzero(kind > 0), np.flatnonzero(kind == 2)
        points[even] = self._evened(points[even])
        points[at_ends] = self._at_ends(points[at_ends])
        return points

    def _evened(self, points: Points) -> Points:
        """A coordinate with k intervals is cut into k equal ones, whatever their chances are."""
        for number, column in enumerate(self._cube.columns):
            edges = np.array(column.edges)
            count = len(edges) - 1
            if count > 1:
                place = points[:, number] * count
                interval = np.minimum(place.astype(int), count - 1)
                points[:, number] = edges[interval] + (place - interval) * np.diff(edges)[interval]
        return np.clip(points, 0.0, 1.0)

    def _at_ends(self, points: Points) -> Points:
        share = self._rng.random(len(points))  # of the coordinates, another for each point
        for number, column in enumerate(self._cube.columns):
            if column.flat:
                continue
            chosen = self._rng.random(len(points)) < share
            upper = self._rng.random(len(points)) < 0.5
            edges = np.array(column.edges)
            interval = column.interval_of(points[:, number])
            end = np.where(upper, np.nextafter(edges[interval + 1], 0.0), edges[interval])
            end[upper & (interval == len(edges) - 2)] = 1.0
            points[:, number] = np.where(chosen, end, points[:, number])
        return points
