"""CMA-ES (Hansen and Ostermeier, 2001) with restarts, from the package ``cma``, as ask and tell."""

from __future__ import annotations

import warnings
from collections.abc import Hashable, Sequence

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.elementary import log
from safety_harness.base.seeds import Branch, generator
from safety_harness.search.cube import Cube, Point, Points, Scores
from safety_harness.search.search import least

_FLAT = 1e-9  # a population with smaller differences of scores has no direction
_PATIENCE = 10  # generations without an improvement


class Descent:
    """One run of CMA-ES within bounds; it returns points until a population is complete.

    Args:
        low: (d,) the lower bounds.
        high: (d,) the upper bounds; equal bounds fix a coordinate.
        start: (d,) the first mean.
        step: The first standard deviation, as a part of the bounds' distance.
        rng: The generator of all draws.
        population: Points per generation; None: the default of ``cma``.

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
        with warnings.catch_warnings(action="ignore"):  # cma warns if matplotlib is missing
            import cma  # slow to import

        self._low, self._size = low, high - low
        self._free = np.flatnonzero(self._size > 0.0)
        self._start = start.copy()
        options: dict[str, object] = {
            "bounds": [0.0, 1.0],
            "randn": lambda *shape: rng.standard_normal(shape),
            "seed": np.nan,  # leaves numpy's global generator alone
            "verbose": -9,
            "verb_log": 0,
        }
        if population is not None:
            options["popsize"] = population
        self.size = len(self._free)
        mean = (start - low)[self._free] / self._size[self._free]
        if self.size < 2:  # cma needs two dimensions
            mean = np.concatenate([mean, np.full(2 - self.size, 0.5)])
        self._cma = cma.CMAEvolutionStrategy(np.clip(mean, 0.0, 1.0), step, options)
        self._population: list[Point] = []
        self._scores: list[float] = []
        self._handed_out = 0
        self.best = np.inf
        self.since_better = 0  # generations
        self.flat = False

    def propose(self, count: int) -> Points:
        """Return the next points (m, d) of this generation, 0 <= m <= ``count``."""
        if not self._population:
            self._population, self._scores, self._handed_out = list(self._cma.ask()), [], 0
        points = self._population[self._handed_out : self._handed_out + count]
        self._handed_out += len(points)
        proposed = np.tile(self._start, (len(points), 1))
        for row, point in zip(proposed, points, strict=True):
            clipped = np.clip(point, 0.0, 1.0)[: self.size]
            row[self._free] = self._low[self._free] + clipped * self._size[self._free]
        return np.clip(proposed, 0.0, 1.0)

    def learn(self, scores: NDArray[np.float64]) -> None:
        """Learn ``scores`` (m,) of the points proposed last; +inf for a point without a score."""
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
        self._cma.tell(self._population, np.where(np.isfinite(all_scores), all_scores, worst + 1.0).tolist())
        self._population = []

    @property
    def ended(self) -> bool:
        """Whether the descent has stagnated; only ever true between generations."""
        stuck = self.flat or self.since_better >= _PATIENCE or float(self._cma.sigma) < 1e-3
        return not self._population and (stuck or bool(self._cma.stop()))


class CmaEs:
    """CMA-ES on the least score; it restarts from a random point with twice the population on stagnation.

    It goes where a claim is violated the most, and treats alternatives like all other coordinates.
    """

    name = "cma-es"

    def __init__(self, cube: Cube, *, claims: int, seed: int) -> None:
        self._dimension, self._seed, self._restarts = cube.dimension, seed, 0
        self._descent = self._begin()

    def _begin(self) -> Descent:
        """Return the next descent, over the whole cube."""
        rng = generator(self._seed, Branch.SEARCH, self._restarts)
        low, high = np.zeros(self._dimension), np.ones(self._dimension)
        population = (4 + int(3 * log(self._dimension))) * 2 ** min(self._restarts, 5)
        return Descent(low, high, rng.random(self._dimension), 0.3, rng, max(population, 4))

    def propose(self, count: int) -> Points:
        """Return the rest of a generation, or the start of the next."""
        if self._descent.ended:
            self._restarts += 1
            self._descent = self._begin()
        return self._descent.propose(count)

    def learn(self, points: Points, scores: Scores, cells: Sequence[Hashable]) -> None:
        """Give the least score of each point to the descent."""
        self._descent.learn(least(scores))
