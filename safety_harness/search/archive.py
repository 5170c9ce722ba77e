"""What a searcher remembers: of each claim the points with the least scores, however long it searches."""

from __future__ import annotations

import numpy as np

from safety_harness.search.cube import Points

_KEPT = 256  # a claim


class Archive:
    """The points with the least scores of one claim, and whether scores differ at all."""

    def __init__(self, dimension: int) -> None:
        self.points = np.empty((0, dimension))
        self.scores = np.empty(0)
        self.greatest = -np.inf

    def add(self, points: Points, scores: Points) -> None:
        """(n, d) canonical points and (n,) scores, of which those that are NaN are left out."""
        known = np.isfinite(scores)
        if not known.any():
            return
        self.greatest = max(self.greatest, float(scores[known].max()))
        scores = np.concatenate([self.scores, scores[known]])
        points = np.concatenate([self.points, points[known]])
        order = np.argsort(scores, kind="stable")[:_KEPT]
        self.points, self.scores = points[order], scores[order]

    @property
    def flat(self) -> bool:
        """Whether no score differs from another, so that none leads anywhere."""
        return len(self.scores) == 0 or bool(self.greatest - self.scores[0] < 1e-9)
