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
adapts.  The estimates are skewed: a product of shares is nearly lognormal, so that the upper end of
Student's t is too low too often.  So it is that of a lognormal's mean, by its generalised pivot

    log mean  =  m - Z sqrt(V / R) + V / 2,   V = (R - 1) s^2 / C,

with m and s^2 the mean and variance of the estimates' logarithms, Z standard normal and C chi-squared with
R - 1 degrees of freedom (Krishnamoorthy and Mathew, 2003), by integration over C; the lower end is
Student's.  A region that hardly any replication finds makes most estimates too low and few much too high.  So
there is an upper end below 1 only where every replication found a violation, and none of them makes up half
of the sum.  Of a region that none found nothing can be said, nor of how sure replications are that all say
the same.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from safety_harness.seeds import Branch, generator
from safety_harness.statistics.binomial import chance_of_each
from safety_harness.statistics.sample import Floats, refusal

Margins = Callable[[Floats], Floats]
"""Points (n, d) of the unit cube -> margins (n,), negative where the claim is violated; never NaN."""

_BELOW_ONE = math.nextafter(1.0, 0.0)
_MOST_LEVELS = 60
_MOST_OF_SUM = 0.5
_NODES, _BEYOND = 4_000, 1e-30  # of the integral over C, and the chance that is left out at either end


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
    """The probability of a violation with an interval whose ``confidence`` is approximate.

    How often it held on problems with known answers is in docs/statistics.md.

    ``replicates`` are the replications' estimates, of which ``reached`` are above 0; ``levels`` the margins
    of the steps (SI), ``evaluations`` how many points were judged.  ``model_only``: the margins came from a
    simplified world.  ``pareto_shape``: of the weights of importance sampling, None of splitting.
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
    pareto_shape: float | None = None

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
    return estimate_of(replicates, levels, judged.count, confidence, model_only=model_only)


def estimate_of(
    replicates: Floats,
    levels: Sequence[float],
    evaluations: int,
    confidence: float,
    *,
    model_only: bool,
) -> RareEstimate:
    """What ``replicates`` (n,) say together."""
    low, high = interval_of(replicates, chance_of_each(confidence, 2))
    return RareEstimate(
        value=min(float(replicates.mean()), 1.0),
        low=low,
        high=high,
        confidence=confidence,
        replicates=tuple(float(one) for one in replicates),
        reached=int(np.count_nonzero(replicates)),
        levels=tuple(levels),
        evaluations=evaluations,
        model_only=model_only,
    )


class JudgedMargins:
    """Margins of points in standard normal space, checked and counted."""

    def __init__(self, margins: Margins) -> None:
        self._margins = margins
        self.count = 0

    def __call__(self, normal: Floats) -> Floats:
        """Points ``normal`` (n, d) -> margins (n,)."""
        found = np.asarray(self._margins(np.minimum(scipy.special.ndtr(normal), _BELOW_ONE)), np.float64)
        self.count += len(normal)
        if found.shape != (len(normal),) or np.isnan(found).any():
            got = f"{np.count_nonzero(np.isnan(found))} that are no number, of shape {found.shape}"
            raise refusal("margins", f"{len(normal)} margins", got)
        return found


def interval_of(replicates: Floats, chance: float) -> tuple[float, float]:
    """Ends for the mean of ``replicates`` (n,), each wrong with about this chance, within [0, 1].

    The upper end is 1 where they do not agree well enough; from 0 to 1 where none differs: then there is no
    spread to judge by.
    """
    n, mean = len(replicates), float(replicates.mean())
    if np.all(replicates == replicates[0]):
        return 0.0, 1.0
    half = float(scipy.special.stdtrit(n - 1, 1.0 - chance)) * float(replicates.std(ddof=1)) / math.sqrt(n)
    low = min(max(mean - half, 0.0), 1.0)
    if not replicates.all() or float(replicates.max()) >= _MOST_OF_SUM * n * mean:
        return low, 1.0
    logarithms = np.log(replicates)
    return low, math.exp(_largest_pivot(float(logarithms.mean()), float(logarithms.var(ddof=1)), n, chance))


def _largest_pivot(mean: float, variance: float, n: int, chance: float) -> float:
    """The value that log mean, as a pivot, exceeds with this chance; 0 at most.

    P(log mean > x) = E over C of Phi((m + V / 2 - x) / sqrt(V / R)), by the trapezoidal rule over log C.
    """
    of_c = scipy.stats.chi2(n - 1)
    logs = np.linspace(math.log(of_c.ppf(_BEYOND)), math.log(of_c.isf(_BEYOND)), _NODES)
    weights = np.exp(of_c.logpdf(np.exp(logs)) + logs)
    of_v = (n - 1) * variance / np.exp(logs)

    def excess(x: float) -> float:
        beyond = scipy.special.ndtr((mean + of_v / 2.0 - x) / np.sqrt(of_v / n))
        return float(weights @ beyond / weights.sum()) - chance

    return 0.0 if excess(0.0) >= 0.0 else float(scipy.optimize.brentq(excess, mean, 0.0, xtol=1e-12))


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
