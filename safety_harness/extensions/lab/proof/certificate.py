"""The certificate of a proof: JSON with what is claimed of which network, and the tree that shows it.

A tree is its codes, level by level, a byte each, compressed, in base64.  ``check.py`` reads the same file
with code of its own.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import json
import zlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from math import ceil, floor
from pathlib import Path
from typing import Any

import numpy as np

from safety_harness.base.exceptions import InputError, Place
from safety_harness.base.settings import Vector3
from safety_harness.base.whole_file import write_text
from safety_harness.extensions.lab.proof.box_kernel import OUTSIDE, PROVEN
from safety_harness.extensions.lab.proof.claims import ClaimKind, DecisionClaim
from safety_harness.extensions.lab.proof.plan import PlannedProof, ProofPlan, ProofRegion
from safety_harness.extensions.lab.proof.tree import BoxTree
from safety_harness.scenario.typed_json import of_format, read_json

FORMAT = "safety-harness certificate 1"
MOST_NODES = 2**28
KINDS = {
    ClaimKind.AT_MOST: "at most",
    ClaimKind.AT_LEAST: "at least",
    ClaimKind.OPTIMUM: "optimum",
    ClaimKind.AWAY: "away",
    ClaimKind.UNSURE: "unsure",
}


def outward(shares: tuple[float, float, float]) -> tuple[str, str, str]:
    """Return proven (at least), refuted and undecided (at most) in per cent, each rounded outwards."""
    proven, *rest = (1e6 * share for share in shares)
    refuted, undecided = (f"{ceil(share) / 1e4:.4f}%" for share in rest)
    return f"{floor(proven) / 1e4:.4f}%", refuted, undecided


NO_PAIR = "no pair"


@dataclass(frozen=True)
class WrongQuestion:
    """A question in the base frame [m] that the network answers against the claim."""

    hand_in_base_m: Vector3
    tcp_in_base_m: Vector3


@dataclass(frozen=True, eq=False)
class Proof:
    """How far a claim is: its tree, and a question that the network answers wrongly, if one was found."""

    planned: PlannedProof
    tree: BoxTree
    question: WrongQuestion | None = None

    @property
    def least_shares(self) -> tuple[float, float, float]:
        """Proven, refuted and undecided, of what the claim is about: the first at least, the last at most.

        A box is proven, or undecided, whole, also where some of its pairs are not ``apart_m`` apart.
        """
        shares, whole = self.tree.shares(), self.planned.region.counted_share
        if not whole > 0.0:
            return 0.0, 0.0, 0.0
        refuted = shares["refuted"] / whole
        undecided = min(shares["undecided"] / whole, max(0.0, 1.0 - refuted))
        return max(0.0, 1.0 - refuted - undecided), refuted, undecided

    @property
    def is_open(self) -> bool:
        """Is there a question of the region that is refuted or undecided?"""
        return self.verdict not in ("proven", NO_PAIR)

    @property
    def verdict(self) -> str:
        """``refuted`` with a question; ``proven`` where no box is undecided; else ``undecided``.

        ``no pair``: the region has no question, so that nothing is claimed.
        """
        if not self.planned.region.has_pair:
            return NO_PAIR
        shares = self.tree.shares()
        if self.question is not None:
            return "refuted"
        whole = shares["proven"] > 0.0 and shares["undecided"] == shares["refuted"] == 0.0
        return "proven" if whole else "undecided"


def model_hash(plan: ProofPlan) -> str:
    """SHA-256 of the network's file."""
    return hashlib.sha256(plan.model_file.read_bytes()).hexdigest()


def write_certificate(path: Path, plan: ProofPlan, proofs: list[Proof]) -> dict[str, Any]:
    """Write it whole or not at all, and return what was written; OutputError where it cannot be."""
    claims = [
        _identity(proof.planned)
        | {
            "verdict": proof.verdict,
            "shares": proof.tree.shares(),
            "question": asdict(proof.question) if proof.question else None,
            "tree": base64.b64encode(zlib.compress(np.concatenate(proof.tree.levels).tobytes())).decode(),
        }
        for proof in proofs
    ]
    found = {
        "format": FORMAT,
        "proof": plan.title,
        "avoider": plan.avoider,
        "model_sha256": model_hash(plan),
        "claims": claims,
    }
    write_text(path, json.dumps(found, indent=1) + "\n")
    return found


def _identity(planned: PlannedProof) -> dict[str, Any]:
    region = asdict(planned.region)
    return {
        "claim": planned.claim.sentence,
        "kind": KINDS[planned.claim.kind],
        "limit_m": planned.claim.limit_m,
        "region": json.loads(json.dumps(region)),
    }


def taken_up(path: Path, plan: ProofPlan) -> list[Proof]:
    """The proofs of a certificate, to go on with; InputError if it is of another plan or network."""
    found = of_format(read_json(path, "a certificate of prove"), FORMAT, path)
    claims = found.get("claims")
    same = (
        found.get("model_sha256") == model_hash(plan)
        and isinstance(claims, list)
        and len(claims) == len(plan.proofs)
        and all(
            isinstance(one, dict) and _identity(planned).items() <= one.items()
            for one, planned in zip(claims, plan.proofs, strict=True)
        )
    )
    if not same or not isinstance(claims, list):
        raise InputError.of_file(path, "a certificate of this plan and network", "one of others")
    return [_proof(one, planned, path) for one, planned in zip(claims, plan.proofs, strict=True)]


def read_proofs(found: Mapping[str, Any], path: Path) -> list[Proof]:
    """All proofs of a certificate that was confirmed; InputError for a field that is none."""
    try:
        return [_proof(one, _planned(one), path) for one in found["claims"]]
    except (KeyError, IndexError, TypeError, ValueError):
        raise InputError.of_file(path, "a certificate of prove", "fields that are none") from None


def _planned(one: Mapping[str, Any]) -> PlannedProof:
    kinds = {name: kind for kind, name in KINDS.items()}
    region: dict[str, Any] = {
        key: tuple(map(float, value)) for key, value in one["region"].items() if key != "name"
    }
    claim = DecisionClaim(kinds[one["kind"]], float(one["limit_m"]))
    return PlannedProof(claim, ProofRegion(name=str(one["region"]["name"]), **region))


def _proof(one: Mapping[str, Any], planned: PlannedProof, path: Path) -> Proof:
    levels, count = [], 1
    try:
        packed = base64.b64decode(one["tree"], validate=True)
        codes = np.frombuffer(zlib.decompressobj().decompress(packed, MOST_NODES), np.uint8).copy()
        while count:
            level, codes = codes[:count], codes[count:]
            if len(level) < count or level.max() > OUTSIDE:
                raise ValueError("cut")
            levels.append(level)
            count = 2 * int((level < PROVEN).sum())
        asked = one["question"]
        question = None
        if asked is not None:
            hand, tcp = (tuple(map(float, asked[key])) for key in ("hand_in_base_m", "tcp_in_base_m"))
            question = WrongQuestion((hand[0], hand[1], hand[2]), (tcp[0], tcp[1], tcp[2]))
    except (KeyError, IndexError, TypeError, ValueError, zlib.error, binascii.Error):
        place = Place(file=path, field=f"claims: {planned.sentence}")
        raise InputError(place=place, expected="a tree of codes", got="something else") from None
    return Proof(planned, BoxTree(levels), question)
