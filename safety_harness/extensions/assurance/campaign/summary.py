"""Summaries of a ledger: the counts, a fingerprint of the results, and a hash of all rows.

The hash is the root of a Merkle tree over the episodes, as in RFC 6962, section 2.1 (Laurie, Langley and
Kasper, 2013), with SHA-256. The input of a leaf begins with the byte 0, and the input of a node with the byte
1. Thus the hash of a node can never be the hash of a leaf. The left subtree of n leaves has as many leaves as
the largest power of two below n.

A leaf is the JSON of an episode. The JSON begins with the stratum, episode, seed, draws, decisions, overruled
proposals, run, theorem bits, cell, run error and failure. The kind and the SHA-256 of the stored trace
follow. The leaf ends with the outcome, margin, moment and occasions for each claim. The ledger does not store
these hashes, because a forger of the file could replace them too.
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

# One pass in the order of the rows; SQLite takes the episode from the first row with the least margin.
_COUNTS = (
    "SELECT stratum, claim, count(*), "
    f"{', '.join(f'count(*) FILTER (WHERE outcome = {int(code)})' for code in EpisodeOutcome)}, "
    f"min(margin) FILTER (WHERE outcome IN ({', '.join(str(int(code)) for code in JUDGED)})), episode "
    "FROM judgement GROUP BY 1, 2"
)
_FAILED = (
    "SELECT stratum, count(DISTINCT episode) FROM judgement "
    f"WHERE outcome = {int(EpisodeOutcome.FAILED)} GROUP BY 1"
)
_JUDGED = "SELECT claim, episode, outcome, margin, worst_time_s, exercised FROM judgement WHERE stratum = ?"


def _of_episode(ledger: Ledger) -> str:
    """Return the columns that are equal on every machine, except the columns that ``ledger`` lacks."""
    return (
        "e.episode, e.seed, e.draws, e.decisions, e.proposed, e.opposite, e.stopped, e.faults, e.late, "
        f"e.{', e.'.join(ledger.counts)}, c.words, e.mishap, e.failure"
    )


def tally_of(ledger: Ledger) -> CampaignTally:
    """Return the counts and the worst margins of the present rows in ``ledger``."""
    declared = ledger.declared
    strata = [StratumTally(planned, [ClaimCounts() for _ in declared.claims]) for planned in declared.planned]
    for stratum, done in ledger.all("SELECT stratum, count(*) FROM episode GROUP BY stratum"):
        strata[stratum].done = done
    for stratum, stop in ledger.all("SELECT id, stopped_after FROM stratum"):
        strata[stratum].stopped_after = stop
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
    """The state of a ledger at one moment.

    Only a complete campaign has ``bounds`` and a ``fingerprint``. There are no ``bounds`` if the episodes
    depend on each other.
    """

    tally: CampaignTally
    bounds: tuple[ProbabilityBounds, ...]
    fingerprint: str | None


def state_of(ledger: Ledger) -> LedgerState:
    """Return the state of the present rows in ``ledger``.

    The computation is slow for a million episodes.
    """
    tally = tally_of(ledger)
    bounds = bounds_in(ledger) if tally.complete and not ledger.dependent else ()
    return LedgerState(tally, bounds, fingerprint_of(ledger) if tally.complete else None)


def basis_in(ledger: Ledger, tally: CampaignTally) -> str:
    """Return a text that states the basis of the ledger's verdicts.

    The basis consists of the world, the number of runs that exercised each claim, and the aspects that no
    claim monitors.
    """
    claims = map(tally.of_claim, range(len(ledger.declared.claims)))
    return basis([str(ledger.declared.world)], ((counts.tested, tally.done) for counts in claims))


@dataclass(frozen=True)
class FallbackTally:
    """The queries that the avoider did not answer.

    ``unanswered`` of ``decisions`` queries had no answer, and ``reason`` is the most frequent reason.
    ``episodes`` is the number of episodes with an unanswered query.
    """

    unanswered: int
    decisions: int
    episodes: int
    reason: str

    @property
    def summary(self) -> str:
        """A headline on how often the avoider did not answer, or an empty string if it always answered."""
        return fallback_words(self.unanswered, self.decisions)


def shields_in(ledger: Ledger) -> tuple[str, ...]:
    """Return, for each stratum with a shield, a sentence on whether the shield's theorem applies."""
    every = "SELECT theorem, count(*) FROM episode WHERE stratum = ? GROUP BY theorem"
    theorems = ((name, counts_words(ledger.all(every, k))) for k, name in enumerate(ledger.declared.strata))
    return tuple(f"shield in {name}: {text}" for name, text in theorems if text)


def fallback_of(ledger: Ledger, stratum: int | None = None) -> FallbackTally:
    """Return how often the avoider did not answer in ``stratum``.

    If ``stratum`` is None, the result covers all strata.
    """
    selection = (stratum is None, stratum)
    counts = "SELECT coalesce(sum(faults), 0), coalesce(sum(decisions), 0), count(mishap) FROM episode"
    ((unanswered, decisions, episodes),) = ledger.all(f"{counts} WHERE ? OR stratum = ?", *selection)
    often = "SELECT mishap FROM episode WHERE (? OR stratum = ?) AND mishap IS NOT NULL"
    reasons = ledger.all(f"{often} GROUP BY mishap ORDER BY count(*) DESC, mishap LIMIT 1", *selection)
    reason = next((why for (why,) in reasons), "")
    return FallbackTally(int(unanswered), int(decisions), int(episodes), reason)


def bounds_in(ledger: Ledger) -> tuple[ProbabilityBounds, ...]:
    """Return the bounds of each claim in each stratum.

    All bounds hold simultaneously, as in a report.
    """
    declared = ledger.declared
    pairs = [(stratum, claim) for stratum in declared.strata for claim in declared.claims]
    return bounds_of([ledger.sample(*pair) for pair in pairs], declared.confidence, Sides.BOTH)


def fingerprint_of(ledger: Ledger) -> str:
    """Return the SHA-256 of all results.

    Two ledgers have the same fingerprint if their results agree bit for bit.
    """
    same = (  # the same results in the same order
        f"SELECT {_of_episode(ledger)} FROM episode e LEFT JOIN cell c ON c.id = e.cell "
        "WHERE e.stratum = ? ORDER BY e.episode",
        f"{_JUDGED} ORDER BY claim, episode",
        "SELECT episode FROM trace WHERE stratum = ? ORDER BY episode",
    )
    digest = hashlib.sha256(ledger.declared.identity.sha256.encode())
    for stratum in range(len(ledger.declared.strata)):
        for question in same:
            for row in ledger.all(question, stratum):
                digest.update(repr(row).encode())  # repr of a float is the shortest text that gives it again
    return digest.hexdigest()


@dataclass
class ClaimCounts:
    """The results of a claim in a stratum.

    The results are the number of episodes with each outcome, the least margin (SI), and the episode that has
    this margin.
    """

    counts: dict[EpisodeOutcome, int] = field(default_factory=lambda: dict.fromkeys(EpisodeOutcome, 0))
    worst: float = math.nan
    worst_episode: int = -1

    @property
    def tested(self) -> int:
        """The number of episodes that ran and exercised the claim."""
        left_out = (EpisodeOutcome.UNTESTED, EpisodeOutcome.FAILED)
        return sum(count for outcome, count in self.counts.items() if outcome not in left_out)

    def add(self, outcome: EpisodeOutcome, margin: float, episode: int) -> None:
        """Add the result of an episode.

        If several episodes have the least margin, the first of them is the worst.
        """
        self.counts[outcome] += 1
        tested = outcome in JUDGED and not math.isnan(margin)
        if tested and (math.isnan(self.worst) or (margin, episode) < (self.worst, self.worst_episode)):
            self.worst, self.worst_episode = margin, episode


@dataclass
class StratumTally:
    """The numbers of planned, finished and failed episodes of a stratum, and the counts for each claim."""

    planned: int
    claims: list[ClaimCounts]
    done: int = 0
    failed: int = 0
    stopped_after: int | None = None

    @property
    def complete(self) -> bool:
        """Whether no episode is missing."""
        return self.done >= self.planned or self.stopped_after is not None

    def add(self, row: Row) -> None:
        """Count one episode."""
        self.done += 1
        self.failed += any(judged.outcome is EpisodeOutcome.FAILED for judged in row.judgements)
        for claim, judgement in zip(self.claims, row.judgements, strict=True):
            claim.add(judgement.outcome, judgement.margin, row.episode)


@dataclass
class CampaignTally:
    """The tallies of all strata, in the plan's order."""

    strata: list[StratumTally]

    @property
    def done(self) -> int:
        """The number of finished episodes."""
        return sum(stratum.done for stratum in self.strata)

    @property
    def planned(self) -> int:
        """The number of planned episodes."""
        return sum(stratum.planned for stratum in self.strata)

    @property
    def failed(self) -> int:
        """The number of episodes that failed to run."""
        return sum(stratum.failed for stratum in self.strata)

    @property
    def complete(self) -> bool:
        """Whether no episode is missing."""
        return all(stratum.complete for stratum in self.strata)

    def of_claim(self, claim: int) -> ClaimCounts:
        """Return the counts of ``claim`` over all strata.

        The result does not say in which stratum ``worst_episode`` is.
        """
        whole = ClaimCounts()
        for stratum in self.strata:
            part = stratum.claims[claim]
            for outcome, count in part.counts.items():
                whole.counts[outcome] += count
            if not part.worst >= whole.worst and not math.isnan(part.worst):
                whole.worst, whole.worst_episode = part.worst, part.worst_episode
        return whole


_LEAF, _NODE = b"\x00", b"\x01"
_OF_STRATUM = (
    "LEFT JOIN cell c ON c.id = e.cell LEFT JOIN trace t ON t.stratum = e.stratum AND t.episode = e.episode "
    "WHERE e.stratum = ? ORDER BY e.episode"
)


def root_of(ledger: Ledger) -> str:
    """Return the Merkle root over all episodes in the order of the strata.

    The hashed rows include the judgements of all claims.
    """
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
    """Return the hash MTH (32 bytes) of RFC 6962 over ``leaves``, which the function reads only once.

    A finished subtree of 2^k leaves is stored until its right neighbour of 2^k leaves is finished too.
    """
    waiting: list[tuple[int, bytes]] = []  # (leaves, hash) by descending size
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
