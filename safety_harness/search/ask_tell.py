"""Ask and tell: the one way in which every searcher is used, with its order enforced."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import Protocol

import numpy as np

from safety_harness.exceptions import SearchOrderError
from safety_harness.search.cube import Points


class Searcher(Protocol):
    """Proposes points of the unit cube and learns from their scores.

    A score is a margin over a scale: negative where a claim is violated, NaN where nothing was learnt
    of it.  ``learn`` is called with the points that were proposed last, all of them.  The same seed and
    the same scores give the same points.
    """

    @property
    def name(self) -> str:
        """How the command line and reports call it."""

    def propose(self, count: int) -> Points:
        """(m, d) points of the unit cube, at least one and at most ``count``."""

    def learn(self, points: Points, scores: Points, cells: Sequence[Hashable]) -> None:
        """(m, d) points, (m, k) scores, and in which cell of the coverage each run was (None: in none)."""


class AskTell:
    """A searcher in use: ``ask``, then ``tell``, in turns.

    SearchOrderError for the wrong turn, for scores that do not belong to what was asked, and for a
    searcher that proposes what is no point of the cube.
    """

    def __init__(self, searcher: Searcher, dimension: int, claims: int) -> None:
        self._searcher, self.name = searcher, searcher.name
        self._dimension, self._claims = dimension, claims
        self._asked: Points | None = None

    def ask(self, count: int) -> Points:
        """(m, d) points to try, 1 <= m <= ``count``; read-only."""
        if self._asked is not None:
            raise SearchOrderError(f"{self.name}: ask() before the last {len(self._asked)} points were told")
        if count < 1:
            raise SearchOrderError(f"{self.name}: ask() for {count} points; expected at least 1")
        points = np.array(self._searcher.propose(count), dtype=np.float64)
        right = points.ndim == 2 and points.shape[1] == self._dimension and 1 <= len(points) <= count
        if not right or not np.all((points >= 0.0) & (points <= 1.0)):
            raise SearchOrderError(
                f"{self.name} proposed no 1 to {count} points of a unit cube of {self._dimension} coordinates"
            )
        points.setflags(write=False)
        self._asked = points
        return points

    def tell(self, scores: Points, cells: Sequence[Hashable] | None = None) -> None:
        """What came of the points that were asked for last: (m, k) scores, NaN where nothing did."""
        if self._asked is None:
            raise SearchOrderError(f"{self.name}: tell() before ask()")
        wanted = (len(self._asked), self._claims)
        cells = [None] * len(self._asked) if cells is None else cells
        if scores.shape != wanted or len(cells) != len(self._asked):
            raise SearchOrderError(
                f"{self.name}: tell() expects scores of shape {wanted}; got {scores.shape}"
            )
        told = scores.astype(np.float64)
        told[np.isinf(told)] = np.nan  # an infinite margin comes from nothing that can have happened
        points, self._asked = self._asked, None
        self._searcher.learn(points, told, cells)


def least(scores: Points) -> Points:
    """(n, k) scores -> (n,) the least of each row, +inf for rows without any."""
    lowest: Points = np.where(np.isnan(scores), np.inf, scores).min(axis=1)
    return lowest
