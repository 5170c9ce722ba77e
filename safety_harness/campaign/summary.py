"""What a ledger says as a whole: how the campaign stands, and a fingerprint of its results."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass

from safety_harness.campaign.ledger import Ledger
from safety_harness.campaign.tally import CampaignTally, ClaimCounts, StratumTally
from safety_harness.properties.answered import fallback_words
from safety_harness.statistics.sample import EpisodeOutcome

_COUNTS = "SELECT stratum, claim, outcome, count(*), min(margin), episode FROM judgement GROUP BY 1, 2, 3"
_FAILED = (
    "SELECT stratum, count(DISTINCT episode) FROM judgement "
    f"WHERE outcome = {int(EpisodeOutcome.FAILED)} GROUP BY 1"
)
# Everything that is the same wherever an episode runs, in an order that is.
_SAME = (
    "SELECT e.episode, e.seed, e.draws, e.decisions, e.proposed, e.opposite, e.stopped, e.faults, e.late, "
    "c.words, e.mishap, e.failure FROM episode e LEFT JOIN cell c ON c.id = e.cell WHERE e.stratum = ? "
    "ORDER BY e.episode",
    "SELECT claim, episode, outcome, margin, worst_time_s, exercised FROM judgement WHERE stratum = ? "
    "ORDER BY claim, episode",
    "SELECT episode FROM trace WHERE stratum = ? ORDER BY episode",
)


def tally_of(ledger: Ledger) -> CampaignTally:
    """Counts and worst margins of what is there now."""
    declared = ledger.declared
    strata = [StratumTally(planned, [ClaimCounts() for _ in declared.claims]) for planned in declared.planned]
    for stratum, done in ledger.all("SELECT stratum, count(*) FROM episode GROUP BY stratum"):
        strata[stratum].done = done
    for stratum, after in ledger.all("SELECT id, stopped_after FROM stratum"):
        strata[stratum].stopped_after = after
    for stratum, claim, outcome, count, margin, episode in ledger.all(_COUNTS):
        least = math.nan if margin is None else margin
        strata[stratum].claims[claim].add(EpisodeOutcome(outcome), least, episode, count)
    for stratum, count in ledger.all(_FAILED):
        strata[stratum].failed = count
    return CampaignTally(strata)


@dataclass(frozen=True)
class FallbackTally:
    """In how many ``decisions`` the avoider gave no answer, in how many ``episodes``, and why most often."""

    unanswered: int
    decisions: int
    episodes: int
    reason: str

    @property
    def words(self) -> str:
        """For headlines; empty if it always answered."""
        return fallback_words(self.unanswered, self.decisions)


def fallback_of(ledger: Ledger, stratum: int | None = None) -> FallbackTally:
    """Of one stratum, or of all that is there now."""
    within = (stratum is None, stratum)
    counts = "SELECT coalesce(sum(faults), 0), coalesce(sum(decisions), 0), count(mishap) FROM episode"
    ((unanswered, decisions, episodes),) = ledger.all(f"{counts} WHERE ? OR stratum = ?", *within)
    often = "SELECT mishap FROM episode WHERE (? OR stratum = ?) AND mishap IS NOT NULL"
    words = ledger.all(f"{often} GROUP BY mishap ORDER BY count(*) DESC, mishap LIMIT 1", *within)
    reason = next((why for (why,) in words), "")
    return FallbackTally(int(unanswered), int(decisions), int(episodes), reason)


def fingerprint_of(ledger: Ledger) -> str:
    """SHA-256 of every result, bit for bit: two ledgers of a plan with the same results have the same."""
    digest = hashlib.sha256(ledger.declared.identity.sha256.encode())
    for stratum in range(len(ledger.declared.strata)):
        for question in _SAME:
            for row in ledger.all(question, stratum):
                digest.update(repr(row).encode())  # of a float: the shortest text that gives it again
    return digest.hexdigest()
