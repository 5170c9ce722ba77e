"""Define the default searcher, which explores the space and descends from bad points that lie far apart.

A third of the points explore the space with ``Explorer``. The other points serve descents with CMA-ES, and
each claim gets the same number of points. A descent begins at the worst known point of a claim, and keeps
that point's alternatives. A descent ends when it finds a violation or no longer improves. The next descent
begins far from that place.

All known margins of a claim may be equal. In that case there is no direction of descent, and the points of
that claim serve exploration. While there is such a claim, each unsuccessful descent for another claim reduces
the fraction of points that this other claim gets.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.seeds import Branch, generator
from safety_harness.search.cma_es import Descent
from safety_harness.search.cube import Cube, Point, Points, Scores
from safety_harness.search.sampling import Explorer

_KEPT = 256  # points for each claim


class Archive:
    """The points with the least scores of one claim.

    A mark on each point states whether it is far from all occupied places. A descent occupies the places
    where it began and ended. The archive keeps at most 256 points, however long the search is.

    Args:
        cube: The cube of the space.
        least_apart: The least distance from an occupied place, as ``Cube.distances`` measures it.

    """

    def __init__(self, cube: Cube, least_apart: float) -> None:
        self._cube, self._apart = cube, least_apart
        self.points = np.empty((0, cube.dimension))  # canonical, by their scores
        self.scores = np.empty(0)
        self.greatest = -np.inf
        self._free = np.empty(0, bool)
        self._taken = np.empty((0, cube.dimension))

    def add(self, points: Points, scores: NDArray[np.float64]) -> None:
        """Add each of the canonical ``points`` (n, d) whose value in ``scores`` (n,) is finite."""
        known = np.isfinite(scores)
        if not known.any():
            return
        self.greatest = max(self.greatest, float(scores[known].max()))
        old_count = len(self.scores)
        scores = np.concatenate([self.scores, scores[known]])
        points = np.concatenate([self.points, points[known]])
        free = np.concatenate([self._free, np.ones(len(scores) - old_count, bool)])
        order = np.argsort(scores, kind="stable")[:_KEPT]
        self.points, self.scores, self._free = points[order], scores[order], free[order]
        # Compare only the new points with the occupied places; the other points keep their marks.
        for new in np.flatnonzero(order >= old_count):
            self._free[new] = np.all(self._cube.distances(self._taken, self.points[new]) > self._apart)

    def take(self, place: Point) -> None:
        """Occupy the canonical point ``place`` (d,), where a descent began or ended."""
        self._taken = np.vstack([self._taken, place])
        self._free &= self._cube.distances(self.points, place) > self._apart

    @property
    def worst_free(self) -> Point | None:
        """The point (d,) with the least score among the points that are far from every occupied place.

        The result is None if there is no such point.
        """
        return self.points[int(np.argmax(self._free))].copy() if self._free.any() else None

    @property
    def flat(self) -> bool:
        """Whether all scores are equal.

        If all scores are equal, no direction leads to a lower score.
        """
        return len(self.scores) == 0 or bool(self.greatest - self.scores[0] < 1e-9)


_EXPLORING = 1.0 / 3.0  # fraction of the points; a choice
_LEAST_APART = 0.15  # root mean square over the cube, between the places of descents on one claim
_STEP = 0.15  # first standard deviation of a descent; a choice
_BETTER = 0.01  # the least improvement of a score that counts


@dataclass(eq=False)
class _Island:
    """A descent, its claim, its best place, and the least score that the claim had when the descent began."""

    claim: int
    descent: Descent
    end: Point  # canonical, the best place so far
    known: float  # the claim's least score when it began
    score: float = np.inf


class Default:
    """The default searcher, which the module's docstring describes.

    Args:
        cube: The cube of the space.
        claims: The number of claims.
        seed: The root of all random numbers.

    """

    name = "default"

    def __init__(self, cube: Cube, *, claims: int, seed: int) -> None:
        self._cube, self._seed, self._claims = cube, seed, claims
        self._explorer = Explorer(cube, seed=seed)
        self._archives = [Archive(cube, _LEAST_APART) for _ in range(claims)]
        self._islands: list[_Island] = []
        self._begun = self._explored = self._proposed = self._next_claim = 0
        self._in_vain = [0] * claims  # descents since the last one that found a violation or a lesser score
        self._due = 0.0  # points of exploration still to propose
        self._parts: list[tuple[_Island | None, int]] = []

    @property
    def _first(self) -> int:
        """The number of points that explore before the first descent."""
        return max(32, 4 * self._cube.dimension)

    def propose(self, count: int) -> Points:
        """Return ``count`` points, shape (count, d).

        Some points explore. The remaining points belong to as many descents as the number of points permits.
        """
        self._parts = []
        exploring = min(max(self._first - self._explored, 0), count)
        if exploring < count and self._proposed >= self._first:
            # Add up the fractions, so that small batches explore as often as large ones.
            self._due += self._exploring * count
            exploring = min(int(self._due), count)
        proposed = self._descending(count - exploring)
        exploring = count - sum(map(len, proposed))
        if exploring:
            proposed.append(self._explorer.points(exploring))
            self._parts.append((None, exploring))
            self._explored += exploring
        self._due -= min(exploring, self._due)
        self._proposed += count
        return np.concatenate(proposed)

    @property
    def _exploring(self) -> float:
        """The fraction of the points that explore."""
        flat = [archive.flat for archive in self._archives]
        shares = [0.0 if f else math.ldexp(1.0, -vain) for f, vain in zip(flat, self._in_vain, strict=True)]
        descending = sum(shares) if any(flat) else self._claims
        return 1.0 - (1.0 - _EXPLORING) * descending / self._claims

    def learn(self, points: Points, scores: Scores, cells: Sequence[Hashable]) -> None:
        """Add all points to the archives, and let each descent learn the scores of its own points."""
        canonical = self._cube.canonical(points)
        for claim, archive in enumerate(self._archives):
            archive.add(canonical, scores[:, claim])
        begin = 0
        for island, count in self._parts:
            part = slice(begin, begin + count)
            begin += count
            if island is not None:
                self._advance(island, canonical[part], scores[part, island.claim])

    def _advance(self, island: _Island, canonical: Points, scores: Scores) -> None:
        """Let the descent of ``island`` learn ``scores``.

        A violation, or a lack of improvement, ends the descent.
        """
        known = np.where(np.isnan(scores), np.inf, scores)
        island.descent.learn(known)
        if known.min() < island.score:
            island.score, island.end = float(known.min()), canonical[int(known.argmin())]
        if island.score < 0.0 or island.descent.ended:
            worth_it = island.score < 0.0 or island.score < island.known - _BETTER
            self._in_vain[island.claim] = 0 if worth_it else self._in_vain[island.claim] + 1
            self._archives[island.claim].take(island.end)
            self._islands.remove(island)

    def _descending(self, left: int) -> list[Point]:
        """Return at most ``left`` points: first points of running descents, then points of new descents."""
        proposed: list[Point] = []
        if self._explored < self._first:
            return proposed
        under_way = iter(list(self._islands))
        while left > 0 and (island := next(under_way, None) or self._begin()) is not None:
            points = island.descent.propose(left)
            if len(points):
                proposed.append(points)
                self._parts.append((island, len(points)))
                left -= len(points)
        return proposed

    def _begin(self) -> _Island | None:
        """Begin a descent for the next claim that has a free place, and return the descent.

        Return None if no claim has a free place.
        """
        for _ in range(self._claims):
            claim = self._next_claim
            self._next_claim = (claim + 1) % self._claims
            archive = self._archives[claim]
            start = None if archive.flat else archive.worst_free
            if start is not None:
                archive.take(start)
                low, high = self._bounds(start)
                rng = generator(self._seed, Branch.SEARCH, 2, self._begun)
                self._begun += 1
                island = _Island(
                    claim, Descent(low, high, start, _STEP, rng), start, float(archive.scores[0])
                )
                self._islands.append(island)
                return island
        return None

    def _bounds(self, start: Point) -> tuple[Point, Point]:
        """Return the bounds of a descent from ``start``, which fix alternatives and unused coordinates."""
        low, high = np.zeros_like(start), np.ones_like(start)
        for number, column in enumerate(self._cube.columns):
            interval = int(column.interval_of(start[[number]])[0])
            low[number], high[number] = column.edges[interval], column.edges[interval + 1]
            if column.flat:
                low[number] = high[number] = start[number]
            # The upper edge belongs to the next interval, in which the scenario may change abruptly.
            elif interval < len(column.edges) - 2:
                high[number] = np.nextafter(high[number], 0.0)
        unused = ~self._cube.used(start[None])[0]
        low[unused] = high[unused] = start[unused]
        return low, high
