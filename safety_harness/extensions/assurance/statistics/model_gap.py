"""What runs in the kinematic world say of the reference world: nothing, unless the gap is bounded too.

A run violates in the reference world either in both worlds or there only; the latter is *optimistic*
disagreement of the kinematic world.  With V a violation and T a test in the reference world, and V' a
violation in the kinematic one,

    P(V | T)  <=  ( P(V') + P(V and not V') ) / P(T)

Each of the three is bounded, with a third of the error: P(V') from many kinematic runs, the other two from
a declared independent sample of episodes that were run in both worlds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from safety_harness.base.proportions import lower_bound, upper_bound
from safety_harness.extensions.assurance.statistics.binomial import chance_of_each
from safety_harness.extensions.assurance.statistics.sample import (
    PERHAPS,
    EpisodeOutcome,
    IndependentSample,
    fixed_length,
    refusal,
)

# What counts as a violation in either world, so that the two bounds add up.
_MAYBE = (EpisodeOutcome.VIOLATED, *PERHAPS)


@dataclass(frozen=True, kw_only=True)
class BridgedBound:
    """With ``confidence``, tested runs of the reference world violate in ``high`` of cases at most.

    ``kinematic`` bounds violations of the kinematic world, ``optimistic`` those that it does not show, both
    of all runs; ``tested`` is the least share of runs that test the claim.  ``episodes`` of the kinematic
    world, ``in_both`` of both, ``optimistic_seen`` disagreements among these.
    """

    stratum: str
    claim: str
    high: float
    kinematic: float
    optimistic: float
    tested: float
    episodes: int
    in_both: int
    optimistic_seen: int
    confidence: float


def bridged_bound(
    kinematic: IndependentSample, here: IndependentSample, there: IndependentSample, confidence: float = 0.95
) -> BridgedBound:
    """An upper bound for the reference world from ``kinematic`` runs and a sample of both worlds.

    ``here`` and ``there`` are the same episodes in the kinematic and in the reference world.
    StatisticsError for samples of other claims, strata, worlds or episodes.
    """
    _check(kinematic, here, there)
    chance = chance_of_each(confidence, 3)
    shown_here, there_perhaps = (np.isin(one.outcomes, _MAYBE) for one in (here, there))
    optimistic_seen = int(np.count_nonzero(there_perhaps & ~shown_here))
    episodes, in_both = len(kinematic.outcomes), len(there.outcomes)
    alone = upper_bound(kinematic.at_worst, episodes, chance)
    optimistic = upper_bound(optimistic_seen, in_both, chance)
    sure = int(np.count_nonzero(there.judged))
    tested = lower_bound(sure, in_both, chance)
    return BridgedBound(
        stratum=there.declaration.stratum,
        claim=there.claim,
        high=min(1.0, (alone + optimistic) / tested) if tested > 0.0 else 1.0,
        kinematic=alone,
        optimistic=optimistic,
        tested=tested,
        episodes=episodes,
        in_both=in_both,
        optimistic_seen=optimistic_seen,
        confidence=confidence,
    )


def _check(kinematic: IndependentSample, here: IndependentSample, there: IndependentSample) -> None:
    samples = [fixed_length(sample) for sample in (kinematic, here, there)]
    for field, found in (
        ("claim", {sample.claim for sample in samples}),
        ("stratum", {sample.declaration.stratum for sample in samples}),
        ("what draws the scenarios", {sample.declaration.draws_sha256 for sample in samples}),
        ("episodes in both worlds", {(s.declaration.seed, tuple(s.seeds.tolist())) for s in samples[1:]}),
    ):
        if len(found) > 1:
            got = " and ".join(sorted(repr(one) for one in found))
            raise refusal(field, "one and the same", got)
    modelled = [sample.declaration.model_only for sample in samples]
    if modelled != [True, True, False]:
        worlds = ", ".join(sample.declaration.world.label for sample in samples)
        raise refusal("world", "kinematic, kinematic and the reference world", worlds)
