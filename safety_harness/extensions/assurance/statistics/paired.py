"""Two avoiders on the same episodes: which of them violates a claim more often.

Episode k is the same scenario for both (common random numbers), so that what differs is the avoiders'
doing.  Shares are of all episodes drawn, tested or not: whether a claim is exercised may depend on the
avoider.  An inconclusive or failed run may have been a violation or none; every number here holds whichever
it was.
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
