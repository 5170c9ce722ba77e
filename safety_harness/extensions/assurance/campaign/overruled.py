"""Count how often the gate overruled the avoider in a campaign, and compare two campaigns.

The functions treat the statement "no proposal of this episode was overruled" like a claim. Thus
``statistics`` can compute the bounds and the paired test of this statement. An episode without a proposal is
UNTESTED. An episode that failed to run is FAILED, unless the gate had already overruled a proposal.
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
    """Return how often the gate overruled proposals in ``stratum``.

    If ``stratum`` is None, the result covers all strata.
    """
    chosen = (stratum is None, stratum)
    return Overruling.of_counts(*ledger.all(f"SELECT {_SUMS} FROM episode WHERE ? OR stratum = ?", *chosen))


def overruled_episodes(ledger: Ledger, stratum: int) -> IndependentSample:
    """Return the episodes of ``stratum`` as a sample.

    An overruled proposal is treated as a violation. The margin of an episode is its number of overruled
    proposals, multiplied by -1. Raise StatisticsError while episodes are missing.
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
    """A comparison of two campaigns in one stratum.

    It has the two counts of overruled proposals, and a paired test of the episodes.
    """

    stratum: str
    before: Overruling
    after: Overruling
    episodes: PairedComparison  # second campaign minus first

    @property
    def summary(self) -> str:
        """A line that summarises the comparison."""
        pair, more = self.episodes, self.after.share - self.before.share
        was, now = (
            f"{share_words(counts.overruled, counts.proposals)} of {counts.proposals:,}"
            for counts in (self.before, self.after)
        )
        difference = f" ({more:+.1%})" if math.isfinite(more) else ""
        unclear = f", unclear {pair.unclear}" if pair.unclear else ""
        return (
            f"{self.stratum}: overruled {now} proposals, before {was}{difference}; of {pair.episodes} "
            f"episodes some proposal was overruled both times in {pair.both}, only after in "
            f"{pair.only_first}, only before in {pair.only_second}{unclear}; p {pair.p_value:.3g} "
            "(McNemar, of its own line alone)"
        )


def compare_overruling(first: Ledger, second: Ledger) -> list[OverrulingCompared]:
    """Return the comparison of each common stratum of two ledgers.

    ``compare_ledgers`` must accept the ledgers first.
    """
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
