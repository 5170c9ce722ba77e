"""The proofs about the avoider's network, which a report shows beside the results of runs.

A proof consists of a certificate and its check. The certificate and the network are files in the report's
folder. The report quotes the independent checker (``extensions.lab.proof.check``).
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
    """The bytes of a certificate and of its network."""

    certificate: bytes
    network: bytes

    def write(self, folder: Path) -> None:
        """Write the certificate and the network into a report's ``folder``.

        Raises:
            OutputError: A file cannot be written.

        """
        for name, data in ((CERTIFICATE, self.certificate), (NETWORK, self.network)):
            try:
                with replacing(folder / name) as part:
                    part.write_bytes(data)
            except OSError as error:
                raise OutputError.from_os_error(folder / name, error) from error


def read_certified(file: Path, plan: Plan) -> CertifiedNetwork:
    """Read a certificate that ``prove`` wrote about a network of the plan's avoiders.

    Raises:
        InputError: The file is no certificate, has another network, or the checker does not confirm it.

    """
    networks = {hashlib.sha256(data).hexdigest(): data for data in networks_of(plan)}
    data = _bytes(file)
    document = of_format(
        parsed(data.decode("utf-8", "replace"), file, "a certificate", InputError), FORMAT, file
    )
    sha256 = document.get("model_sha256")
    if not isinstance(sha256, str) or sha256 not in networks:
        expected = "a certificate of the network of the plan's avoider"
        raise InputError(place=Place(file=file), expected=expected, got=f"one of {str(sha256)[:16]}")
    certified = CertifiedNetwork(data, networks[sha256])
    evidence_of(certified, file)
    return certified


def networks_of(plan: Plan) -> list[bytes]:
    """Return the contents of the network files that the avoiders of the plan's strata use."""
    scenarios = (plan.with_avoider(stratum.space.simplest) for stratum in plan.strata)
    files = dict.fromkeys(map(network_file_of, scenarios))
    return [_bytes(file) for file in files if file is not None]


def stored_proof(folder: Path, plan: Plan) -> CertifiedProofs | None:
    """Check the certificate in a report's ``folder`` again, and compare its regions with the plan's gates.

    Returns:
        The confirmed proofs, or None without a certificate.

    Raises:
        InputError: The checker does not confirm the certificate.

    """
    if not (folder / FOLDER).exists():
        return None
    certified = CertifiedNetwork(*(_bytes(folder / name) for name in (CERTIFICATE, NETWORK)))
    proofs, regions = evidence_of(certified, folder / CERTIFICATE)
    claims = (
        replace(claim, gates=gate_words(plan, proofs.network_sha256, region))
        for claim, region in zip(proofs.claims, regions, strict=True)
    )
    return replace(proofs, claims=tuple(claims))


def without_proof(folder: Path) -> None:
    """Remove the certificate of an earlier report from ``folder``."""
    shutil.rmtree(folder / FOLDER, ignore_errors=True)


@lru_cache(maxsize=2)
def evidence_of(certified: CertifiedNetwork, file: Path) -> tuple[CertifiedProofs, tuple[ProofRegion, ...]]:
    """Check the certificate in ``certified``, and return its claims and the region of each claim.

    The errors state ``file``, which is the source of the certificate.

    Raises:
        InputError: The checker does not confirm the certificate.

    """
    try:
        lines = check(certified.certificate, certified.network)
    except Exception as error:  # a stranger's certificate may make the checker raise anything
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
