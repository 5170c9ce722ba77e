"""How a campaign stands: counts and worst margins, for people who watch it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from safety_harness.campaign.rows import Row
from safety_harness.statistics.sample import EpisodeOutcome


@dataclass
class ClaimCounts:
    """One claim in one stratum: episodes by outcome, and the least margin (SI) with its episode."""

    counts: dict[EpisodeOutcome, int] = field(default_factory=lambda: dict.fromkeys(EpisodeOutcome, 0))
    worst: float = math.nan
    worst_episode: int = -1

    def add(self, outcome: EpisodeOutcome, margin: float, episode: int, times: int = 1) -> None:
        """Count; of equal margins the first episode's is kept."""
        self.counts[outcome] += times
        tested = outcome in (EpisodeOutcome.HOLDS, EpisodeOutcome.VIOLATED)
        if tested and not math.isnan(margin):
            known = not math.isnan(self.worst)
            if not known or (margin, episode) < (self.worst, self.worst_episode):
                self.worst, self.worst_episode = margin, episode


@dataclass
class StratumTally:
    """One stratum: episodes done of those planned, and how many of them could not be run."""

    planned: int
    claims: list[ClaimCounts]
    done: int = 0
    failed: int = 0
    stopped_after: int | None = None

    @property
    def complete(self) -> bool:
        """Is there nothing left to run?"""
        return self.done >= self.planned or self.stopped_after is not None

    def add(self, row: Row) -> None:
        """Count one episode."""
        self.done += 1
        self.failed += any(one.outcome is EpisodeOutcome.FAILED for one in row.judgements)
        for claim, judgement in zip(self.claims, row.judgements, strict=True):
            claim.add(judgement.outcome, judgement.margin, row.episode)


@dataclass
class CampaignTally:
    """All strata, in the plan's order."""

    strata: list[StratumTally]

    @property
    def done(self) -> int:
        """Episodes."""
        return sum(stratum.done for stratum in self.strata)

    @property
    def planned(self) -> int:
        """Episodes."""
        return sum(stratum.planned for stratum in self.strata)

    @property
    def failed(self) -> int:
        """Episodes that could not be run."""
        return sum(stratum.failed for stratum in self.strata)

    @property
    def complete(self) -> bool:
        """Is there nothing left to run?"""
        return all(stratum.complete for stratum in self.strata)

    def of_claim(self, claim: int) -> ClaimCounts:
        """One claim over all strata; the worst margin's episode is of whichever stratum it is in."""
        whole = ClaimCounts()
        for stratum in self.strata:
            one = stratum.claims[claim]
            for outcome, count in one.counts.items():
                whole.counts[outcome] += count
            if not one.worst >= whole.worst and not math.isnan(one.worst):
                whole.worst, whole.worst_episode = one.worst, one.worst_episode
        return whole
