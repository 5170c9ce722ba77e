"""Implement the searcher CMA-ES (Hansen and Ostermeier, 2001) with restarts.

The caller asks for points and tells their scores. Each searcher has its own random numbers.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.elementary import exp, length, log, product
from safety_harness.base.geometry.linear import eigen
from safety_harness.base.normals import standard_normal
from safety_harness.base.seeds import Branch, generator
from safety_harness.search.cube import Cube, Point, Points, Scores
from safety_harness.search.search import least

_FLAT = 1e-9  # a population whose scores differ by less shows no direction
_MARGIN = 0.05  # beyond a face
_PATIENCE = 10  # generations without an improvement


def _folded(points: Points) -> Points:
    """Map ``points`` (m, n) into the unit cube.

    Points beyond a margin are reflected, and points near a face are bent smoothly towards it. Therefore, this
    map places more points at a face than a plain reflection does. The package ``cma`` 4.5 uses the same map.
    """
    width = 1.0 + 2.0 * _MARGIN
    folded = width - np.abs(width - np.mod(points + _MARGIN, 2.0 * width))  # from 0 to the width
    low, high = folded < 2.0 * _MARGIN, folded > 1.0
    inside = np.where(low, folded * folded / (4.0 * _MARGIN), folded - _MARGIN)
    mirrored = width - folded
    return np.where(high, 1.0 - mirrored * mirrored / (4.0 * _MARGIN), inside)


def _unfolded(point: Point) -> Point:
    """Return the point (n,) that ``_folded`` maps to ``point`` (n,)."""
    low = 2.0 * np.sqrt(_MARGIN * point) - _MARGIN
    high = 1.0 + _MARGIN - 2.0 * np.sqrt(_MARGIN * (1.0 - point))
    return np.where(point < _MARGIN, low, np.where(point > 1.0 - _MARGIN, high, point))


class _Evolution:
    """A normal distribution in the unit cube that evolves, with the constants of Hansen (2016).

    If a point lies beyond a bound, the point is reflected at this bound.

    Args:
        mean: (n,) the first mean, n >= 1.
        step: The first standard deviation.
        rng: The generator of all draws.
        population: The number of points in a generation. The default is 4 + 3 log n.

    """

    def __init__(self, mean: Point, step: float, rng: np.random.Generator, population: int | None) -> None:
        n = len(mean)
        self._mean, self.sigma, self._rng = _unfolded(mean), step, rng
        self._count = population or 4 + int(3 * log(n))
        # The recombination weights, and the constants that follow from them, in Hansen's order.
        weights = log(0.5 * (self._count + 1)) - log(np.arange(1.0, self._count + 1.0))
        better, worse = weights[: self._count // 2], weights[self._count // 2 :]
        self._weights = better / better.sum()
        self._effective = effective = float(1.0 / (self._weights * self._weights).sum())
        self._path_share = (effective + 2.0) / (n + effective + 5.0)
        self._damping = 1.0 + 2.0 * max(0.0, np.sqrt((effective - 1.0) / (n + 1.0)) - 1.0) + self._path_share
        self._long_share = (4.0 + effective / n) / (n + 4.0 + 2.0 * effective / n)
        self._one_share = 2.0 / ((n + 1.3) * (n + 1.3) + effective)
        many = 2.0 * (effective - 2.0 + 1.0 / effective) / ((n + 2.0) * (n + 2.0) + effective)
        self._many_share = min(1.0 - self._one_share, many)
        worse_share = worse.sum() * worse.sum() / np.maximum((worse * worse).sum(), 1e-12)
        most = 1.0 + self._one_share / self._many_share, 1.0 + 2.0 * worse_share / (effective + 2.0)
        most = min(*most, (1.0 - self._one_share - self._many_share) / (n * self._many_share))
        self._worse = most * worse / max(-float(worse.sum()), 1e-12)  # their directions become shorter
        # The expected length of a standard normal vector.
        self._usual = float(np.sqrt(n)) * (1.0 - 1.0 / (4.0 * n) + 1.0 / (21.0 * n * n))
        self._covariance, self._axes, self._roots = np.eye(n), np.eye(n), np.ones(n)
        self._path, self._long_path = np.zeros(n), np.zeros(n)
        self._generations, self._forgotten = 0, 1.0
        # The limit of generations in the package ``cma``.
        self._most = 100.0 + 150.0 * (n + 3.0) * (n + 3.0) / np.sqrt(self._count)

    def ask(self) -> list[Point]:
        """Return the points (n,) of a generation."""
        values, self._axes = eigen(self._covariance)
        self._roots = np.sqrt(np.maximum(values, 1e-20))
        draws = standard_normal(self._rng, (self._count, len(self._mean)))
        self._steps = product(draws * self._roots, self._axes.T)
        # The squared lengths of the steps in the metric of the covariance.
        self._sizes = np.maximum((draws * draws).sum(axis=1), 1e-12)
        return list(_folded(self._mean + self.sigma * self._steps))

    def learn(self, scores: NDArray[np.float64]) -> None:
        """Update the distribution with the ``scores`` of the generation.

        Lower scores are better.
        """
        order, count = np.argsort(scores, kind="stable"), len(self._weights)
        chosen = self._steps[order[:count]]
        step = product(self._weights, chosen)
        self._mean = self._mean + self.sigma * step
        a, c, single, many = self._path_share, self._long_share, self._one_share, self._many_share
        # C^(-1/2) times the step: if the steps were independent, the path would have the usual length.
        white = product(self._axes, product(self._axes.T, step) / self._roots)
        self._path = (1.0 - a) * self._path + np.sqrt(a * (2.0 - a) * self._effective) * white
        self._generations, self._forgotten = self._generations + 1, self._forgotten * (1.0 - a) * (1.0 - a)
        size, n = length(self._path), len(step)
        # A long path means that the step size should grow first; meanwhile, the covariance must not grow.
        short = size < (1.4 + 2.0 / (n + 1.0)) * self._usual * np.sqrt(1.0 - self._forgotten)
        self._long_path = (1.0 - c) * self._long_path
        if short:
            self._long_path = self._long_path + np.sqrt(c * (2.0 - c) * self._effective) * step
        # Negative weights divided by the squared length of the step keep the covariance positive definite.
        weights = np.concatenate([self._weights, self._worse * n / self._sizes[order[count:]]])
        left = (
            1.0
            - single
            - many * (1.0 + float(self._worse.sum()))
            + (0.0 if short else single * c * (2.0 - c))
        )
        ranked = product(self._steps[order].T * weights, self._steps[order])
        self._covariance = left * self._covariance + many * ranked
        self._covariance += single * np.outer(self._long_path, self._long_path)
        # The step grows by at most a factor of e in a generation.
        self.sigma *= float(exp(min(1.0, a / self._damping * (size / self._usual - 1.0))))

    @property
    def ended(self) -> bool:
        """Whether the distribution is degenerate, or has had more generations than any descent needs."""
        # A condition number of 1e14, at which the package ``cma`` ends too.
        return bool(self._generations > self._most or self._roots[-1] > 1e7 * self._roots[0])


class Descent:
    """One run of CMA-ES within bounds.

    It may propose a generation in several parts.

    Args:
        low: (d,) the lower bounds.
        high: (d,) the upper bounds. If both bounds are equal, the coordinate is fixed.
        start: (d,) the first mean.
        step: The first standard deviation, as a fraction of the distance between the bounds.
        rng: The generator of all draws.
        population: The number of points in a generation. The default is 4 + 3 log n.

    """

    def __init__(
        self,
        low: Point,
        high: Point,
        start: Point,
        step: float,
        rng: np.random.Generator,
        population: int | None = None,
    ) -> None:
        self._low, self._size = low, high - low
        self._free = np.flatnonzero(self._size > 0.0)
        self._start = start.copy()
        self.size = len(self._free)
        mean = (start - low)[self._free] / self._size[self._free]
        mean = mean if self.size else np.full(1, 0.5)
        self._evolution = _Evolution(np.clip(mean, 0.0, 1.0), step, rng, population)
        self._population: list[Point] = []
        self._scores: list[float] = []
        self._handed_out = 0
        self.best = np.inf
        self.since_better = 0  # generations
        self.flat = False

    def propose(self, count: int) -> Points:
        """Return the next m points (m, d) of this generation.

        The number m is at most ``count`` and may be 0.
        """
        if not self._population:
            self._population, self._scores, self._handed_out = self._evolution.ask(), [], 0
        points = self._population[self._handed_out : self._handed_out + count]
        self._handed_out += len(points)
        proposed = np.tile(self._start, (len(points), 1))
        for row, point in zip(proposed, points, strict=True):
            clipped = np.clip(point, 0.0, 1.0)[: self.size]
            row[self._free] = self._low[self._free] + clipped * self._size[self._free]
        return np.clip(proposed, 0.0, 1.0)

    def learn(self, scores: NDArray[np.float64]) -> None:
        """Learn the ``scores`` (m,) of the last proposed points.

        If a point has no score, its value is +inf.
        """
        self._scores += scores.tolist()
        if len(self._scores) < len(self._population):
            return
        all_scores = np.array(self._scores)
        finite = all_scores[np.isfinite(all_scores)]
        worst = finite.max() if len(finite) else 0.0
        self.flat = len(finite) == 0 or worst - finite.min() < _FLAT
        lowest = finite.min() if len(finite) else np.inf
        self.since_better = 0 if lowest < self.best - 1e-3 else self.since_better + 1
        self.best = min(self.best, lowest)
        # A point without a score is worse than all others, but not infinitely worse: only ranks count.
        self._evolution.learn(np.where(np.isfinite(all_scores), all_scores, worst + 1.0))
        self._population = []

    @property
    def ended(self) -> bool:
        """Whether the descent has stagnated, which can only be True between two generations."""
        stuck = self.flat or self.since_better >= _PATIENCE or self._evolution.sigma < 1e-3
        return not self._population and (stuck or self._evolution.ended)


class CmaEs:
    """A CMA-ES searcher that minimises each point's least score over all claims.

    The searcher moves towards the points where a claim is violated the most. When a descent stagnates, the
    next one starts at a random point with twice the population. Alternatives are treated like all other
    coordinates.
    """

    name = "cma-es"

    def __init__(self, cube: Cube, *, claims: int, seed: int) -> None:
        self._dimension, self._seed, self._restarts = cube.dimension, seed, 0
        self._descent = self._begin()

    def _begin(self) -> Descent:
        """Return the next descent, which searches the whole cube."""
        rng = generator(self._seed, Branch.SEARCH, self._restarts)
        low, high = np.zeros(self._dimension), np.ones(self._dimension)
        # Twice the population at each restart (IPOP-CMA-ES), but at most 32 times.
        population = (4 + int(3 * log(self._dimension))) * 2 ** min(self._restarts, 5)
        return Descent(low, high, rng.random(self._dimension), 0.3, rng, max(population, 4))

    def propose(self, count: int) -> Points:
        """Return at most ``count`` points.

        The points are the rest of a generation or the beginning of the next generation.
        """
        if self._descent.ended:
            self._restarts += 1
            self._descent = self._begin()
        return self._descent.propose(count)

    def learn(self, points: Points, scores: Scores, cells: Sequence[Hashable]) -> None:
        """Let the descent learn the least score of each point."""
        self._descent.learn(least(scores))
