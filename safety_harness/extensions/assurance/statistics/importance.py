r"""Rare violations by importance sampling: draws from where violations are, each weighted back.

With phi the standard normal density, of whose space the cube is the image, and q any other,

    P(margin < 0) = E_q[ 1{margin < 0} w ],   w = phi / q,   q = a phi + (1 - a) sum p_k N(mu_k, diag s_k^2).

A pilot fits the mixture in steps, each to the draws with the least margins of the step before, by their
weights (cross-entropy method: Rubinstein and Kroese, 2004; for mixtures by expectation maximisation: Cappe,
Douc, Guillin, Marin and Robert, 2008).  No s_k is below 1: where a direction does not matter, draws stay as
wide as they were, and weights do not run away.  A share a of plain draws keeps w at most 1/a (Hesterberg,
1995).  Then R replications, each of draws of its own, give unbiased estimates.

A pilot sees the regions that its margins lead to.  So it is followed by restarts: each is a pilot to which a
point counts as far away where the mixture already draws more often than phi does.  What a restart finds joins
the mixture.  The search ends with the first restart that finds no violation; ``still_found`` says that the
last one allowed found another.

Where few draws carry most of the weight, as in many dimensions, replications agree on far too little.  A
generalised Pareto distribution fitted to the largest weights of violations (Zhang and Stephens, 2009) shows
it: above a shape of 0.7 (Vehtari, Simpson, Gelman, Yao and Gabry, 2024) the estimate is not to be believed.
The weights say nothing of a region that no draw reached.  So the upper end comes from plain draws, as
splitting's does: those of the first pilot's first step, and those among the replications' draws.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from safety_harness.base.seeds import Branch, generator
from safety_harness.extensions.assurance.statistics.rare import (
    JudgedMargins,
    Margins,
    RareEstimate,
    estimate_of,
    next_level,
)
from safety_harness.extensions.assurance.statistics.sample import Floats, refusal

FEWEST_WEIGHTS = 25  # of which a tail is to be told
_COMPONENTS, _ROUNDS, _MOST_LEVELS, _MOST_RESTARTS = 3, 20, 30, 16
_MORE_LEVELS = 6  # of a restart than of the pilot, before it gives up
_LEAST_SHARE = 0.05  # of a component, or what it stands for is hardly drawn
_LARGEST_EXPONENT = 700.0


@dataclass(frozen=True, kw_only=True)
class Importance:
    """How it is done: ``pilot`` draws on each level, then ``runs`` in ``replications`` equal parts.

    ``best`` is the share of a level's draws that the next is fitted to, ``plain`` that of plain draws.
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
    """Estimate P(margin < 0) for a point drawn uniformly from the cube [0, 1)^d.

    StatisticsError for margins that are NaN, or not one for each point.
    """
    judged, settings = JudgedMargins(margins), how or Importance()
    pilot, rng = (generator(seed, Branch.STATISTICS, 4, part) for part in range(2))
    proposal, levels, still_found = _explored(judged, dimensions, settings, pilot)
    each = settings.runs // settings.replications
    points, weights, plain = proposal.draw(each * settings.replications, settings.plain, rng)
    drawn = judged(points)
    judged.count_plain(drawn[plain])
    found = weights * (drawn < 0.0)
    replicates = found.reshape(settings.replications, each).mean(axis=1)
    estimate = estimate_of(replicates, levels, judged, confidence, model_only=model_only)
    return replace(estimate, pareto_shape=pareto_shape(found[found > 0.0]), still_found=still_found)


@dataclass(frozen=True, eq=False)
class _Mixture:
    """Normal components: ``shares`` (k,), ``means`` and ``deviations`` (k, d)."""

    shares: Floats
    means: Floats
    deviations: Floats

    def draw(
        self, count: int, plain: float, rng: np.random.Generator
    ) -> tuple[Floats, Floats, NDArray[np.bool_]]:
        """Return points (n, d) of normal space, their weights (n,), and which of them are plain (n,).

        Each is plain with the chance ``plain``, whatever the others are.
        """
        chosen = rng.choice(len(self.shares), count, p=self.shares)
        points: Floats = rng.standard_normal((count, self.means.shape[1]))
        fitted = rng.random(count) >= plain
        moved = self.means[chosen] + self.deviations[chosen] * points
        points = np.where(fitted[:, None], moved, points)
        over = np.exp(np.minimum(self.log_ratio(points), _LARGEST_EXPONENT))
        return points, 1.0 / (plain + (1.0 - plain) * over), ~fitted

    def log_ratio(self, points: Floats) -> Floats:
        """Return how much likelier than under phi the mixture draws ``points`` (n, d), as logarithms (n,)."""
        ratio: Floats = logsumexp(self.log_densities(points), axis=1) + 0.5 * (points**2).sum(axis=1)
        return ratio

    def log_densities(self, points: Floats) -> Floats:
        """(n, k) of each component with its share, but for the constant that phi has too."""
        far = (points[:, None] - self.means) / self.deviations
        logs: Floats = np.log(self.shares) - np.log(self.deviations).sum(axis=1) - 0.5 * (far**2).sum(axis=2)
        return logs


def _explored(
    judged: JudgedMargins, dimensions: int, how: Importance, rng: np.random.Generator
) -> tuple[_Mixture, list[float], bool]:
    """Return the mixture of all regions, the pilot's levels, and whether the last restart found more."""
    mixture, levels = _pilot(judged, dimensions, how, rng)
    regions = [mixture]
    found = bool(levels) and levels[-1] == 0.0
    while found and len(regions) <= _MOST_RESTARTS:
        another, way = _pilot(judged, dimensions, how, rng, mixture, len(levels) + _MORE_LEVELS)
        found = way[-1] == 0.0
        if found:
            regions.append(another)
            mixture = _balanced(judged, regions, how, rng)
    return mixture, levels, found and len(regions) > 1


def _balanced(
    judged: JudgedMargins, regions: Sequence[_Mixture], how: Importance, rng: np.random.Generator
) -> _Mixture:
    """Return the components of all ``regions``, each with its share of the violations that they draw."""
    means, deviations = (
        np.vstack([getattr(region, name) for region in regions]) for name in ("means", "deviations")
    )
    equal = _Mixture(np.full(len(means), 1.0 / len(means)), means, deviations)
    points, weights, _ = equal.draw(how.pilot, how.plain, rng)
    weights = weights * (judged(points) < 0.0)
    if not weights.any():
        return equal
    logs = equal.log_densities(points)
    shares = (weights / weights.sum()) @ np.exp(logs - logsumexp(logs, axis=1, keepdims=True))
    return replace(equal, shares=_at_least(shares))


def _at_least(shares: Floats) -> Floats:
    """Return ``shares`` (k,) that sum to 1, none of them far below the others."""
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
    """Return the mixture fitted to violations, or to what came nearest, and the levels on the way.

    Points that ``known`` draws more often than phi count as far away.
    """
    mixture = _Mixture(np.ones(1), np.zeros((1, dimensions)), np.ones((1, dimensions)))
    levels: list[float] = []
    while len(levels) < most_levels:
        points, weights, _ = mixture.draw(how.pilot, how.plain, rng)
        margins = judged(points)
        if known is not None:
            margins = np.where(known.log_ratio(points) > 0.0, np.inf, margins)
        elif not levels:  # as many as declared, whatever they say
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
    """By expectation maximisation, from means that are drawn far from each other; ``weights`` sum to 1."""
    means = points[rng.choice(len(points), 1, p=weights)]
    for _ in range(_COMPONENTS - 1):
        apart = ((points[:, None] - means) ** 2).sum(axis=2).min(axis=1) * weights
        if not apart.sum() > 0.0:
            break
        means = np.vstack([means, points[rng.choice(len(points), 1, p=apart / apart.sum())]])
    mixture = _Mixture(np.full(len(means), 1.0 / len(means)), means, np.ones_like(means))
    for _ in range(_ROUNDS):
        logs = mixture.log_densities(points)
        belongs = weights[:, None] * np.exp(logs - logsumexp(logs, axis=1, keepdims=True))
        shares = belongs.sum(axis=0) + 1e-12
        means = belongs.T @ points / shares[:, None]
        squares = np.einsum("nk,nkd->kd", belongs, (points[:, None] - means) ** 2) / shares[:, None]
        mixture = _Mixture(shares / shares.sum(), means, np.sqrt(np.maximum(squares, 1.0)))
    return replace(mixture, shares=_at_least(mixture.shares))


def pareto_shape(weights: Floats) -> float:
    """The shape k of a generalised Pareto distribution of the largest ``weights`` (n,); infinite for too few.

    Of the min(n / 5, 3 sqrt(n)) largest, less the next one, by the estimator of Zhang and Stephens (2009).
    """
    if len(weights) < FEWEST_WEIGHTS:
        return math.inf
    rising = np.sort(weights)
    count = int(min(0.2 * len(rising), 3.0 * math.sqrt(len(rising))))
    over = rising[-count:] - rising[-count - 1]
    over = over[over > 0.0]
    if len(over) == 0:  # all alike
        return 0.0
    n, grid = len(over), 30 + int(math.sqrt(len(over)))
    quarter = over[int(n / 4 + 0.5) - 1]
    theta = 1.0 / over[-1] + (1.0 - np.sqrt(grid / (np.arange(1, grid + 1) - 0.5))) / (3.0 * quarter)
    shapes = np.log1p(-theta[:, None] * over).mean(axis=1)
    likelihood = n * (np.log(-theta / shapes) - shapes - 1.0)
    chances = np.exp(likelihood - logsumexp(likelihood))
    return float(np.log1p(-float(theta @ chances) * over).mean())
