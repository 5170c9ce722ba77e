"""The seal of a report: one hash over the root of its rows, its declaration and all of its files.

Lodged where nobody can change it, it shows that none of them was altered since.  Without it whoever alters a
row can make every hash in the report anew.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from safety_harness.campaign.ledger import Ledger
from safety_harness.campaign.session import LEDGER
from safety_harness.campaign.summary import root_of
from safety_harness.certification.declaration import Lodged, write_once
from safety_harness.certification.document import read_evidence
from safety_harness.certification.folder import JSON, MANIFEST, sha256_of
from safety_harness.scenario.typed_json import of_format, read_json, typed

FORMAT = "safety-harness seal 1"
SUFFIX = ".seal.json"


@dataclass(frozen=True)
class Seal(Lodged):
    """The root over the rows, the declaration (empty: none), the manifest with the hash of every file."""

    rows: str
    declaration: str
    manifest: str

    @property
    def as_json(self) -> str:
        """One text for one content."""
        return json.dumps({"format": FORMAT} | asdict(self), indent=1) + "\n"

    def changes(self, now: Seal) -> Iterator[str]:
        """What is otherwise now, in words."""
        for name, then in asdict(self).items():
            if then != getattr(now, name):
                yield f"the {name} is another than was sealed"


def seal_of(folder: Path, ledger: Ledger) -> Seal:
    """Of a report as it is now."""
    declaration = read_evidence(folder / JSON).record.declaration_sha256
    return Seal(root_of(ledger), declaration, sha256_of(folder / MANIFEST))


def beside(folder: Path) -> Path:
    """Where the seal of a report lies: in the folder it would be a file that it does not cover."""
    whole = folder.resolve()
    return whole.with_name(whole.name + SUFFIX)


def write_seal(folder: Path) -> Seal:
    """Beside the folder; InputError if another one is there, which was perhaps lodged."""
    with Ledger.open(folder / LEDGER, alone=True) as ledger:
        made = seal_of(folder, ledger)
    expected = "no file there yet, or the seal of this very report"
    return write_once(made, beside(folder), read_seal, expected=expected)


def read_seal(file: Path) -> Seal:
    """InputError for what ``certify seal`` did not write."""
    return typed(of_format(read_json(file, FORMAT), FORMAT, file), Seal, file, others=True)
