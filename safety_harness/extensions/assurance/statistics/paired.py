"""Estimate how the violation probabilities of two avoiders differ, from runs on the same episodes.

Episode k is the same scenario for both avoiders (common random numbers), so that only the avoiders can cause
a difference. A fraction refers to all episodes, tested or not, because an avoider may influence whether a run
exercises the claim.

An inconclusive or failed run may have violated the claim or not. The results of this module are valid in both
cases.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from safety_harness.base.proportions import lower_bound, sign_test, upper_bound
from safety_harness.extensions.assurance.statistics.binomial import chance_of_each
from safety_harness.extensions.assurance.statistics.sample import (
    PERHAPS,
    EpisodeOutcome,
    IndependentSample,
    Ints,
    fixed_length,
    refusal,
)

_SAME_STREAM = "only runs of the same stream can be compared in pairs"


@dataclass(frozen=True, kw_only=True)
class PairedComparison:
    """The difference in violation probability, first avoider minus second avoider.

    The difference lies between ``low`` and ``high``. The interval holds with ``confidence``. ``only_first``
    is the number of episodes in which certainly only the first avoider violates the claim. ``only_second`` is
    the same number for the second avoider. ``both`` is the number of episodes in which both avoiders violate
    the claim. ``unclear`` is the number of episodes whose difference depends on a run without a verdict.

    ``seen`` is the mean difference over all episodes except the unclear episodes. ``p_value`` tests the
    hypothesis that both avoiders violate the claim equally often (McNemar's exact test).
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


def compare(
    first: IndependentSample, second: IndependentSample, confidence: float = 0.95
) -> PairedComparison:
    """Return the exact interval of the difference in violation probability, ``first`` minus ``second``.

    The difference is D = t (2 s - 1). Here t is the probability that exactly one avoider violates the claim.
    If exactly one avoider violates the claim, then s is the probability that it is the first avoider. Both t
    and s have Clopper and Pearson's intervals, each with half of the error. While t and s vary within these
    intervals, D varies within its own interval. The interval of D usually holds with more than the stated
    confidence.

    Args:
        first: A sample of fixed length.
        second: The sample of the same stream and claim with the second avoider.
        confidence: The confidence of the interval, between 0 and 1.

    Raises:
        StatisticsError: The samples differ in stream or claim, or a stream may stop early.

    """
    _check_pair(first, second)
    # Four ends, two each of t and s.
    chance = chance_of_each(confidence, 4)
    worst, best = _difference(first, second)
    n = len(worst)
    most = _extreme(int(np.sum(worst == 1)), int(np.sum(worst == -1)), n, chance)
    least = -_extreme(int(np.sum(best == -1)), int(np.sum(best == 1)), n, chance)
    clear = worst == best
    violated = [sample.outcomes == EpisodeOutcome.VIOLATED for sample in (first, second)]
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


def _check_pair(first: IndependentSample, second: IndependentSample) -> None:
    for sample in (first, second):
        fixed_length(sample)
    a, b = first.declaration, second.declaration
    for field, ours, theirs in (
        ("claim", first.claim, second.claim),
        ("stratum", a.stratum, b.stratum),
        ("seed", a.seed, b.seed),
        ("runs", a.planned, b.planned),
        ("world", a.world.label, b.world.label),
        ("draws_sha256", a.draws_sha256, b.draws_sha256),
    ):
        if ours != theirs:
            raise refusal(field, "two samples of the same episodes", f"{ours!r} and {theirs!r}", _SAME_STREAM)
    other_seed = np.flatnonzero(first.seeds != second.seeds)
    if len(other_seed):
        k = int(other_seed[0])
        expected = f"the same seed of each episode in both samples ({first.name})"
        got = f"{first.seeds[k]} and {second.seeds[k]} in episode {k}"
        raise refusal("seeds", expected, got, _SAME_STREAM)


def _difference(first: IndependentSample, second: IndependentSample) -> tuple[Ints, Ints]:
    """Return the largest and the least possible difference of each episode, each of shape (n,).

    The difference is the result of the first avoider minus the result of the second. Each difference is -1, 0
    or 1.
    """
    sure = [(run.outcomes == EpisodeOutcome.VIOLATED).astype(np.int64) for run in (first, second)]
    perhaps = [own | np.isin(run.outcomes, PERHAPS) for own, run in zip(sure, (first, second), strict=True)]
    return perhaps[0] - sure[1], sure[0] - perhaps[1]


def _extreme(more: int, fewer: int, n: int, chance: float) -> float:
    """Return the upper end of t (2 s - 1) for n episodes.

    In ``more`` episodes, only the first sample has a violation. In ``fewer`` episodes, only the second sample
    has a violation. At the maximum, s is at its upper end. If 2 s - 1 is positive, t is at its upper end too.
    Otherwise, t is at its lower end.
    """
    discordant = more + fewer
    # Without an episode in which exactly one avoider violates the claim, s may be 1.
    lean = 2.0 * (upper_bound(more, discordant, chance) if discordant else 1.0) - 1.0
    share = upper_bound if lean > 0.0 else lower_bound
    return lean * share(discordant, n, chance)


def _mcnemar(worst: Ints, best: Ints) -> float:
    """Return the two-sided p-value.

    Unclear episodes are counted in the way that gives the least evidence of a difference.
    """
    more, fewer = int(np.sum(best == 1)), int(np.sum(best == -1))  # counts of the least possible differences
    if more <= fewer:
        fewer, more = int(np.sum(worst == 1)), int(np.sum(worst == -1))
        if more <= fewer:
            return 1.0
    return sign_test(more, fewer)
