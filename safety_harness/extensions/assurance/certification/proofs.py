"""What is proven about the avoider's network, beside what runs have shown: a certificate and its check.

The certificate and the network lie in the report's folder.  What is told of them is what the independent
checker (``extensions.lab.proof.check``) confirms, in its own words.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

from safety_harness.base.exceptions import InputError, OutputError, Place
from safety_harness.base.whole_file import replacing
from safety_harness.cell.avoidance.shipped import network_file_of
from safety_harness.extensions.assurance.campaign.plan import Plan
from safety_harness.extensions.assurance.certification.evidence import CertifiedClaim, CertifiedProofs
from safety_harness.extensions.assurance.certification.gated import gate_words
from safety_harness.extensions.lab.proof.certificate import FORMAT, read_proofs
from safety_harness.extensions.lab.proof.check import check
from safety_harness.extensions.lab.proof.maps import maps_of
from safety_harness.extensions.lab.proof.plan import ProofRegion
from safety_harness.scenario.files import read_bytes
from safety_harness.scenario.typed_json import LARGEST_BYTES, of_format, parsed

FOLDER = "proof"
CERTIFICATE, NETWORK = f"{FOLDER}/certificate.json", f"{FOLDER}/network.safetensors"


@dataclass(frozen=True)
class CertifiedNetwork:
    """A certificate and its network as files, read whole."""

    certificate: bytes
    network: bytes

    def write(self, folder: Path) -> None:
        """Into the folder of a report; raises OutputError."""
        for name, data in ((CERTIFICATE, self.certificate), (NETWORK, self.network)):
            try:
                with replacing(folder / name) as part:
                    part.write_bytes(data)
            except OSError as error:
                raise OutputError.of(folder / name, error) from error


def read_certified(file: Path, plan: Plan) -> CertifiedNetwork:
    """A certificate of ``prove`` about the network of the plan's avoider.

    InputError if it is none, is of another network, or says what its checker does not confirm.
    """
    networks = {hashlib.sha256(data).hexdigest(): data for data in networks_of(plan)}
    data = _bytes(file)
    found = of_format(
        parsed(data.decode("utf-8", "replace"), file, "a certificate", InputError), FORMAT, file
    )
    sha256 = found.get("model_sha256")
    if not isinstance(sha256, str) or sha256 not in networks:
        expected = "a certificate of the network of the plan's avoider"
        raise InputError(place=Place(file=file), expected=expected, got=f"one of {str(sha256)[:16]}")
    certified = CertifiedNetwork(data, networks[sha256])
    evidence_of(certified, file)
    return certified


def networks_of(plan: Plan) -> list[bytes]:
    """The files of the networks that the plan's strata ask."""
    scenarios = (plan.with_avoider(stratum.space.simplest) for stratum in plan.strata)
    files = dict.fromkeys(map(network_file_of, scenarios))
    return [_bytes(file) for file in files if file is not None]


def stored_proof(folder: Path, plan: Plan) -> CertifiedProofs | None:
    """That of a report's folder, confirmed again, beside the plan's gates; None for none.

    InputError if it does not hold.
    """
    if not (folder / FOLDER).exists():
        return None
    certified = CertifiedNetwork(*(_bytes(folder / name) for name in (CERTIFICATE, NETWORK)))
    found, regions = evidence_of(certified, folder / CERTIFICATE)
    claims = (
        replace(one, gates=gate_words(plan, found.network_sha256, region))
        for one, region in zip(found.claims, regions, strict=True)
    )
    return replace(found, claims=tuple(claims))


def without_proof(folder: Path) -> None:
    """An earlier report's is taken away."""
    shutil.rmtree(folder / FOLDER, ignore_errors=True)


@lru_cache(maxsize=2)
def evidence_of(certified: CertifiedNetwork, file: Path) -> tuple[CertifiedProofs, tuple[ProofRegion, ...]]:
    """With each claim's region; InputError for whatever is not confirmed; ``file`` is where it came from."""
    try:
        lines = check(certified.certificate, certified.network)
    except Exception as error:  # whatever a stranger's certificate makes of the checker
        got = f"{type(error).__name__}: {error}"
        expected = "a certificate that the checker confirms"
        raise InputError(place=Place(file=file), expected=expected, got=got) from None
    proofs = read_proofs(json.loads(certified.certificate), file)
    claims = (
        CertifiedClaim(
            claim=proof.planned.claim.sentence,
            region=proof.planned.region.name,
            verdict=proof.verdict,
            confirmed=line,
            maps=() if not proof.is_open else tuple(maps_of(proof)),
            gates=(),
        )
        for proof, line in zip(proofs, lines, strict=True)
    )
    sha256 = hashlib.sha256(certified.network).hexdigest()
    regions = tuple(proof.planned.region for proof in proofs)
    return CertifiedProofs(network_sha256=sha256, claims=tuple(claims)), regions


def _bytes(file: Path) -> bytes:
    return read_bytes(file, most=LARGEST_BYTES, place=Place(file=file), error=InputError)
