"""What a searcher remembers: of each claim the points with the least scores, however long it searches."""

from __future__ import annotations

import numpy as np

from safety_harness.search.cube import Cube, Points

_KEPT = 256  # a claim


class Archive:
    """The points with the least scores of one claim, and which of them are far from every place taken.

    Places are taken by descents that began or ended there; ``apart`` is how far others have to be.
    """

    def __init__(self, cube: Cube, apart: float) -> None:
        self._cube, self._apart = cube, apart
        self.points = np.empty((0, cube.dimension))  # canonical, by their scores
        self.scores = np.empty(0)
        self.greatest = -np.inf
        self._free = np.empty(0, bool)
        self._taken: list[Points] = []

    def add(self, points: Points, scores: Points) -> None:
        """(n, d) canonical points and (n,) scores, of which those that are NaN are left out."""
        known = np.isfinite(scores)
        if not known.any():
            return
        self.greatest = max(self.greatest, float(scores[known].max()))
        before = len(self.scores)
        scores = np.concatenate([self.scores, scores[known]])
        points = np.concatenate([self.points, points[known]])
        free = np.concatenate([self._free, np.ones(len(scores) - before, bool)])
        order = np.argsort(scores, kind="stable")[:_KEPT]
        self.points, self.scores, self._free = points[order], scores[order], free[order]
        for new in np.flatnonzero(order >= before):
            self._free[new] = self._is_free(self.points[new])

    def take(self, place: Points) -> None:
        """A descent began or ended at this canonical point (d,)."""
        self._taken.append(place)
        self._free &= self._cube.distances(self.points, place) > self._apart

    @property
    def worst_free(self) -> Points | None:
        """(d,) the point with the least score that is far from every place taken."""
        return self.points[int(np.argmax(self._free))].copy() if self._free.any() else None

    @property
    def flat(self) -> bool:
        """Whether no score differs from another, so that none leads anywhere."""
        return len(self.scores) == 0 or bool(self.greatest - self.scores[0] < 1e-9)

    def _is_free(self, point: Points) -> bool:
        if not self._taken:
            return True
        return bool(np.all(self._cube.distances(np.array(self._taken), point) > self._apart))
