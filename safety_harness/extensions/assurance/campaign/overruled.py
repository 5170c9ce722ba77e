"""How often a campaign's gate overruled the avoider: counted, as a sample of episodes, and of two compared.

That an episode had *some* proposal overruled is judged like a claim, so that its bounds and its paired test
are those of ``statistics``: it is untested where nothing was proposed, and may or may not have happened in
an episode that failed to run.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from safety_harness.base.proportions import share_words
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.opening import OVERRULED
from safety_harness.extensions.assurance.statistics.paired import PairedComparison, compare
from safety_harness.extensions.assurance.statistics.sample import EpisodeOutcome, IndependentSample
from safety_harness.trace.overruling import COUNTS, Overruling

NONE_OVERRULED = "no proposal overruled"
_SUMS = ", ".join(f"coalesce(sum({name}), 0)" for name in COUNTS)
_EPISODES = (
    f"SELECT e.episode, e.seed, e.proposals, {OVERRULED}, e.failure IS NOT NULL FROM episode e "
    "WHERE e.stratum = ? AND e.episode < coalesce(?, e.episode + 1) ORDER BY e.episode"
)


def overruling_in(ledger: Ledger, stratum: int | None = None) -> Overruling:
    """Of one stratum, or of all that is there now."""
    within = (stratum is None, stratum)
    return Overruling.of_counts(*ledger.all(f"SELECT {_SUMS} FROM episode WHERE ? OR stratum = ?", *within))


def overruled_episodes(ledger: Ledger, stratum: int) -> IndependentSample:
    """Which episodes of a stratum had a proposal overruled: "violated"; the margin is minus how many.

    StatisticsError while episodes are missing.
    """
    rows = np.array(list(ledger.all(_EPISODES, stratum, ledger.stopped_after(stratum))), np.int64)
    episodes, seeds, proposals, overruled, failed = rows.reshape(-1, 5).T
    outcomes = np.select(
        [overruled > 0, failed > 0, proposals > 0],
        [EpisodeOutcome.VIOLATED, EpisodeOutcome.FAILED, EpisodeOutcome.HOLDS],
        EpisodeOutcome.UNTESTED,
    )
    return IndependentSample.of_stream(
        ledger.stream(stratum),
        episodes,
        outcomes,
        np.where(outcomes == EpisodeOutcome.UNTESTED, np.nan, -overruled),
        seeds=seeds,
        exercised=proposals,
        claim=NONE_OVERRULED,
    )


@dataclass(frozen=True)
class OverrulingCompared:
    """One stratum of two campaigns: all proposals of each, and the episodes with some overruled, paired."""

    stratum: str
    before: Overruling
    after: Overruling
    episodes: PairedComparison  # second campaign minus first

    @property
    def words(self) -> str:
        """One line."""
        one, more = self.episodes, self.after.share - self.before.share
        was, now = (
            f"{share_words(of.overruled, of.proposals)} of {of.proposals:,}"
            for of in (self.before, self.after)
        )
        difference = f" ({more:+.1%})" if math.isfinite(more) else ""
        unclear = f", unclear {one.unclear}" if one.unclear else ""
        return (
            f"{self.stratum}: overruled {now} proposals, before {was}{difference}; of {one.episodes} "
            f"episodes some proposal was overruled both times in {one.both}, only after in {one.only_first}, "
            f"only before in {one.only_second}{unclear}; p {one.p_value:.3g} (McNemar, of its own line alone)"
        )


def compare_overruling(first: Ledger, second: Ledger) -> list[OverrulingCompared]:
    """For each stratum that both have, as ``compare_ledgers``, which refuses what cannot be compared."""
    strata = [name for name in first.declared.strata if name in second.declared.strata]
    places = [(first.declared.strata.index(name), second.declared.strata.index(name)) for name in strata]
    return [
        OverrulingCompared(
            name,
            overruling_in(first, a),
            overruling_in(second, b),
            compare(overruled_episodes(second, b), overruled_episodes(first, a)),
        )
        for name, (a, b) in zip(strata, places, strict=True)
    ]
