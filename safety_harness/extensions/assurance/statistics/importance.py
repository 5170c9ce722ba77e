"""Estimate rare violations by importance sampling, which draws with weights from the regions of violations.

The unit cube of a space is mapped to R^d, where its points have the standard normal density phi. For any
other density q, whose draws have the weights w:

    P(margin < 0) = E_q[ 1{margin < 0} w ],   w = phi / q,   q = a phi + (1 - a) sum p_k N(mu_k, diag s_k^2).

A pilot fits this mixture in steps. Each step selects the draws of the previous step that have the least
margins, and fits the mixture to these weighted draws. This method is the cross-entropy method (Rubinstein and
Kroese, 2004). Expectation maximisation fits each mixture (Cappe, Douc, Guillin, Marin and Robert, 2008).

No s_k is below 1. Thus draws stay as wide as before in a direction that has no effect on the margin, and
weights stay small. A fraction a of the draws are plain draws from phi, so that w is at most 1/a (Hesterberg,
1995). Then R replications, each with its own draws, give unbiased estimates.

A pilot sees only the regions to which its margins lead. If a pilot ends among violations, the method makes
restarts. A restart is another pilot. In a restart, a point is treated as far from violations if the mixture
already draws it more often than phi does. If a restart finds violations, its region is added to the mixture.
The search ends with the first restart that finds no violation. If even the last allowed restart finds
violations, ``still_found`` of the result is true.

In many dimensions, a few draws may carry most of the weight. In this case, the replications agree on a value
that is far too low. To notice this, the method fits a generalised Pareto distribution to the largest weights
of violations (Zhang and Stephens, 2009). If the shape of this distribution exceeds 0.7, the estimate is not
reliable (Vehtari, Simpson, Gelman, Yao and Gabry, 2024).

The weights cannot show that there is a region without draws. Therefore, as in splitting, only plain draws
give the upper end. The plain draws are the draws in the first step of the first pilot, and the plain draws of
the replications.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.elementary import exp, log, log1p, log_sum_exp, product
from safety_harness.base.normals import standard_normal
from safety_harness.base.seeds import Branch, generator
from safety_harness.extensions.assurance.statistics.rare import (
    JudgedMargins,
    Margins,
    RareEstimate,
    estimate_of,
    next_level,
)
from safety_harness.extensions.assurance.statistics.sample import Floats, refusal

FEWEST_WEIGHTS = 25  # the fewest weights whose tail can be fitted
_COMPONENTS, _ROUNDS, _MOST_LEVELS, _MOST_RESTARTS = 3, 20, 30, 16
_MORE_LEVELS = 6  # steps that a restart may take beyond the pilot's number
_LEAST_SHARE = 0.05  # of a component, so that its region has draws
_LARGEST_EXPONENT = 700.0  # exp overflows above 709; such a weight is practically 0


@dataclass(frozen=True, kw_only=True)
class Importance:
    """The settings of importance sampling.

    Each step of the pilot has ``pilot`` draws. After the pilot, ``runs`` draws are made in ``replications``
    equal parts. A step fits the mixture to the fraction ``best`` of the previous draws. ``plain`` is the
    fraction of plain draws.

    Raises:
        StatisticsError: There are fewer draws than replications, fewer than two replications, no pilot draw,
            or a fraction that is not between 0 and 1.

    """

    pilot: int = 500
    runs: int = 5_000
    replications: int = 20
    best: float = 0.2
    plain: float = 0.1

    def __post_init__(self) -> None:
        counts = self.pilot >= 1 and 2 <= self.replications <= self.runs
        if not counts or not 0.0 < self.best < 1.0 or not 0.0 < self.plain < 1.0:
            expected = "draws, at least two replications of one each, and shares between 0 and 1"
            got = f"{self.runs} draws in {self.replications} replications, {self.pilot} in a pilot's step"
            raise refusal("importance sampling", expected, got)


def weigh(
    margins: Margins,
    dimensions: int,
    *,
    seed: int,
    how: Importance | None = None,
    confidence: float = 0.95,
    model_only: bool = True,
) -> RareEstimate:
    """Estimate P(margin < 0) for a uniform point of the cube [0, 1)^d, by importance sampling.

    Args:
        margins: A function from points (n, d) of the cube to margins (n,), which may be random.
        dimensions: The number d.
        seed: The seed from which all draws derive.
        how: The settings. The default is ``Importance()``.
        confidence: The confidence of the interval, between 0 and 1.
        model_only: Whether the margins come from a simplified world.

    Raises:
        StatisticsError: A margin is NaN, or the function does not return one margin for each point.

    """
    judged, settings = JudgedMargins(margins), how or Importance()
    pilot, rng = (generator(seed, Branch.STATISTICS, 4, part) for part in range(2))
    proposal, levels, still_found = _explored(judged, dimensions, settings, pilot)
    each = settings.runs // settings.replications
    points, weights, plain = proposal.draw(each * settings.replications, settings.plain, rng)
    drawn = judged(points)
    judged.count_plain(drawn[plain])
    terms = weights * (drawn < 0.0)
    replicates = terms.reshape(settings.replications, each).mean(axis=1)
    estimate = estimate_of(replicates, levels, judged, confidence, model_only=model_only)
    return replace(estimate, pareto_shape=pareto_shape(terms[terms > 0.0]), still_found=still_found)


@dataclass(frozen=True, eq=False)
class _Mixture:
    """A mixture of k normal components: ``shares`` (k,), ``means`` (k, d) and ``deviations`` (k, d)."""

    shares: Floats
    means: Floats
    deviations: Floats

    def draw(
        self, count: int, plain: float, rng: np.random.Generator
    ) -> tuple[Floats, Floats, NDArray[np.bool_]]:
        """Return points (n, d) of normal space, their weights (n,), and flags (n,) that mark plain points.

        Each point is plain with probability ``plain``, independently of all other points.
        """
        chosen = rng.choice(len(self.shares), count, p=self.shares)
        points: Floats = standard_normal(rng, (count, self.means.shape[1]))
        fitted = rng.random(count) >= plain
        moved = self.means[chosen] + self.deviations[chosen] * points
        points = np.where(fitted[:, None], moved, points)
        ratio = exp(np.minimum(self.log_ratio(points), _LARGEST_EXPONENT))
        # phi over the density of the draws.  It is at most 1 / plain, whatever the mixture.
        return points, 1.0 / (plain + (1.0 - plain) * ratio), ~fitted

    def log_ratio(self, points: Floats) -> Floats:
        """Return the log ratio of the mixture's density to phi at ``points`` (n, d), shape (n,)."""
        ratio: Floats = log_sum_exp(self.log_densities(points), axis=1) + 0.5 * (points * points).sum(axis=1)
        return ratio

    def log_densities(self, points: Floats) -> Floats:
        """Return the log densities (n, k) of the weighted components at ``points`` (n, d).

        The function omits the constant -d/2 log(2 pi), which phi contains too.
        """
        far = (points[:, None] - self.means) / self.deviations
        logs: Floats = log(self.shares) - log(self.deviations).sum(axis=1) - 0.5 * (far * far).sum(axis=2)
        return logs


def _explored(
    judged: JudgedMargins, dimensions: int, how: Importance, rng: np.random.Generator
) -> tuple[_Mixture, list[float], bool]:
    """Return the mixture of all regions and the levels of the pilot.

    Also return whether the last restart found violations.
    """
    mixture, levels = _pilot(judged, dimensions, how, rng)
    regions = [mixture]
    violates = bool(levels) and levels[-1] == 0.0
    # Look for regions of violations that the mixture does not sample, until a restart finds none.
    while violates and len(regions) <= _MOST_RESTARTS:
        region, restart_levels = _pilot(judged, dimensions, how, rng, mixture, len(levels) + _MORE_LEVELS)
        violates = restart_levels[-1] == 0.0
        if violates:
            regions.append(region)
            mixture = _balanced(judged, regions, how, rng)
    return mixture, levels, violates and len(regions) > 1


def _balanced(
    judged: JudgedMargins, regions: Sequence[_Mixture], how: Importance, rng: np.random.Generator
) -> _Mixture:
    """Return a mixture that has the components of all ``regions``.

    The weight of a component is its estimated fraction of the violation probability.
    """
    means, deviations = (
        np.vstack([getattr(region, name) for region in regions]) for name in ("means", "deviations")
    )
    equal = _Mixture(np.full(len(means), 1.0 / len(means)), means, deviations)
    # Sample with equal shares once, and weight each component by the violations that it explains.
    points, weights, _ = equal.draw(how.pilot, how.plain, rng)
    weights = weights * (judged(points) < 0.0)
    if not weights.any():
        return equal
    logs = equal.log_densities(points)
    shares = product(weights / weights.sum(), exp(logs - log_sum_exp(logs, axis=1, keepdims=True)))
    return replace(equal, shares=_at_least(shares))


def _at_least(shares: Floats) -> Floats:
    """Increase each small value of ``shares`` (k,) towards ``_LEAST_SHARE``, and scale the sum to 1."""
    raised = np.maximum(shares, min(_LEAST_SHARE, 0.25 / len(shares)))
    balanced: Floats = raised / raised.sum()
    return balanced


def _pilot(
    judged: JudgedMargins,
    dimensions: int,
    how: Importance,
    rng: np.random.Generator,
    known: _Mixture | None = None,
    most_levels: int = _MOST_LEVELS,
) -> tuple[_Mixture, list[float]]:
    """Return a mixture and the levels of the steps.

    The mixture is fitted to the violations. If no point violates the claim, the mixture is fitted to the
    points that came nearest to a violation. A point is treated as far away if ``known`` draws it more often
    than phi does.
    """
    mixture = _Mixture(np.ones(1), np.zeros((1, dimensions)), np.ones((1, dimensions)))
    levels: list[float] = []
    while len(levels) < most_levels:
        points, weights, _ = mixture.draw(how.pilot, how.plain, rng)
        margins = judged(points)
        if known is not None:
            margins = np.where(known.log_ratio(points) > 0.0, np.inf, margins)
        elif not levels:  # the first step's draws are plain, and their number was declared
            judged.count_plain(margins)
        levels.append(max(next_level(margins, how.best), 0.0))
        best = margins < levels[-1]
        if not best.any():
            break
        mixture = _fitted(points[best], weights[best] / weights[best].sum(), rng)
        if levels[-1] == 0.0:
            break
    return mixture, levels


def _fitted(points: Floats, weights: Floats, rng: np.random.Generator) -> _Mixture:
    """Return a mixture fitted to ``points`` (n, d) by expectation maximisation.

    The weights ``weights`` (n,) sum to 1. The first means are points that lie far apart.
    """
    means = points[rng.choice(len(points), 1, p=weights)]
    for _ in range(_COMPONENTS - 1):
        # The next mean is a point drawn in proportion to its squared distance from the nearest mean
        # (k-means++).
        gaps = np.square(points[:, None] - means).sum(axis=2).min(axis=1) * weights
        if not gaps.sum() > 0.0:
            break
        means = np.vstack([means, points[rng.choice(len(points), 1, p=gaps / gaps.sum())]])
    mixture = _Mixture(np.full(len(means), 1.0 / len(means)), means, np.ones_like(means))
    for _ in range(_ROUNDS):
        logs = mixture.log_densities(points)
        belongs = weights[:, None] * exp(logs - log_sum_exp(logs, axis=1, keepdims=True))
        # The small term avoids a division by zero for a component to which no point belongs.
        shares = belongs.sum(axis=0) + 1e-12
        means = product(belongs.T, points) / shares[:, None]
        squares = (belongs[:, :, None] * np.square(points[:, None] - means)).sum(axis=0) / shares[:, None]
        # Without the least deviation 1, a component could collapse onto a single point.
        mixture = _Mixture(shares / shares.sum(), means, np.sqrt(np.maximum(squares, 1.0)))
    return replace(mixture, shares=_at_least(mixture.shares))


def pareto_shape(weights: Floats) -> float:
    """Return the shape k of a generalised Pareto distribution, fitted to the largest ``weights`` (n,).

    The estimator is Zhang and Stephens' (2009). The estimator uses the m largest weights, where m = min(n /
    5, 3 sqrt(n)). It subtracts the largest of the remaining weights from each of these m weights.

    Args:
        weights: The positive weights of violations (n,).

    Returns:
        The shape. It is infinite for fewer than ``FEWEST_WEIGHTS`` weights, and 0 if the largest weights are
        equal.

    """
    if len(weights) < FEWEST_WEIGHTS:
        return math.inf
    rising = np.sort(weights)
    count = int(min(0.2 * len(rising), 3.0 * math.sqrt(len(rising))))
    excesses = rising[-count:] - rising[-count - 1]
    excesses = excesses[excesses > 0.0]
    if len(excesses) == 0:  # all largest weights are equal
        return 0.0
    n, grid = len(excesses), 30 + int(math.sqrt(len(excesses)))
    quarter = excesses[int(n / 4 + 0.5) - 1]
    # The grid of Zhang and Stephens; the estimate averages over it, weighted by the profile likelihood.
    theta = 1.0 / excesses[-1] + (1.0 - np.sqrt(grid / (np.arange(1, grid + 1) - 0.5))) / (3.0 * quarter)
    shapes = log1p(-theta[:, None] * excesses).mean(axis=1)
    likelihood = n * (log(-theta / shapes) - shapes - 1.0)
    chances = exp(likelihood - log_sum_exp(likelihood))
    return float(log1p(-float(product(theta, chances)) * excesses).mean())
