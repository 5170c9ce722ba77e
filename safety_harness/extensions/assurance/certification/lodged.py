"""What is lodged elsewhere by its hash: the declaration of a plan before its runs, the seal of its report.

A declaration, which ``certify declare`` writes, holds plan, seed, avoider, targets and software, by name.

Its hash is to be lodged where its day cannot be changed.  A report whose ledger gives the same hash was
declared on that day at the latest; that nobody had made the same runs before, no hash can show: they repeat
themselves.  So whoever doubts names the seed.

A seal is one hash over the root of a report's rows, its declaration and all of its files.  Lodged where
nobody can change it, it shows that none of them was altered since.  Without it whoever alters a row can make
every hash in the report anew.
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
    """One text for one content, and the hash of it."""

    @property
    @abstractmethod
    def as_json(self) -> str:
        """The text."""

    @property
    def sha256(self) -> str:
        """What is lodged."""
        return hashlib.sha256(self.as_json.encode()).hexdigest()


L = TypeVar("L", "PlanDeclaration", "Seal")


def write_once(made: L, file: Path, read: Callable[[Path], L], *, expected: str) -> L:
    """Write ``made``; InputError if ``file`` has something else, as ``read`` has it: it may be lodged."""
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
        raise OutputError.of(file, error) from error
    return made


DECLARATION_FORMAT = "safety-harness declaration 1"


@dataclass(frozen=True)
class PlanDeclaration(Lodged):
    """Everything that was declared, by name, and the hash of it all."""

    parts: dict[str, Any]

    @property
    def as_json(self) -> str:
        """One text for one content."""
        found = {"format": DECLARATION_FORMAT, "declared": self.parts}
        return json.dumps(found, indent=1, sort_keys=True, ensure_ascii=True) + "\n"

    def changes(self, now: PlanDeclaration) -> Iterator[str]:
        """What is otherwise now, in words."""
        for name in sorted(self.parts.keys() | now.parts.keys()):
            then, new = (one.parts.get(name, "nothing") for one in (self, now))
            if then != new:
                yield f"{name}: {_short(then)} was declared, and it is {_short(new)} now"


def declaration_of(plan: Plan, identity: Identity | None = None) -> PlanDeclaration:
    """Of a plan with the software that is here, or with the ``identity`` that a ledger was begun with."""
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
    """Where the declaration of a plan lies if nobody says otherwise; never where we are installed."""
    beside = located(plan).with_suffix(".declared.json")
    return Path(beside.name) if is_installed() and shipped_name(located(plan)) else beside


def write_declaration(plan: Plan, file: Path) -> PlanDeclaration:
    """Beside the plan, or wherever; InputError if another one is there, which was perhaps lodged."""
    expected = "no file there yet, or this very declaration"
    return write_once(declaration_of(plan), file, read_declaration, expected=expected)


def read_declaration(file: Path) -> PlanDeclaration:
    """InputError for what ``certify declare`` did not write."""
    found = of_format(read_json(file, DECLARATION_FORMAT), DECLARATION_FORMAT, file)
    return PlanDeclaration(typed(found.get("declared"), dict[str, Any], file, where="declared"))


def declared_sha256(plan: Plan, file: Path | None) -> str:
    """Of the declaration in ``file``, or beside the plan; empty if none is there.

    InputError that names what is not as it was declared.
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
            hint="put them back, or move it away: the report says then that nothing was declared",
        )
    return now.sha256


def _short(value: Any) -> str:
    text = str(value)
    return text if len(text) <= 40 else f"{text[:12]}..."


SEAL_FORMAT = "safety-harness seal 1"


@dataclass(frozen=True)
class Seal(Lodged):
    """The root over the rows, the declaration (empty: none), the manifest with the hash of every file."""

    rows: str
    declaration: str
    manifest: str

    @property
    def as_json(self) -> str:
        """One text for one content."""
        return json.dumps({"format": SEAL_FORMAT} | asdict(self), indent=1) + "\n"

    def changes(self, now: Seal) -> Iterator[str]:
        """What is otherwise now, in words."""
        for name, then in asdict(self).items():
            if then != getattr(now, name):
                yield f"the {name} is another than was sealed"


def seal_of(folder: Path, ledger: Ledger) -> Seal:
    """Of a report as it is now."""
    declaration = read_evidence(folder / JSON).record.declaration_sha256
    return Seal(root_of(ledger), declaration, sha256_of(folder / MANIFEST))


def seal_file(folder: Path) -> Path:
    """Where the seal of a report lies: in the folder it would be a file that it does not cover."""
    whole = folder.resolve()
    return whole.with_name(whole.name + ".seal.json")


def write_seal(folder: Path) -> Seal:
    """Beside the folder; InputError if another one is there, which was perhaps lodged."""
    with Ledger.open(folder / LEDGER, alone=True) as ledger:
        made = seal_of(folder, ledger)
    expected = "no file there yet, or the seal of this very report"
    return write_once(made, seal_file(folder), read_seal, expected=expected)


def read_seal(file: Path) -> Seal:
    """InputError for what ``certify seal`` did not write."""
    return typed(of_format(read_json(file, SEAL_FORMAT), SEAL_FORMAT, file), Seal, file, others=True)
