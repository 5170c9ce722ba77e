"""Two avoiders on the same episodes: which of them violates a claim more often, and by how much.

Episode k is the same scenario for both (common random numbers), so that what differs is the avoiders'
doing.  Shares are of all episodes drawn, tested or not: whether a claim is exercised may depend on the
avoider.  An inconclusive or failed run may have been a violation or none; every number here holds whichever
it was.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from safety_harness.base.proportions import lower_bound, median_rank, sign_test, upper_bound
from safety_harness.base.seeds import Branch, generator
from safety_harness.extensions.assurance.statistics.binomial import chance_of_each
from safety_harness.extensions.assurance.statistics.sample import (
    PERHAPS,
    EpisodeOutcome,
    Floats,
    IndependentSample,
    Ints,
    fixed_length,
    refusal,
)

BOOTSTRAP_DRAWS = 2000
_SAME_STREAM = "only runs of the same stream can be compared in pairs"
_EQUAL = 1e-12  # relative: what is no difference but rounding


@dataclass(frozen=True, kw_only=True)
class PairedComparison:
    """First minus second: ``low`` to ``high`` holds the difference in violation probability.

    ``only_first`` and ``only_second`` count episodes that for certain only one of them violates, ``both``
    those that both do, ``unclear`` those that one of them could not be judged on.  ``p_value`` is of "both
    violate equally often" (McNemar's exact test).  ``seen`` is the difference over the clear episodes.
    """

    claim: str
    stratum: str
    episodes: int
    only_first: int
    only_second: int
    both: int
    unclear: int
    seen: float
    low: float
    high: float
    p_value: float
    confidence: float
    model_only: bool


@dataclass(frozen=True, kw_only=True)
class MarginComparison:
    """First minus second, SI, over the ``pairs`` of episodes in which both were judged and have a margin.

    ``mean`` lies in an interval that is exact if the differences' ``limit`` was given; otherwise it is the
    bootstrap's t, whose confidence is approximate, and infinite where too few differences differ.  ``median``
    lies in one by order statistics, which assumes nothing and is exact.  ``left_out`` episodes are no such
    pair.  ``model_only``: of a simplified world.
    """

    pairs: int
    left_out: int
    limit: float | None
    mean: float
    mean_low: float
    mean_high: float
    median: float
    median_low: float
    median_high: float
    confidence: float
    model_only: bool


def compare(
    first: IndependentSample, second: IndependentSample, confidence: float = 0.95
) -> PairedComparison:
    """The difference in violation probability, exactly.

    The difference is D = t (2 s - 1): t the probability that only one of the two violates, s that it is the
    first of them then.  t and s have Clopper and Pearson's intervals with half of the error each, and D is
    between its extremes over both: its confidence is at least what is said, and usually more.
    StatisticsError for samples that are not of the same stream and claim.
    """
    _check_pair(first, second)
    chance = chance_of_each(confidence, 4)
    worst, best = _difference(first, second)
    n = len(worst)
    most = _extreme(int(np.sum(worst == 1)), int(np.sum(worst == -1)), n, chance)
    least = -_extreme(int(np.sum(best == -1)), int(np.sum(best == 1)), n, chance)
    clear = worst == best
    violated = [one.outcomes == EpisodeOutcome.VIOLATED for one in (first, second)]
    return PairedComparison(
        claim=first.claim,
        stratum=first.declaration.stratum,
        episodes=n,
        only_first=int(np.sum(best == 1)),
        only_second=int(np.sum(worst == -1)),
        both=int(np.sum(violated[0] & violated[1])),
        unclear=int(np.sum(~clear)),
        seen=float(worst[clear].mean()) if clear.any() else math.nan,
        low=least,
        high=most,
        p_value=_mcnemar(worst, best),
        confidence=confidence,
        model_only=first.declaration.model_only,
    )


def compare_margins(
    first: IndependentSample,
    second: IndependentSample,
    confidence: float = 0.95,
    *,
    limit: float | None = None,
) -> MarginComparison:
    """Mean and median of the paired differences of margins.

    ``limit`` (SI), if there is one, says that no difference can be greater or less than minus that: then the
    mean has the exact interval of Maurer and Pontil (2009).  StatisticsError for fewer than two pairs, or a
    difference beyond the limit.
    """
    _check_pair(first, second)
    chance = chance_of_each(confidence, 2)
    with_margin = [one.judged & np.isfinite(one.margins) for one in (first, second)]
    both = with_margin[0] & with_margin[1]
    differences = np.sort(first.margins[both] - second.margins[both])
    n = len(differences)
    if n < 2:
        raise refusal("margins", "two judged episodes with margins of both", str(n))
    if limit is None:
        low, high = _bootstrap_t(differences, chance, generator(first.declaration.seed, Branch.STATISTICS, 3))
    else:
        low, high = _bounded(differences, chance, limit)
    rank = median_rank(n, chance)
    ends = (differences[rank - 1], differences[n - rank]) if rank else (-math.inf, math.inf)
    return MarginComparison(
        pairs=n,
        left_out=len(both) - n,
        limit=limit,
        mean=float(differences.mean()),
        mean_low=low,
        mean_high=high,
        median=float(np.median(differences)),
        median_low=float(ends[0]),
        median_high=float(ends[1]),
        confidence=confidence,
        model_only=first.declaration.model_only,
    )


def _check_pair(first: IndependentSample, second: IndependentSample) -> None:
    for one in (first, second):
        fixed_length(one)
    a, b = first.declaration, second.declaration
    for field, mine, other in (
        ("claim", first.claim, second.claim),
        ("stratum", a.stratum, b.stratum),
        ("seed", a.seed, b.seed),
        ("runs", a.planned, b.planned),
        ("world", a.world.label, b.world.label),
        ("draws_sha256", a.draws_sha256, b.draws_sha256),
    ):
        if mine != other:
            raise refusal(field, "two samples of the same episodes", f"{mine!r} and {other!r}", _SAME_STREAM)
    other_seed = np.flatnonzero(first.seeds != second.seeds)
    if len(other_seed):
        k = int(other_seed[0])
        expected = f"the same seed of each episode in both samples ({first.name})"
        got = f"{first.seeds[k]} and {second.seeds[k]} in episode {k}"
        raise refusal("seeds", expected, got, _SAME_STREAM)


def _difference(first: IndependentSample, second: IndependentSample) -> tuple[Ints, Ints]:
    """First minus second (n,), at its most and at its least: -1, 0 or 1 each."""
    sure = [(one.outcomes == EpisodeOutcome.VIOLATED).astype(np.int64) for one in (first, second)]
    perhaps = [(own | np.isin(one.outcomes, PERHAPS)) for own, one in zip(sure, (first, second), strict=True)]
    return perhaps[0] - sure[1], sure[0] - perhaps[1]


def _extreme(more: int, fewer: int, n: int, chance: float) -> float:
    """The upper end of t (2 s - 1), for ``more`` and ``fewer`` discordant episodes of n.

    s at its upper end; t at its upper end where 2 s - 1 is positive, else at its lower.
    """
    discordant = more + fewer
    lean = 2.0 * (upper_bound(more, discordant, chance) if discordant else 1.0) - 1.0
    share = upper_bound if lean > 0.0 else lower_bound
    return lean * share(discordant, n, chance)


def _mcnemar(worst: Ints, best: Ints) -> float:
    """Two-sided, with unclear episodes as they speak least for a difference."""
    more, fewer = int(np.sum(best == 1)), int(np.sum(best == -1))  # at the least for the first
    if more <= fewer:
        fewer, more = int(np.sum(worst == 1)), int(np.sum(worst == -1))
        if more <= fewer:
            return 1.0
    return sign_test(more, fewer)


def _bounded(differences: Floats, chance: float, limit: float) -> tuple[float, float]:
    """The empirical Bernstein bound of the mean of ``differences`` (n,) (Maurer and Pontil, 2009, theorem 4).

    Half the width is sqrt(2 V l / n) + 7 R l / (3 (n - 1)) with V their variance, l = log(2 / a), a
    ``chance`` and R = 2 ``limit`` the range.
    """
    n, logarithm = len(differences), math.log(2.0 / chance)
    largest = float(np.abs(differences).max())
    if not largest <= limit:
        raise refusal("limit", f"differences of at most {limit:g}", f"{largest:g}")
    variance = float(differences.var(ddof=1))
    half = math.sqrt(2.0 * variance * logarithm / n) + 14.0 * limit * logarithm / (3.0 * (n - 1))
    mean = float(differences.mean())
    return max(mean - half, -limit), min(mean + half, limit)


def _bootstrap_t(differences: Floats, chance: float, rng: np.random.Generator) -> tuple[float, float]:
    """The mean of ``differences`` (n,) by the redrawn t's quantiles (Efron, 1981).

    From m - t_high s to m - t_low s, where t = (m' - m)/s' of samples redrawn with replacement; infinite of a
    redrawn sample without spread.
    """
    n, mean, deviation = len(differences), float(differences.mean()), float(differences.std(ddof=1))
    if deviation <= abs(mean) * _EQUAL:
        return -math.inf, math.inf
    redrawn, several = [], max(1, 500_000 // n)
    for first in range(0, BOOTSTRAP_DRAWS, several):
        rows = rng.integers(0, n, (min(several, BOOTSTRAP_DRAWS - first), n))
        again = differences[rows]
        spread = again.std(axis=1, ddof=1)
        apart = spread > deviation * _EQUAL
        redrawn.append(np.where(apart, (again.mean(axis=1) - mean) / np.where(apart, spread, 1.0), np.inf))
    least, most = ends_of_t(np.concatenate(redrawn), chance)
    return mean - most * deviation, mean - least * deviation


def ends_of_t(redrawn: Floats, chance: float) -> tuple[float, float]:
    """The ``chance`` and 1 - ``chance`` quantiles of a bootstrap's t, ``redrawn`` (n,), each outwards.

    One that is infinite or NaN, as of a redrawn sample without spread, is beyond either end.  Of so small a
    chance that fewer than one of them would be beyond, they say nothing: infinite.
    """
    if chance * len(redrawn) < 1.0:
        return -math.inf, math.inf
    beyond = ~np.isfinite(redrawn)
    least = np.quantile(np.where(beyond, -np.inf, redrawn), chance, method="lower")
    most = np.quantile(np.where(beyond, np.inf, redrawn), 1.0 - chance, method="higher")
    return float(least), float(most)
