"""Rare violations by multilevel splitting: steps towards violations, each with a moderate probability.

The margin has levels l_1 > l_2 > ... > l_m = 0:

    P(margin < 0) = P(margin < l_1) P(margin < l_2 | margin < l_1) ... .

N particles with margins below the previous level estimate each factor. The particles below the next level
survive. From the survivors, N particles are drawn with replacement. Metropolis steps move these particles and
keep their distribution. The sources are Kahn and Harris (1951), Au and Beck (2001), and Cerou, Del Moral,
Furon and Guyader (2012).

A move in standard normal space is z' = sqrt(1 - b^2) z + b x. Here b is the step length, and x is standard
normal. A move to a margin above the level is refused. The normal distribution function maps z to a point of
the unit cube.

A pilot run fixes the levels and the step lengths. R independent replications follow, which keep these levels
and step lengths. Therefore each estimate is unbiased, even if the moves mix badly.

The lower end of the interval comes from Student's t distribution. The replications cannot give an upper end,
because their spread cannot show that there is a region without a particle. Therefore, the upper end is
computed only from plain draws, with the method of Clopper and Pearson. The plain draws are the first draws of
each replication and of the pilot. This upper end is exact, but so few draws make it wide.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from safety_harness.base.elementary import exp
from safety_harness.base.normals import standard_normal
from safety_harness.base.proportions import upper_bound
from safety_harness.base.seeds import Branch, generator
from safety_harness.base.special import beta_share, lower_tail, settled
from safety_harness.extensions.assurance.statistics.binomial import chance_of_each
from safety_harness.extensions.assurance.statistics.sample import Floats, refusal

Margins = Callable[[Floats], Floats]
"""Points (n, d) of the unit cube -> margins (n,), negative where the claim is violated; never NaN."""

LARGEST_SHAPE = 0.7  # of the weights' tail (Vehtari, Simpson, Gelman, Yao and Gabry, 2024)
_MOST_OF_SUM = 0.5  # that a single replication may contribute
_BELOW_ONE = math.nextafter(1.0, 0.0)  # the cube [0, 1) excludes 1, which ndtr gives for z above 8.3
_MOST_LEVELS = 60  # a quarter of the particles passes each level, so 60 levels reach 4^-60 = 8e-37


@dataclass(frozen=True, kw_only=True)
class Splitting:
    """The settings of splitting.

    ``particles`` (N) is the number of particles in each replication. ``steps`` is the number of moves on each
    level, and ``replications`` (R) is the number of replications. ``survivors`` is the fraction of the
    pilot's particles that pass each level.

    Raises:
        StatisticsError: There are no particles or steps, fewer than two replications, or a fraction that is
            not between 0 and 1.

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
    """The estimated probability of a violation, within the regions that the method reached.

    ``low`` is approximate. docs/results/intervals.md reports its coverage on problems with known answers.
    ``high`` is exact, because it is computed only from the number of plain draws and the number of violations
    among them.

    ``replicates`` are the estimates of the replications, and ``reached`` is the number of positive estimates.
    ``levels`` are the margins of the steps (SI). ``evaluations`` counts the judged points. ``model_only`` is
    true if the margins come from a simplified world.

    ``pareto_shape`` is the shape of the largest weights in importance sampling, and None for splitting.
    ``still_found`` is true if the last restart of importance sampling found a new region.
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
        """The reason why the estimate of the replications is not reliable, or "" if it is reliable."""
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
        """The number of plain draws that would give the same standard error.

        The number is NaN if all replications agree.
        """
        mean, spread = np.mean(self.replicates), np.var(self.replicates, ddof=1)
        return float(mean * (1 - mean) * len(self.replicates) / spread) if spread > 0.0 else np.nan


def split(
    margins: Margins,
    dimensions: int,
    *,
    seed: int,
    how: Splitting | None = None,
    confidence: float = 0.95,
    model_only: bool = True,
) -> RareEstimate:
    """Estimate P(margin < 0) for a uniform point of the cube [0, 1)^d, by splitting.

    Args:
        margins: A function from points (n, d) of the cube to margins (n,), which may be random.
        dimensions: The number d.
        seed: The seed from which all draws derive.
        how: The settings. The default is ``Splitting()``.
        confidence: The confidence of the interval, between 0 and 1.
        model_only: Whether the margins come from a simplified world.

    Raises:
        StatisticsError: A margin is NaN, or the function does not return one margin for each point.

    """
    judged = JudgedMargins(margins)
    settings = how or Splitting()
    shape = (settings.particles, dimensions)
    pilot, *rngs = (generator(seed, Branch.STATISTICS, 2, r) for r in range(settings.replications + 1))
    # The levels come from a separate pilot: fixed levels make the product of fractions unbiased.
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
    """Return the estimate from ``replicates``, with the upper end from the plain draws.

    Args:
        replicates: The estimates of the replications (n,).
        levels: The margins of the steps (SI).
        judged: The function of margins, which has counted the points and the plain draws.
        confidence: The confidence of the interval, between 0 and 1. Each end has half of the error.
        model_only: Whether the margins come from a simplified world.

    """
    chance = chance_of_each(confidence, 2)
    return RareEstimate(
        value=min(float(replicates.mean()), 1.0),
        low=lower_end(replicates, chance),
        high=upper_bound(judged.plain_violations, judged.plain_draws, chance),
        confidence=confidence,
        replicates=tuple(float(estimate) for estimate in replicates),
        reached=int(np.count_nonzero(replicates)),
        levels=tuple(levels),
        evaluations=judged.count,
        model_only=model_only,
        plain_draws=judged.plain_draws,
        plain_violations=judged.plain_violations,
    )


class JudgedMargins:
    """A function of margins at points in standard normal space.

    The function checks the margins and counts the points. The function also counts the plain draws that
    ``count_plain`` receives.
    """

    def __init__(self, margins: Margins) -> None:
        self._margins = margins
        self.count = self.plain_draws = self.plain_violations = 0

    def __call__(self, normal: Floats) -> Floats:
        """Return the margins (n,) at points ``normal`` (n, d).

        Raise StatisticsError for NaN or a wrong shape.
        """
        margins = np.asarray(self._margins(np.minimum(lower_tail(normal), _BELOW_ONE)), np.float64)
        self.count += len(normal)
        if margins.shape != (len(normal),) or np.isnan(margins).any():
            got = f"{np.count_nonzero(np.isnan(margins))} that are no number, of shape {margins.shape}"
            raise refusal("margins", f"{len(normal)} margins", got)
        return margins

    def count_plain(self, margins: Floats) -> None:
        """Count plain draws, given their ``margins`` (n,).

        Plain draws come from the distribution of the cube's points.
        """
        self.plain_draws += len(margins)
        self.plain_violations += int(np.count_nonzero(margins < 0.0))


def lower_end(replicates: Floats, chance: float) -> float:
    """Return Student's lower end for the mean of ``replicates``.

    Args:
        replicates: The estimates of the replications (n,).
        chance: The probability that the end exceeds the truth.

    Returns:
        The lower end, limited to [0, 1]. It is 0 if all estimates are equal.

    """
    n, mean = len(replicates), float(replicates.mean())
    if np.all(replicates == replicates[0]):
        return 0.0
    half = _student(n - 1, chance) * float(replicates.std(ddof=1)) / math.sqrt(n)
    return min(max(mean - half, 0.0), 1.0)


def _student(freedom: int, chance: float) -> float:
    """Return the quantile that Student's t exceeds with probability ``chance``.

    ``chance`` is below 0.5.
    """

    def rarer(t: Floats) -> Floats:
        return np.asarray(0.5 * beta_share(0.5 * freedom, 0.5, freedom / (freedom + t * t)) <= chance)

    return settled(rarer, 0.0, 1e12, 0.0)[1]


def _pilot(particles: _Particles, how: Splitting) -> tuple[list[float], list[float]]:
    """Return the descending levels, which end at 0, and the step length for each level except the last.

    Each level is a quantile of the particles' margins. If this quantile does not fall below the previous
    level, the next level is 0.
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
            # Longer steps if more than 40 % of the moves succeed, and shorter steps otherwise; 40 % is a
            # choice.
            length = float(np.clip(length * exp(moved - 0.4), 0.01, 0.99))
        lengths.append(length)


def next_level(margins: Floats, survivors: float) -> float:
    """Return the level below which a fraction ``survivors`` of the margins lies.

    Args:
        margins: The margins of the particles (n,).
        survivors: The fraction.

    Returns:
        The level. It is the second least margin if many margins equal the least margin, and 0 if all margins
        are equal.

    """
    # ``higher`` returns a margin that occurs, so the comparison below separates ties from smaller margins.
    level = float(np.quantile(margins, survivors, method="higher"))
    if not np.any(margins < level):  # many share the least margin: take the next
        level = float(np.min(margins[margins > level], initial=math.inf))
    return level if math.isfinite(level) else 0.0


def _replication(particles: _Particles, steps: int, levels: list[float], lengths: list[float]) -> float:
    """Return the product of the fractions of particles that survive each level.

    The product is 0 if no particle survives a level.
    """
    product = 1.0
    for number, level in enumerate(levels):
        # The fractions are conditional probabilities, because the particles below the last level were moved
        # there.
        product *= float((particles.margins < level).mean())
        if product == 0.0 or number == len(lengths):
            break
        particles.resample(level)
        for _ in range(steps):
            particles.move(level, lengths[number])
    return product


class _Particles:
    """Points of standard normal space, shape (n, d), and their margins, shape (n,).

    The first points are plain draws.
    """

    def __init__(self, judged: JudgedMargins, shape: tuple[int, int], rng: np.random.Generator) -> None:
        self._judged, self._rng = judged, rng
        self.points: Floats = standard_normal(rng, shape)
        self.margins = judged(self.points)
        judged.count_plain(self.margins)

    def resample(self, level: float) -> None:
        """Replace all particles by draws, with replacement, from the particles below ``level``."""
        chosen = self._rng.choice(np.flatnonzero(self.margins < level), len(self.points))
        self.points, self.margins = self.points[chosen], self.margins[chosen]

    def move(self, level: float, length: float) -> float:
        """Move each particle by a Metropolis step that stays below ``level``.

        Return the fraction of particles that moved. A point z moves to sqrt(1 - b^2) z + b x, where b is
        ``length`` and x is standard normal.
        """
        drawn = standard_normal(self._rng, self.points.shape)
        # This step keeps the standard normal distribution, so the level alone decides whether to accept the
        # move.
        proposed = math.sqrt(1.0 - length * length) * self.points + length * drawn
        margins = self._judged(proposed)
        accepted = margins < level
        self.points = np.where(accepted[:, None], proposed, self.points)
        self.margins = np.where(accepted, margins, self.margins)
        return float(accepted.mean())
