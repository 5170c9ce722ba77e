r"""Rare violations by multilevel splitting: the way there in steps, each of which is not rare.

With levels l_1 > l_2 > ... > l_m = 0 of the margin,

    P(margin < 0) = P(margin < l_1) P(margin < l_2 | margin < l_1) ... ,

and each factor is estimated by N particles that live below the level before: those that are below the next
one survive, are drawn from with replacement, and are moved by Metropolis steps that keep the distribution
(Kahn and Harris, 1951; Au and Beck, 2001; Cerou, Del Moral, Furon and Guyader, 2012).  The moves are made
in standard normal space: z' = sqrt(1 - b^2) z + b x with x standard normal, refused above the level; the
cube's point is the normal distribution function of z.

A pilot run fixes levels and step lengths; then R replications, independent of it and of each other, each
give an estimate whose expectation is the probability, however badly the moves mix, since nothing in them
adapts.  The lower end of the interval is Student's.  No upper end can come from the replications: a region
that none of them reached leaves no sign in their spread.  So the upper end comes from the plain draws
alone, with which every replication begins, by Clopper and Pearson.  It is exact, and as wide as so few draws
make it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from safety_harness.base.proportions import upper_bound
from safety_harness.base.seeds import Branch, generator
from safety_harness.extensions.assurance.statistics.binomial import chance_of_each
from safety_harness.extensions.assurance.statistics.sample import Floats, refusal

Margins = Callable[[Floats], Floats]
"""Points (n, d) of the unit cube -> margins (n,), negative where the claim is violated; never NaN."""

LARGEST_SHAPE = 0.7  # of the weights' tail
_MOST_OF_SUM = 0.5
_BELOW_ONE = math.nextafter(1.0, 0.0)
_MOST_LEVELS = 60


@dataclass(frozen=True, kw_only=True)
class Splitting:
    """How it is done: ``particles`` N, ``steps`` of moving on each level, ``replications`` R.

    ``survivors`` is the share that each level of the pilot lets through.
    """

    particles: int = 500
    steps: int = 10
    replications: int = 20
    survivors: float = 0.25

    def __post_init__(self) -> None:
        if min(self.particles, self.steps) < 1 or self.replications < 2 or not 0.0 < self.survivors < 1.0:
            expected = "particles, steps, at least two replications, and a share of survivors"
            got = f"{self.particles} particles, {self.steps} steps, {self.replications} replications"
            raise refusal("splitting", expected, got)


@dataclass(frozen=True, kw_only=True)
class RareEstimate:
    """The probability of a violation, of the regions that the method reached.

    ``low`` is approximate; docs/statistics.md says how often it held on problems with known answers.
    ``high`` is exact: it comes from ``plain_draws`` alone, of which ``plain_violations`` violate the claim.

    ``replicates`` are the replications' estimates, of which ``reached`` are above 0.  ``levels`` are the
    margins of the steps (SI), and ``evaluations`` counts the judged points.  ``model_only``: the margins came
    from a simplified world.  ``pareto_shape`` is that of importance sampling's weights, None for splitting.
    ``still_found``: the last restart of importance sampling met a region that the others had missed.
    """

    value: float
    low: float
    high: float
    confidence: float
    replicates: tuple[float, ...]
    reached: int
    levels: tuple[float, ...]
    evaluations: int
    model_only: bool
    plain_draws: int
    plain_violations: int
    pareto_shape: float | None = None
    still_found: bool = False

    @property
    def no_estimate(self) -> str:
        """Return why the replications' estimate is not to be believed; empty if nothing speaks against it."""
        if self.reached < len(self.replicates):
            return f"{self.reached} of {len(self.replicates)} replications found a violation"
        if max(self.replicates) >= _MOST_OF_SUM * sum(self.replicates):
            return "one replication makes up half of the sum: they disagree too much"
        if self.still_found:
            return "more regions of violations turn up with every restart: try more --pilot draws"
        if self.pareto_shape == math.inf:
            return "too few draws violate it to judge their weights: try more --runs, or --by splitting"
        if (self.pareto_shape or 0.0) > LARGEST_SHAPE:
            return "a few draws carry most of the weight: try more --pilot draws, or --by splitting"
        return ""

    @property
    def as_many_draws(self) -> float:
        """Independent draws with the standard error of these replications; NaN if they do not differ."""
        found, spread = np.mean(self.replicates), np.var(self.replicates, ddof=1)
        return float(found * (1 - found) * len(self.replicates) / spread) if spread > 0.0 else np.nan


def split(
    margins: Margins,
    dimensions: int,
    *,
    seed: int,
    how: Splitting | None = None,
    confidence: float = 0.95,
    model_only: bool = True,
) -> RareEstimate:
    """Estimate P(margin < 0) for a point drawn uniformly from the cube [0, 1)^d.

    StatisticsError for margins that are NaN, or not one for each point.
    """
    judged = JudgedMargins(margins)
    settings = how or Splitting()
    shape = (settings.particles, dimensions)
    pilot, *rngs = (generator(seed, Branch.STATISTICS, 2, r) for r in range(settings.replications + 1))
    levels, lengths = _pilot(_Particles(judged, shape, pilot), settings)
    replicates = np.array(
        [_replication(_Particles(judged, shape, rng), settings.steps, levels, lengths) for rng in rngs]
    )
    return estimate_of(replicates, levels, judged, confidence, model_only=model_only)


def estimate_of(
    replicates: Floats,
    levels: Sequence[float],
    judged: JudgedMargins,
    confidence: float,
    *,
    model_only: bool,
) -> RareEstimate:
    """Return what ``replicates`` (n,) and the plain draws of ``judged`` say together."""
    chance = chance_of_each(confidence, 2)
    return RareEstimate(
        value=min(float(replicates.mean()), 1.0),
        low=lower_end(replicates, chance),
        high=upper_bound(judged.plain_violations, judged.plain_draws, chance),
        confidence=confidence,
        replicates=tuple(float(one) for one in replicates),
        reached=int(np.count_nonzero(replicates)),
        levels=tuple(levels),
        evaluations=judged.count,
        model_only=model_only,
        plain_draws=judged.plain_draws,
        plain_violations=judged.plain_violations,
    )


class JudgedMargins:
    """Margins of points in standard normal space, checked and counted; plain draws are counted apart."""

    def __init__(self, margins: Margins) -> None:
        self._margins = margins
        self.count = self.plain_draws = self.plain_violations = 0

    def __call__(self, normal: Floats) -> Floats:
        """Points ``normal`` (n, d) -> margins (n,)."""
        found = np.asarray(self._margins(np.minimum(scipy.special.ndtr(normal), _BELOW_ONE)), np.float64)
        self.count += len(normal)
        if found.shape != (len(normal),) or np.isnan(found).any():
            got = f"{np.count_nonzero(np.isnan(found))} that are no number, of shape {found.shape}"
            raise refusal("margins", f"{len(normal)} margins", got)
        return found

    def count_plain(self, margins: Floats) -> None:
        """Count the ``margins`` (n,) of draws that are distributed as the cube's points are."""
        self.plain_draws += len(margins)
        self.plain_violations += int(np.count_nonzero(margins < 0.0))


def lower_end(replicates: Floats, chance: float) -> float:
    """Return Student's lower end for the mean of ``replicates`` (n,); 0 where all are equal."""
    n, mean = len(replicates), float(replicates.mean())
    if np.all(replicates == replicates[0]):
        return 0.0
    half = float(scipy.special.stdtrit(n - 1, 1.0 - chance)) * float(replicates.std(ddof=1)) / math.sqrt(n)
    return min(max(mean - half, 0.0), 1.0)


def _pilot(particles: _Particles, how: Splitting) -> tuple[list[float], list[float]]:
    """Levels down to 0, each as the particles suggest, and the step length for each but the last.

    A plateau that no quantile gets below makes 0 the next level.
    """
    levels: list[float] = []
    lengths: list[float] = []
    length = 0.5
    while True:
        level = next_level(particles.margins, how.survivors)
        if level <= 0.0 or len(levels) == _MOST_LEVELS or (levels and level >= levels[-1]):
            levels.append(0.0)
            return levels, lengths
        levels.append(level)
        particles.resample(level)
        for _ in range(how.steps):
            moved = particles.move(level, length)
            length = float(np.clip(length * math.exp(moved - 0.4), 0.01, 0.99))
        lengths.append(length)


def next_level(found: Floats, survivors: float) -> float:
    """The margin below which that share of the particles is, or 0 if none is below it and above 0.

    ``found`` (n,) are the particles' margins.
    """
    level = float(np.quantile(found, survivors, method="higher"))
    if not np.any(found < level):  # the least margins are all the same: whatever is not
        level = float(np.min(found[found > level], initial=math.inf))
    return level if math.isfinite(level) else 0.0


def _replication(particles: _Particles, steps: int, levels: list[float], lengths: list[float]) -> float:
    """The product of the shares that survive each level; 0 once none does."""
    product = 1.0
    for number, level in enumerate(levels):
        product *= float((particles.margins < level).mean())
        if product == 0.0 or number == len(lengths):
            break
        particles.resample(level)
        for _ in range(steps):
            particles.move(level, lengths[number])
    return product


class _Particles:
    """Points (n, d) of standard normal space, drawn from it at first, and their margins (n,)."""

    def __init__(self, judged: JudgedMargins, shape: tuple[int, int], rng: np.random.Generator) -> None:
        self._judged, self._rng = judged, rng
        self.points: Floats = rng.standard_normal(shape)
        self.margins = judged(self.points)
        judged.count_plain(self.margins)

    def resample(self, level: float) -> None:
        """Draw them again from those below the level."""
        chosen = self._rng.choice(np.flatnonzero(self.margins < level), len(self.points))
        self.points, self.margins = self.points[chosen], self.margins[chosen]

    def move(self, level: float, length: float) -> float:
        """One Metropolis step of every particle below the level, and the share that moved.

        The points z go to sqrt(1 - b^2) z + b x, b the ``length``.
        """
        drawn = self._rng.standard_normal(self.points.shape)
        proposed = math.sqrt(1.0 - length**2) * self.points + length * drawn
        margins = self._judged(proposed)
        accepted = margins < level
        self.points = np.where(accepted[:, None], proposed, self.points)
        self.margins = np.where(accepted, margins, self.margins)
        return float(accepted.mean())
