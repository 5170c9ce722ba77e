"""Where a margin's variance comes from: the scenarios, or the avoider's own draws (dropout).

The design is nested: m scenarios drawn independently from the space, each run k times with other draws of
the avoider and all else the same.  Margin = mean + scenario + draw, with variances s2 (scenarios) and w2
(draws), and the question is the scenarios' share s2 / (s2 + w2): near 1 the scenario decides, near 0 chance
does.
"""

from __future__ import annotations

import math
from dataclasses import InitVar, dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import fdtri

from safety_harness.base.proportions import lower_bound, upper_bound
from safety_harness.base.seeds import Branch, generator
from safety_harness.extensions.assurance.statistics.binomial import chance_of_each
from safety_harness.extensions.assurance.statistics.paired import BOOTSTRAP_DRAWS, ends_of_t
from safety_harness.extensions.assurance.statistics.sample import (
    JUDGED,
    Declaration,
    EpisodeOutcome,
    Floats,
    Ints,
    checked_stream,
    refusal,
)

_OF_DESIGN = object()


@dataclass(frozen=True, kw_only=True, eq=False)
class NestedSample:
    """Outcomes and margins (m, k): scenarios in the order of their numbers, draws of each.

    Made by ``of_design`` only.  The declaration's ``planned`` counts scenarios.
    """

    declaration: Declaration
    outcomes: Ints
    margins: Floats
    claim: str = ""
    _made_by: InitVar[object] = None

    def __post_init__(self, _made_by: object) -> None:
        if _made_by is not _OF_DESIGN:
            raise TypeError("a NestedSample is made by NestedSample.of_design, and by nothing else")

    @classmethod
    def of_design(
        cls,
        declaration: Declaration,
        scenarios: ArrayLike,
        outcomes: ArrayLike,
        margins: ArrayLike,
        *,
        seeds: ArrayLike,
        exercised: ArrayLike,
        claim: str = "",
    ) -> NestedSample:
        """Scenarios (m,), and for each k draws: outcomes, margins, seeds of the draws, occasions (m, k).

        StatisticsError for what a stream would be refused for, or fewer than two scenarios or draws.
        """
        codes, signed, _ = checked_stream(
            declaration, scenarios, outcomes, margins, seeds, exercised, dimensions=2
        )
        if min(codes.shape) < 2:
            got = f"{codes.shape[0]} and {codes.shape[1]}"
            raise refusal("outcomes", "two scenarios and two draws of each, at least", got)
        return cls(declaration=declaration, outcomes=codes, margins=signed, claim=claim, _made_by=_OF_DESIGN)


@dataclass(frozen=True, kw_only=True)
class VarianceSplit:
    """Standard deviations (SI) of scenarios and draws, and the scenarios' share of the variance.

    ``low`` to ``high`` is exact if scenarios and draws are normal, ``bootstrap_low`` to ``bootstrap_high``
    approximate without that; where the two differ much, trust neither.  ``model_only``: of a simpler world.
    """

    scenarios: int
    draws: int
    scenario_deviation: float
    draw_deviation: float
    share: float
    low: float
    high: float
    bootstrap_low: float
    bootstrap_high: float
    confidence: float
    model_only: bool


@dataclass(frozen=True, kw_only=True)
class ShareOfScenarios:
    """``count`` scenarios, and between which shares the true one lies."""

    count: int
    low: float
    high: float


@dataclass(frozen=True, kw_only=True)
class ViolationSplit:
    """How many scenarios violate in all ``draws``, in some, in none; the intervals hold all together.

    A scenario with a draw that could not be judged, or that did not test the claim, is ``unclear`` unless
    the others say that it violates sometimes.  ``model_only``: of a simplified world.
    """

    draws: int
    always: ShareOfScenarios
    sometimes: ShareOfScenarios
    never: ShareOfScenarios
    unclear: int
    confidence: float
    model_only: bool


def variance_split(sample: NestedSample, confidence: float = 0.95) -> VarianceSplit:
    """By the method of moments, with the exact F interval (Searle, Casella and McCulloch, 1992).

    With the mean squares between, B, and within, W: s2 = (B - W) / k and w2 = W, and
    (B / W) / (1 + k s2 / w2) has an F distribution with m - 1 and m (k - 1) degrees of freedom.
    The bootstrap redraws scenarios and takes quantiles of the studentised log(B / W).  StatisticsError where
    a run was not judged or has no margin, or none differs.
    """
    margins = _nested(sample).margins
    m, k = margins.shape
    usable = np.isin(sample.outcomes, JUDGED) & np.isfinite(margins)
    if not usable.all():
        got = f"{np.count_nonzero(~usable)} of {margins.size} without"
        raise refusal("margins", "a verdict with a margin of every run", got)
    between, within = (float(square) for square in _mean_squares(margins))
    if between <= 0.0 and within <= 0.0:
        raise refusal("margins", "margins that differ", "all the same")
    chance = chance_of_each(confidence, 2)
    degrees = (m - 1, m * (k - 1))
    ratio = between / within if within > 0.0 else math.inf
    low, high = (_share(ratio / fdtri(*degrees, level), k) for level in (1.0 - chance, chance))
    ends = _studentised(margins, chance, generator(sample.declaration.seed, Branch.STATISTICS, 1))
    return VarianceSplit(
        scenarios=m,
        draws=k,
        scenario_deviation=math.sqrt(max((between - within) / k, 0.0)),
        draw_deviation=math.sqrt(within),
        share=_share(ratio, k),
        low=low,
        high=high,
        bootstrap_low=_share(ends[0], k),
        bootstrap_high=_share(ends[1], k),
        confidence=confidence,
        model_only=sample.declaration.model_only,
    )


def violation_split(sample: NestedSample, confidence: float = 0.95) -> ViolationSplit:
    """Scenarios that always, sometimes and never violate in k draws: Clopper and Pearson, Bonferroni."""
    outcomes = _nested(sample).outcomes
    violated, held = (outcomes == which for which in (EpisodeOutcome.VIOLATED, EpisodeOutcome.HOLDS))
    sometimes = violated.any(axis=1) & held.any(axis=1)
    always, never = violated.all(axis=1), held.all(axis=1)
    unclear = int(np.count_nonzero(~(sometimes | always | never)))
    chance = chance_of_each(confidence, 6)
    m = len(outcomes)

    def share(having: np.ndarray) -> ShareOfScenarios:
        count = int(np.count_nonzero(having))
        return ShareOfScenarios(
            count=count, low=lower_bound(count, m, chance), high=upper_bound(count + unclear, m, chance)
        )

    return ViolationSplit(
        draws=outcomes.shape[1],
        always=share(always),
        sometimes=share(sometimes),
        never=share(never),
        unclear=unclear,
        confidence=confidence,
        model_only=sample.declaration.model_only,
    )


def _nested(sample: object) -> NestedSample:
    if not isinstance(sample, NestedSample):
        raise TypeError(
            f"variances are split of a NestedSample, a declared design; got {type(sample).__name__}"
        )
    return sample


def _mean_squares(margins: Floats) -> tuple[Floats, Floats]:
    """Between and within scenarios, of ``margins`` (..., m, k) y_ij, a dot for a mean.

    B = k sum_i (y_i. - y_..)^2/(m - 1) and W = sum_ij (y_ij - y_i.)^2/(m (k - 1)).
    """
    m, k = margins.shape[-2:]
    means = margins.mean(axis=-1)
    between = k * means.var(axis=-1, ddof=1)
    within = ((margins - means[..., None]) ** 2).sum(axis=(-2, -1)) / (m * (k - 1))
    return np.asarray(between), np.asarray(within)


def _share(ratio: float, draws: int) -> float:
    """s2 / (s2 + w2) where (w2 + k s2) / w2 is ``ratio``; 0 where s2 would be negative."""
    if math.isinf(ratio):
        return 1.0
    scenarios = max(ratio - 1.0, 0.0) / draws
    return float(scenarios / (1.0 + scenarios))


def _studentised(margins: Floats, chance: float, rng: np.random.Generator) -> tuple[float, float]:
    """Both ends of B / W of ``margins`` (m, k): the bootstrap's t of its logarithm.

    Scenarios are redrawn with replacement; t = (log ratio' - log ratio)/error', as in ``_log_ratio``.
    """
    means, squares = margins.mean(axis=1), margins.var(axis=1, ddof=1)
    m, k = margins.shape
    rows = rng.integers(0, m, (BOOTSTRAP_DRAWS, m))
    with np.errstate(divide="ignore", invalid="ignore"):
        seen, error = _log_ratio(means, squares, k)
        redrawn, errors = _log_ratio(means[rows], squares[rows], k)
        t = (redrawn - seen) / errors
    if not (np.isfinite(seen) and error > 0.0):
        return 0.0, math.inf
    least, most = ends_of_t(t, chance)
    return float(np.exp(seen - most * error)), float(np.exp(seen - least * error))


def _log_ratio(means: Floats, squares: Floats, draws: int) -> tuple[Floats, Floats]:
    """log(B / W) and its standard error, of the scenarios' means and variances.

    ``means`` and ``squares`` are (..., m).  The error is sqrt(sum_i I_i^2/(m (m - 1))) of their centred
    influences I_i = (y_i. - y_..)^2/Var(y_.) - s_i^2/W (the infinitesimal jackknife).
    """
    m = means.shape[-1]
    between, within = means.var(axis=-1, ddof=1), squares.mean(axis=-1)
    apart = (means - means.mean(axis=-1, keepdims=True)) ** 2
    influence = apart / between[..., None] - squares / within[..., None]
    influence = influence - influence.mean(axis=-1, keepdims=True)
    error = np.sqrt((influence**2).sum(axis=-1) / (m * (m - 1)))
    return np.asarray(np.log(draws * between / within)), np.asarray(error)
