"""The default search: explore, and go down from the worst places that are not one another's neighbours.

A third of the points explore (``Explorer``); the others are shared among the claims, whose descents
(CMA-ES) begin at the worst point known of a claim, keep its alternatives, and end when they find a
violation or nothing better.  The next begins elsewhere.  Where all scores of a claim are the same there is
nowhere to go: its share explores, and that of the other claims too, the more of their last descents found
nothing worse than was known.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.seeds import Branch, generator
from safety_harness.search.cma_es import Descent
from safety_harness.search.cube import Cube, Point, Points, Scores
from safety_harness.search.sampling import Explorer

_KEPT = 256  # a claim


class Archive:
    """The points with the least scores of one claim, and which of them are far from every place taken.

    Of each claim so many are remembered, however long the search.
    Places are taken by descents that began or ended there; ``apart`` is how far others have to be.
    """

    def __init__(self, cube: Cube, apart: float) -> None:
        self._cube, self._apart = cube, apart
        self.points = np.empty((0, cube.dimension))  # canonical, by their scores
        self.scores = np.empty(0)
        self.greatest = -np.inf
        self._free = np.empty(0, bool)
        self._taken = np.empty((0, cube.dimension))

    def add(self, points: Points, scores: NDArray[np.float64]) -> None:
        """Canonical points and their ``scores`` (n,), of which those that are NaN are left out."""
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
            self._free[new] = np.all(self._cube.distances(self._taken, self.points[new]) > self._apart)

    def take(self, place: Point) -> None:
        """A descent began or ended at this canonical point."""
        self._taken = np.vstack([self._taken, place])
        self._free &= self._cube.distances(self.points, place) > self._apart

    @property
    def worst_free(self) -> Point | None:
        """(d,) the point with the least score that is far from every place taken."""
        return self.points[int(np.argmax(self._free))].copy() if self._free.any() else None

    @property
    def flat(self) -> bool:
        """Whether no score differs from another, so that none leads anywhere."""
        return len(self.scores) == 0 or bool(self.greatest - self.scores[0] < 1e-9)


_EXPLORING = 1.0 / 3.0
_APART = 0.15  # root mean square: beginnings and ends of descents on the same claim are farther apart
_STEP = 0.15
_BETTER = 0.01  # of a score


@dataclass(eq=False)
class _Island:
    """One descent: on which claim, and where it began and stands."""

    claim: int
    descent: Descent
    end: Point  # canonical, the best place so far
    known: float  # the claim's least score when it began
    score: float = np.inf


class Default:
    """See the module."""

    name = "default"

    def __init__(self, cube: Cube, *, claims: int, seed: int) -> None:
        self._cube, self._seed, self._claims = cube, seed, claims
        self._explorer = Explorer(cube, seed=seed)
        self._archives = [Archive(cube, _APART) for _ in range(claims)]
        self._islands: list[_Island] = []
        self._begun = self._explored = self._proposed = self._next_claim = 0
        self._in_vain = [0] * claims  # descents since the last that found a violation or a lesser score
        self._due = 0.0  # points of exploration
        self._parts: list[tuple[_Island | None, int]] = []

    @property
    def _first(self) -> int:
        """How many points are explored before the first descent."""
        return max(32, 4 * self._cube.dimension)

    def propose(self, count: int) -> Points:
        """Some of each: exploration, and as many descents as there is room for."""
        self._parts = []
        exploring = min(max(self._first - self._explored, 0), count)
        if exploring < count and self._proposed >= self._first:
            self._due += self._exploring * count
            exploring = min(int(self._due), count)
        found = self._descending(count - exploring)
        exploring = count - sum(map(len, found))
        if exploring:
            found.append(self._explorer.points(exploring))
            self._parts.append((None, exploring))
            self._explored += exploring
        self._due -= min(exploring, self._due)
        self._proposed += count
        return np.concatenate(found)

    @property
    def _exploring(self) -> float:
        """The part of the points that explore."""
        flat = [archive.flat for archive in self._archives]
        shares = [0.0 if f else 0.5**vain for f, vain in zip(flat, self._in_vain, strict=True)]
        descending = sum(shares) if any(flat) else self._claims
        return 1.0 - (1.0 - _EXPLORING) * descending / self._claims

    def learn(self, points: Points, scores: Scores, cells: Sequence[Hashable]) -> None:
        """Remember, and let each descent have its own."""
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
        told = np.where(np.isnan(scores), np.inf, scores)
        island.descent.learn(told)
        if told.min() < island.score:
            island.score, island.end = float(told.min()), canonical[int(told.argmin())]
        if island.score < 0.0 or island.descent.over:
            worth_it = island.score < 0.0 or island.score < island.known - _BETTER
            self._in_vain[island.claim] = 0 if worth_it else self._in_vain[island.claim] + 1
            self._archives[island.claim].take(island.end)
            self._islands.remove(island)

    def _descending(self, room: int) -> list[Point]:
        """Points of the descents under way, then of new ones while there is room."""
        found: list[Point] = []
        if self._explored < self._first:
            return found
        under_way = iter(list(self._islands))
        while room > 0 and (island := next(under_way, None) or self._begin()) is not None:
            points = island.descent.propose(room)
            if len(points):
                found.append(points)
                self._parts.append((island, len(points)))
                room -= len(points)
        return found

    def _begin(self) -> _Island | None:
        """A descent on the next claim that has a place to begin at; None if no claim has one."""
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
        """Where a descent from ``start`` may go: its alternatives stay, what is not used is fixed."""
        low, high = np.zeros_like(start), np.ones_like(start)
        for number, column in enumerate(self._cube.columns):
            interval = int(column.interval_of(start[[number]])[0])
            low[number], high[number] = column.edges[interval], column.edges[interval + 1]
            if column.flat:
                low[number] = high[number] = start[number]
            elif interval < len(column.edges) - 2:
                high[number] = np.nextafter(high[number], 0.0)
        unused = ~self._cube.used(start[None])[0]
        low[unused] = high[unused] = start[unused]
        return low, high
