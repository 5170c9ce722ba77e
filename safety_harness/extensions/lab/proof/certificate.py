"""Write and read certificates: JSON with the claims, the network's hash, and the tree that proves each claim.

A certificate contains the codes of a tree, level by level, with one byte for each code.  The bytes are
compressed and encoded in base64.  The independent program ``check.py`` reads the same file.
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
MOST_NODES = 2**28  # a limit of the memory for a damaged or forged certificate, the same as in check.py
KINDS = {
    ClaimKind.AT_MOST: "at most",
    ClaimKind.AT_LEAST: "at least",
    ClaimKind.OPTIMUM: "optimum",
    ClaimKind.AWAY: "away",
    ClaimKind.UNSURE: "unsure",
}


def outward(shares: tuple[float, float, float]) -> tuple[str, str, str]:
    """Return the fractions in per cent.

    The function rounds the proven fraction down, and the refuted and undecided fractions up.
    """
    proven, *rest = (1e6 * share for share in shares)
    refuted, undecided = (f"{ceil(share) / 1e4:.4f}%" for share in rest)
    return f"{floor(proven) / 1e4:.4f}%", refuted, undecided


NO_PAIR = "no pair"


@dataclass(frozen=True)
class WrongQuestion:
    """An input for which the network's answer violates the claim; positions are in the base frame [m]."""

    hand_in_base_m: Vector3
    tcp_in_base_m: Vector3


@dataclass(frozen=True, eq=False)
class Proof:
    """The current state of the proof of a claim.

    ``question`` is an input that the network answers wrongly, or None if no such input is known.
    """

    planned: PlannedProof
    tree: BoxTree
    question: WrongQuestion | None = None

    @property
    def least_shares(self) -> tuple[float, float, float]:
        """Bounds of the proven, refuted and undecided fractions of the claimed region.

        The first number is a lower bound of the proven fraction.  The other two numbers are upper bounds of
        the refuted and undecided fractions.

        They include the whole volume of an undecided box, even if some of its pairs do not satisfy
        ``apart_m``.
        """
        shares, whole = self.tree.shares(), self.planned.region.counted_share
        if not whole > 0.0:
            return 0.0, 0.0, 0.0
        refuted = shares["refuted"] / whole
        undecided = min(shares["undecided"] / whole, max(0.0, 1.0 - refuted))
        return max(0.0, 1.0 - refuted - undecided), refuted, undecided

    @property
    def is_open(self) -> bool:
        """Whether the claim is refuted or undecided."""
        return self.verdict not in ("proven", NO_PAIR)

    @property
    def verdict(self) -> str:
        """The verdict on the claim, which is ``no pair`` if the region contains no input.

        If an input is known that violates the claim, the verdict is ``refuted``.  If every box is proven or
        outside the region, the verdict is ``proven``.  In all other cases the verdict is ``undecided``.
        """
        if not self.planned.region.has_pair:
            return NO_PAIR
        shares = self.tree.shares()
        if self.question is not None:
            return "refuted"
        whole = shares["proven"] > 0.0 and shares["undecided"] == shares["refuted"] == 0.0
        return "proven" if whole else "undecided"


def model_hash(plan: ProofPlan) -> str:
    """Return the SHA-256 of the network's file."""
    return hashlib.sha256(plan.model_file.read_bytes()).hexdigest()


def write_certificate(path: Path, plan: ProofPlan, proofs: list[Proof]) -> dict[str, Any]:
    """Write a certificate to a file atomically.

    Args:
        path: The file.
        plan: The plan.
        proofs: The proofs of the plan's claims.

    Returns:
        The certificate as JSON.

    Raises:
        OutputError: The file cannot be written.

    """
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
    content = {
        "format": FORMAT,
        "proof": plan.title,
        "avoider": plan.avoider,
        "model_sha256": model_hash(plan),
        "claims": claims,
    }
    write_text(path, json.dumps(content, indent=1) + "\n")
    return content


def _identity(planned: PlannedProof) -> dict[str, Any]:
    """Return the fields that identify a claim in a certificate."""
    region = asdict(planned.region)
    return {
        "claim": planned.claim.sentence,
        "kind": KINDS[planned.claim.kind],
        "limit_m": planned.claim.limit_m,
        "region": json.loads(json.dumps(region)),
    }


def taken_up(path: Path, plan: ProofPlan) -> list[Proof]:
    """Read the proofs in a certificate, so that ``continue_proofs`` can continue them.

    Args:
        path: The certificate's file.
        plan: The plan to which the certificate must belong.

    Raises:
        InputError: The certificate belongs to another plan or network, or is invalid.

    """
    content = of_format(read_json(path, "a certificate of prove"), FORMAT, path)
    claims = content.get("claims")
    same = (
        content.get("model_sha256") == model_hash(plan)
        and isinstance(claims, list)
        and len(claims) == len(plan.proofs)
        and all(
            isinstance(entry, dict) and _identity(planned).items() <= entry.items()
            for entry, planned in zip(claims, plan.proofs, strict=True)
        )
    )
    if not same or not isinstance(claims, list):
        raise InputError.of_file(path, "a certificate of this plan and network", "one of others")
    return [_proof(entry, planned, path) for entry, planned in zip(claims, plan.proofs, strict=True)]


def read_proofs(content: Mapping[str, Any], path: Path) -> list[Proof]:
    """Return all proofs of a confirmed certificate.

    Args:
        content: The certificate as JSON.
        path: The certificate's file, for error messages.

    Raises:
        InputError: A field is invalid.

    """
    try:
        return [_proof(entry, _planned(entry), path) for entry in content["claims"]]
    except (KeyError, IndexError, TypeError, ValueError):
        raise InputError.of_file(path, "a certificate of prove", "missing or wrong fields") from None


def _planned(entry: Mapping[str, Any]) -> PlannedProof:
    """Return the claim and the region in an entry of a certificate."""
    kinds = {name: kind for kind, name in KINDS.items()}
    region: dict[str, Any] = {
        key: tuple(map(float, value)) for key, value in entry["region"].items() if key != "name"
    }
    claim = DecisionClaim(kinds[entry["kind"]], float(entry["limit_m"]))
    return PlannedProof(claim, ProofRegion(name=str(entry["region"]["name"]), **region))


def _proof(entry: Mapping[str, Any], planned: PlannedProof, path: Path) -> Proof:
    """Return the proof in an entry of a certificate, and raise InputError if the tree is invalid."""
    levels, count = [], 1
    try:
        packed = base64.b64decode(entry["tree"], validate=True)
        codes = np.frombuffer(zlib.decompressobj().decompress(packed, MOST_NODES), np.uint8).copy()
        # Each level has twice as many nodes as the previous level halves, so the counts also detect a cut
        # tree.
        while count:
            level, codes = codes[:count], codes[count:]
            if len(level) < count or level.max() > OUTSIDE:
                raise ValueError("cut")
            levels.append(level)
            count = 2 * int((level < PROVEN).sum())
        stored = entry["question"]
        question = None
        if stored is not None:
            hand, tcp = (tuple(map(float, stored[key])) for key in ("hand_in_base_m", "tcp_in_base_m"))
            question = WrongQuestion((hand[0], hand[1], hand[2]), (tcp[0], tcp[1], tcp[2]))
    except (KeyError, IndexError, TypeError, ValueError, zlib.error, binascii.Error):
        place = Place(file=path, field=f"claims: {planned.sentence}")
        raise InputError(place=place, expected="a tree of codes", got="something else") from None
    return Proof(planned, BoxTree(levels), question)
