"""One hash for all rows of a ledger in their order: the root of a Merkle tree over the episodes.

The tree is that of RFC 6962, section 2.1 (Laurie, Langley and Kasper, 2013): SHA-256, a zero byte before what
a leaf hashes and a one before what a node does, so that no node can be taken for a leaf; of n leaves the left
subtree has the largest power of two below n.

A leaf is an episode, as JSON: its stratum's and its own number, seed, draws, decisions, cell, run error,
outcome, margin, moment and occasions of each claim, and the SHA-256 of its trace if that is kept.  Hashes are
computed when they are asked for: stored in the same file they would protect nothing.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator

from safety_harness.campaign.ledger import Ledger

_LEAF, _NODE = b"\x00", b"\x01"
_EPISODE = (
    "SELECT e.stratum, e.episode, e.seed, e.draws, e.decisions, e.proposed, e.opposite, e.stopped, e.faults, "
    "e.late, c.words, e.mishap, e.failure, t.violation, t.data FROM episode e "
    "LEFT JOIN cell c ON c.id = e.cell LEFT JOIN trace t ON t.stratum = e.stratum AND t.episode = e.episode "
    "WHERE e.stratum = ? ORDER BY e.episode"
)
_JUDGEMENT = (
    "SELECT claim, episode, outcome, margin, worst_time_s, exercised FROM judgement "
    "WHERE stratum = ? AND claim = ? ORDER BY episode"
)


def root_of(ledger: Ledger) -> str:
    """Of all episodes, stratum by stratum, each judged by all claims."""
    return merkle_root(_rows(ledger)).hex()


def _rows(ledger: Ledger) -> Iterator[bytes]:
    declared = ledger.declared
    for stratum in range(len(declared.strata)):
        claims = [ledger.all(_JUDGEMENT, stratum, claim) for claim in range(len(declared.claims))]
        for (*row, data), *judged in zip(ledger.all(_EPISODE, stratum), *claims, strict=True):
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
