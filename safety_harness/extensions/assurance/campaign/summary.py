"""What a ledger says as a whole: how the campaign stands, a fingerprint of its results, a hash of all rows.

The hash is the root of a Merkle tree over the episodes, that of RFC 6962, section 2.1 (Laurie, Langley and
Kasper, 2013): SHA-256, a zero byte before what a leaf hashes and a one before what a node does, so that no
node can be taken for a leaf; of n leaves the left subtree has the largest power of two below n.

A leaf is an episode, as JSON: its stratum's and its own number, seed, draws, decisions, overruled proposals,
cell, run error, outcome, margin, moment and occasions of each claim, and the SHA-256 of its trace if that is
kept.  Hashes are computed when they are asked for: stored in the same file they would protect nothing.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

from safety_harness.claims.properties.answered import fallback_words
from safety_harness.claims.properties.shield_theorem import counts_words
from safety_harness.claims.properties.tally import basis
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.opening import unusable
from safety_harness.extensions.assurance.campaign.rows import Row
from safety_harness.extensions.assurance.statistics.binomial import ProbabilityBounds, Sides, bounds_of
from safety_harness.extensions.assurance.statistics.sample import JUDGED, EpisodeOutcome

# One pass in the order of the rows; of equal margins the first episode is the one beside min().
_COUNTS = (
    "SELECT stratum, claim, count(*), "
    f"{', '.join(f'count(*) FILTER (WHERE outcome = {int(one)})' for one in EpisodeOutcome)}, "
    f"min(margin) FILTER (WHERE outcome IN ({', '.join(str(int(one)) for one in JUDGED)})), episode "
    "FROM judgement GROUP BY 1, 2"
)
_FAILED = (
    "SELECT stratum, count(DISTINCT episode) FROM judgement "
    f"WHERE outcome = {int(EpisodeOutcome.FAILED)} GROUP BY 1"
)
_JUDGED = "SELECT claim, episode, outcome, margin, worst_time_s, exercised FROM judgement WHERE stratum = ?"


def _of_episode(ledger: Ledger) -> str:
    """The columns of what is the same wherever an episode runs, as the ledger was made with them."""
    return (
        "e.episode, e.seed, e.draws, e.decisions, e.proposed, e.opposite, e.stopped, e.faults, e.late, "
        f"e.{', e.'.join(ledger.counts)}, c.words, e.mishap, e.failure"
    )


def tally_of(ledger: Ledger) -> CampaignTally:
    """Counts and worst margins of what is there now."""
    declared = ledger.declared
    strata = [StratumTally(planned, [ClaimCounts() for _ in declared.claims]) for planned in declared.planned]
    for stratum, done in ledger.all("SELECT stratum, count(*) FROM episode GROUP BY stratum"):
        strata[stratum].done = done
    for stratum, after in ledger.all("SELECT id, stopped_after FROM stratum"):
        strata[stratum].stopped_after = after
    for stratum, claim, rows, *counts, margin, episode in ledger.all(_COUNTS):
        if sum(counts) != rows:
            raise unusable(ledger.path, f"outcomes from 0 to {len(counts) - 1}", "another in a judgement")
        worst = (math.nan, -1) if margin is None else (margin, episode)
        strata[stratum].claims[claim] = ClaimCounts(dict(zip(EpisodeOutcome, counts, strict=True)), *worst)
    for stratum, count in ledger.all(_FAILED):
        strata[stratum].failed = count
    return CampaignTally(strata)


@dataclass(frozen=True)
class LedgerState:
    """What is said of a ledger, computed once; ``bounds`` and ``fingerprint`` of a complete campaign alone.

    ``bounds`` are empty also where episodes depend on each other.
    """

    tally: CampaignTally
    bounds: tuple[ProbabilityBounds, ...]
    fingerprint: str | None


def state_of(ledger: Ledger) -> LedgerState:
    """Of what is there now: of a million episodes it takes its time."""
    tally = tally_of(ledger)
    bounds = bounds_in(ledger) if tally.complete and not ledger.dependent else ()
    return LedgerState(tally, bounds, fingerprint_of(ledger) if tally.complete else None)


def basis_in(ledger: Ledger, tally: CampaignTally) -> str:
    """Say what the ledger's verdicts rest on: its world, the exercised runs, and what nothing watched."""
    claims = map(tally.of_claim, range(len(ledger.declared.claims)))
    return basis([str(ledger.declared.world)], ((one.tested, tally.done) for one in claims))


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


def shields_in(ledger: Ledger) -> tuple[str, ...]:
    """How the theorem of the shield stands after the runs of each stratum of which one is noted."""
    every = "SELECT theorem, count(*) FROM episode WHERE stratum = ? GROUP BY theorem"
    found = ((name, counts_words(ledger.all(every, k))) for k, name in enumerate(ledger.declared.strata))
    return tuple(f"shield in {name}: {words}" for name, words in found if words)


def fallback_of(ledger: Ledger, stratum: int | None = None) -> FallbackTally:
    """Of one stratum, or of all that is there now."""
    within = (stratum is None, stratum)
    counts = "SELECT coalesce(sum(faults), 0), coalesce(sum(decisions), 0), count(mishap) FROM episode"
    ((unanswered, decisions, episodes),) = ledger.all(f"{counts} WHERE ? OR stratum = ?", *within)
    often = "SELECT mishap FROM episode WHERE (? OR stratum = ?) AND mishap IS NOT NULL"
    words = ledger.all(f"{often} GROUP BY mishap ORDER BY count(*) DESC, mishap LIMIT 1", *within)
    reason = next((why for (why,) in words), "")
    return FallbackTally(int(unanswered), int(decisions), int(episodes), reason)


def bounds_in(ledger: Ledger) -> tuple[ProbabilityBounds, ...]:
    """Of each claim in each stratum, as a report has them: all hold together."""
    declared = ledger.declared
    pairs = [(stratum, claim) for stratum in declared.strata for claim in declared.claims]
    return bounds_of([ledger.sample(*pair) for pair in pairs], declared.confidence, Sides.BOTH)


def fingerprint_of(ledger: Ledger) -> str:
    """SHA-256 of every result, bit for bit: two ledgers of a plan with the same results have the same."""
    same = (  # in an order that is
        f"SELECT {_of_episode(ledger)} FROM episode e LEFT JOIN cell c ON c.id = e.cell "
        "WHERE e.stratum = ? ORDER BY e.episode",
        f"{_JUDGED} ORDER BY claim, episode",
        "SELECT episode FROM trace WHERE stratum = ? ORDER BY episode",
    )
    digest = hashlib.sha256(ledger.declared.identity.sha256.encode())
    for stratum in range(len(ledger.declared.strata)):
        for question in same:
            for row in ledger.all(question, stratum):
                digest.update(repr(row).encode())  # of a float: the shortest text that gives it again
    return digest.hexdigest()


@dataclass
class ClaimCounts:
    """One claim in one stratum: episodes by outcome, and the least margin (SI) with its episode."""

    counts: dict[EpisodeOutcome, int] = field(default_factory=lambda: dict.fromkeys(EpisodeOutcome, 0))
    worst: float = math.nan
    worst_episode: int = -1

    @property
    def tested(self) -> int:
        """Episodes that ran and put it to the test."""
        left_out = (EpisodeOutcome.UNTESTED, EpisodeOutcome.FAILED)
        return sum(count for outcome, count in self.counts.items() if outcome not in left_out)

    def add(self, outcome: EpisodeOutcome, margin: float, episode: int) -> None:
        """Count; of equal margins the first episode's is kept."""
        self.counts[outcome] += 1
        tested = outcome in JUDGED and not math.isnan(margin)
        if tested and (math.isnan(self.worst) or (margin, episode) < (self.worst, self.worst_episode)):
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


_LEAF, _NODE = b"\x00", b"\x01"
_OF_STRATUM = (
    "LEFT JOIN cell c ON c.id = e.cell LEFT JOIN trace t ON t.stratum = e.stratum AND t.episode = e.episode "
    "WHERE e.stratum = ? ORDER BY e.episode"
)


def root_of(ledger: Ledger) -> str:
    """Of all episodes, stratum by stratum, each judged by all claims."""
    return merkle_root(_rows(ledger)).hex()


def _rows(ledger: Ledger) -> Iterator[bytes]:
    declared = ledger.declared
    episodes = f"SELECT e.stratum, {_of_episode(ledger)}, t.violation, t.data FROM episode e {_OF_STRATUM}"
    for stratum in range(len(declared.strata)):
        question = f"{_JUDGED} AND claim = ? ORDER BY episode"
        claims = [ledger.all(question, stratum, claim) for claim in range(len(declared.claims))]
        for (*row, data), *judged in zip(ledger.all(episodes, stratum), *claims, strict=True):
            trace = None if data is None else hashlib.sha256(data).hexdigest()
            yield json.dumps([*row, trace, judged], separators=(",", ":")).encode()


def merkle_root(leaves: Iterable[bytes]) -> bytes:
    """MTH of RFC 6962: 32 bytes.  Subtrees whose sizes are powers of two wait for their right neighbours."""
    waiting: list[tuple[int, bytes]] = []  # sizes that descend
    for leaf in leaves:
        size, digest = 1, _sha256(_LEAF + leaf)
        while waiting and waiting[-1][0] == size:
            size, digest = 2 * size, _sha256(_NODE + waiting.pop()[1] + digest)
        waiting.append((size, digest))
    if not waiting:
        return _sha256(b"")
    digest = waiting.pop()[1]
    while waiting:
        digest = _sha256(_NODE + waiting.pop()[1] + digest)
    return digest


def _sha256(data: bytes) -> bytes:
    return hashlib.sha256(data).digest()
