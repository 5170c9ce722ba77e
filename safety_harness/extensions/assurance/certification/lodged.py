"""The hashes that an author lodges with a third party.

An author lodges the declaration of a plan before its runs, and the seal of the report after the runs.
``certify declare`` writes a declaration. A declaration lists by name the parts that the runs depend on: plan,
seed, avoider, targets and software.

Lodge the hash of the declaration at a place where its date cannot change. If a report's ledger gives the same
hash, the author declared the plan on that date or earlier. Because runs repeat exactly, the hash cannot show
that the author had never made the same runs before. A reader who doubts this can choose the seed.

A seal is one hash over the root of a report's rows, its declaration and all of its files. Lodge the seal at a
place where it cannot change. A lodged seal shows that no file has changed since the seal was lodged. Without
a lodged seal, a person who alters a row can compute all hashes of the report again.
"""

from __future__ import annotations

import hashlib
import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TypeVar

from safety_harness.base.exceptions import InputError, OutputError, Place
from safety_harness.base.shipped.contents import is_installed, located, shipped_name
from safety_harness.base.whole_file import sha256_of, write_whole
from safety_harness.extensions.assurance.campaign.identity import Identity
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.plan import Plan
from safety_harness.extensions.assurance.campaign.session import LEDGER
from safety_harness.extensions.assurance.campaign.summary import root_of
from safety_harness.extensions.assurance.certification.evidence import read_evidence
from safety_harness.extensions.assurance.certification.folder import JSON, MANIFEST
from safety_harness.scenario.typed_json import of_format, read_json, typed


class Lodged(ABC):
    """Content that has only one possible text form, with the hash of this text."""

    @property
    @abstractmethod
    def as_json(self) -> str:
        """The JSON text of this content. Equal content always has the same text."""

    @property
    def sha256(self) -> str:
        """The hash to lodge."""
        return hashlib.sha256(self.as_json.encode()).hexdigest()


L = TypeVar("L", "PlanDeclaration", "Seal")


def write_once(made: L, file: Path, read: Callable[[Path], L], *, expected: str) -> L:
    """Write ``made`` to ``file``, unless the file exists with other content.

    Args:
        made: The declaration or the seal.
        file: The file.
        read: A function that reads an existing file.
        expected: The description of the expected file in the error.

    Returns:
        ``made``.

    Raises:
        InputError: The file has other content, which may be lodged already.
        OutputError: The file cannot be written.

    """
    if file.exists() and (there := read(file)) != made:
        raise InputError(
            place=Place(file=file),
            expected=expected,
            got="; ".join(there.changes(made)),
            hint="it may be lodged already: move it away to begin anew",
        )
    try:
        write_whole(file, made.as_json)
    except OSError as error:
        raise OutputError.from_os_error(file, error) from error
    return made


DECLARATION_FORMAT = "safety-harness declaration 1"


@dataclass(frozen=True)
class PlanDeclaration(Lodged):
    """The declaration of a plan.

    ``parts`` maps the name of each declared part to its value.
    """

    parts: dict[str, Any]

    @property
    def as_json(self) -> str:
        """The JSON text of this content, with sorted keys. Equal content always has the same text."""
        document = {"format": DECLARATION_FORMAT, "declared": self.parts}
        return json.dumps(document, indent=1, sort_keys=True, ensure_ascii=True) + "\n"

    def changes(self, now: PlanDeclaration) -> Iterator[str]:
        """Yield a text for each difference between this declaration and ``now``."""
        for name in sorted(self.parts.keys() | now.parts.keys()):
            then, new = (side.parts.get(name, "nothing") for side in (self, now))
            if then != new:
                yield f"{name}: {_short(then)} was declared, and it is {_short(new)} now"


def declaration_of(plan: Plan, identity: Identity | None = None) -> PlanDeclaration:
    """Return the declaration of ``plan``, for the present software or for the ``identity`` of a ledger."""
    parts: dict[str, Any] = {
        "plan": plan.title,
        "avoider": plan.avoider or "what the spaces name",
        "world": plan.world.label,
        "seed": plan.seed,
        "confidence": plan.confidence,
        "stop early": plan.stop_early,
        "search": plan.search_runs,
        "traces kept": [plan.random_traces, plan.violations_kept],
    }
    for stratum in plan.strata:
        parts[f"runs of the stratum {stratum.name!r}"] = stratum.runs
    for claim in plan.claims:
        parts[f"target of {claim.sentence!r}"] = "none" if claim.target is None else claim.target
    return PlanDeclaration(parts | dict((identity or plan.identity).parts))


def declaration_file(plan: Path) -> Path:
    """Return the default file for a plan's declaration, which lies beside the plan.

    For a plan that ships with an installed package, the file lies in the working directory.
    """
    beside = located(plan).with_suffix(".declared.json")
    return Path(beside.name) if is_installed() and shipped_name(located(plan)) else beside


def write_declaration(plan: Plan, file: Path) -> PlanDeclaration:
    """Write the declaration of ``plan`` to ``file``.

    Raises:
        InputError: The file has another declaration, which may be lodged already.
        OutputError: The file cannot be written.

    """
    expected = "no file there yet, or this very declaration"
    return write_once(declaration_of(plan), file, read_declaration, expected=expected)


def read_declaration(file: Path) -> PlanDeclaration:
    """Read a declaration that ``certify declare`` wrote.

    Raises:
        InputError: The file is no declaration.

    """
    document = of_format(read_json(file, DECLARATION_FORMAT), DECLARATION_FORMAT, file)
    return PlanDeclaration(typed(document.get("declared"), dict[str, Any], file, where="declared"))


def declared_sha256(plan: Plan, file: Path | None) -> str:
    """Return the hash of the plan's declaration, or an empty string if there is no declaration.

    Args:
        plan: The plan.
        file: The declaration. The default is the file beside the plan, if it exists.

    Raises:
        InputError: The plan or the software differs from the declaration. The error lists the differences.

    """
    path = file or declaration_file(plan.file)
    if file is None and not path.exists():
        return ""
    then, now = read_declaration(path), declaration_of(plan)
    changes = list(then.changes(now))
    if changes:
        raise InputError(
            place=Place(file=path),
            expected="the plan, seed, avoider, targets and software that it declares",
            got="; ".join(changes),
            hint="restore them, or move it away: the report then states that it has no declaration",
        )
    return now.sha256


def _short(value: Any) -> str:
    text = str(value)
    return text if len(text) <= 40 else f"{text[:12]}..."


SEAL_FORMAT = "safety-harness seal 1"


@dataclass(frozen=True)
class Seal(Lodged):
    """The root hash over the rows, the declaration's hash, and the manifest's hash.

    The declaration's hash is empty if the plan was not declared.
    """

    rows: str
    declaration: str
    manifest: str

    @property
    def as_json(self) -> str:
        """The JSON text of this content. Equal content always has the same text."""
        return json.dumps({"format": SEAL_FORMAT} | asdict(self), indent=1) + "\n"

    def changes(self, now: Seal) -> Iterator[str]:
        """Yield a text for each difference between this seal and ``now``."""
        for name, then in asdict(self).items():
            if then != getattr(now, name):
                yield f"the {name} changed after the seal"


def seal_of(folder: Path, ledger: Ledger) -> Seal:
    """Return the seal of the report in ``folder`` in its present state.

    ``ledger`` is the open ledger of the report.
    """
    declaration = read_evidence(folder / JSON).record.declaration_sha256
    return Seal(root_of(ledger), declaration, sha256_of(folder / MANIFEST))


def seal_file(folder: Path) -> Path:
    """Return the file for the seal of a report, which lies beside the report's ``folder``.

    If the file were in that folder, the seal could not cover the file.
    """
    whole = folder.resolve()
    return whole.with_name(whole.name + ".seal.json")


def write_seal(folder: Path) -> Seal:
    """Write the seal of the report in ``folder`` to a file beside the folder.

    Raises:
        InputError: The file has another seal, which may be lodged already.
        OutputError: The file cannot be written.

    """
    with Ledger.open(folder / LEDGER, alone=True) as ledger:
        made = seal_of(folder, ledger)
    expected = "no file there yet, or the seal of this very report"
    return write_once(made, seal_file(folder), read_seal, expected=expected)


def read_seal(file: Path) -> Seal:
    """Read a seal that ``certify seal`` wrote.

    Raises:
        InputError: The file is no seal.

    """
    return typed(of_format(read_json(file, SEAL_FORMAT), SEAL_FORMAT, file), Seal, file, further_fields=True)
