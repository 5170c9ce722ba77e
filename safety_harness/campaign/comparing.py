"""Two campaigns over the same episodes: what got worse from one avoider to the other."""

from __future__ import annotations

from dataclasses import dataclass

from safety_harness.campaign.ledger import Ledger
from safety_harness.exceptions import LedgerError, Place
from safety_harness.properties.base import Unit
from safety_harness.statistics.paired import PairedComparison, compare


@dataclass(frozen=True)
class Worse:
    """An episode that violates a claim with the second avoider, and does not with the first; margins SI."""

    stratum: str
    episode: int
    claim: str
    unit: Unit
    before: float | None
    after: float | None


def compare_ledgers(first: Ledger, second: Ledger) -> tuple[PairedComparison, ...]:
    """For each claim and stratum that both have: second minus first, exactly, at the first's confidence.

    The bounds hold together (Bonferroni).  LedgerError for campaigns that share no claim, stratum or space,
    StatisticsError while episodes are missing, or for others than the same.
    """
    _refuse_other_spaces(first, second)
    strata = [name for name in first.declared.strata if name in second.declared.strata]
    claims = [claim for claim in first.declared.claims if claim in second.declared.claims]
    if not strata or not claims:
        raise LedgerError(
            place=Place(file=second.path), expected="a stratum and a claim of the other ledger", got="none"
        )
    pairs = [(stratum, claim) for stratum in strata for claim in claims]
    confidence = 1.0 - (1.0 - first.declared.confidence) / len(pairs)
    return tuple(compare(second.sample(*pair), first.sample(*pair), confidence) for pair in pairs)


def worse_episodes(first: Ledger, second: Ledger, most: int = 20) -> list[Worse]:
    """Episodes with a violation that the first did not have, the largest loss of margin first."""
    found = []
    with second.attached(first.path, "first"):
        rows = second.all(
            "SELECT s.name, a.episode, c.sentence, c.unit, b.margin, a.margin "
            "FROM judgement a JOIN stratum s ON s.id = a.stratum JOIN claim c ON c.id = a.claim "
            "JOIN first.stratum t ON t.name = s.name JOIN first.claim d ON d.sentence = c.sentence "
            "JOIN first.judgement b ON b.stratum = t.id AND b.claim = d.id AND b.episode = a.episode "
            "WHERE a.outcome = 1 AND b.outcome <> 1 "
            "ORDER BY ifnull(b.margin, 0) - a.margin DESC, s.name, c.sentence, a.episode LIMIT ?",
            most,
        )
        for stratum, episode, claim, unit, before, after in rows:
            found.append(Worse(stratum, episode, claim, Unit[unit], before, after))
    return found


def _refuse_other_spaces(first: Ledger, second: Ledger) -> None:
    """Common random numbers are common only where the spaces are."""
    if first.draws_sha256 != second.draws_sha256:
        raise LedgerError(
            place=Place(file=second.path),
            expected=f"a campaign over the same spaces as {first.path}",
            got="spaces with another text",
        )
