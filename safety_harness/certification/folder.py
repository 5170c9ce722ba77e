"""The folder of a report: the page, JSON, JUnit XML, the plan's files, the ledger, and hashes of them all."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

from safety_harness.campaign.identity import unpacked
from safety_harness.campaign.ledger import Ledger
from safety_harness.campaign.session import LEDGER
from safety_harness.certification.counterexamples import write_traces
from safety_harness.certification.document import as_text
from safety_harness.certification.evidence import Evidence, StoredFile
from safety_harness.certification.gather import GatheredEvidence
from safety_harness.certification.junit import junit_xml
from safety_harness.certification.page import write_page
from safety_harness.exceptions import InputError, OutputError, Place
from safety_harness.scenario.files import refuse_no_file, resolved
from safety_harness.scenario.typed_json import of_format, read_json, typed
from safety_harness.whole_file import write_whole

PAGE, JSON, JUNIT, PDF, MANIFEST, PLAN = (
    "evidence.html",
    "evidence.json",
    "junit.xml",
    "evidence.pdf",
    "manifest.json",
    "plan",
)
FORMAT = "safety-harness manifest 1"
MADE = (PAGE, JSON, JUNIT, PDF)
LOG = f"{LEDGER}-wal"
PASSING = (LOG, f"{LEDGER}-shm", f"{LEDGER}.lock")
LARGEST_MANIFEST_BYTES = 16 * 2**20


def write_folder(folder: Path, gathered: GatheredEvidence, ledger: Ledger) -> Evidence:
    """Write all but the PDF and the manifest; the evidence with the hashes of the files beside it.

    What an earlier report left there is taken away.  OutputError for what cannot be written.
    """
    try:
        _clear(folder)
        unpacked(ledger.files, folder / PLAN)
        write_traces(gathered.examples, folder)
        evidence = replace(gathered.evidence, files=tuple(stored_files(folder)))
        write_whole(folder / JSON, as_text(evidence))
        write_whole(folder / JUNIT, junit_xml(evidence))
        write_page(folder / PAGE, evidence, gathered.runs)
    except OSError as error:
        raise OutputError.of(folder, error) from error
    return evidence


def _clear(folder: Path) -> None:
    """The PDF of an earlier page, and the copies of its plan that are not this one's any more."""
    try:
        earlier = read_manifest(folder)
    except InputError:
        earlier = {}
    (folder / PDF).unlink(missing_ok=True)
    (folder / MANIFEST).unlink(missing_ok=True)
    for name in earlier:
        if name.startswith(f"{PLAN}/"):
            (folder / name).unlink(missing_ok=True)


def write_manifest(folder: Path, files: Iterable[StoredFile]) -> None:
    """Hashes of everything, last of all: the ledger has to be closed.  ``files`` are hashed already."""
    made = (folder / name for name in MADE)
    hashes = {file.name: sha256_of(file) for file in made if file.is_file()}
    hashes |= {stored.path: stored.sha256 for stored in files}
    text = json.dumps({"format": FORMAT, "sha256": dict(sorted(hashes.items()))}, indent=1)
    try:
        write_whole(folder / MANIFEST, text + "\n")
    except OSError as error:
        raise OutputError.of(folder / MANIFEST, error) from error


def read_manifest(folder: Path) -> dict[str, str]:
    """Path and hash of every file of a report; InputError for what is no report's folder."""
    file = folder / MANIFEST
    place = Place(file=file)
    refuse_no_file(file, "the folder of a report that certify wrote", InputError)
    found = of_format(read_json(file, FORMAT, most=LARGEST_MANIFEST_BYTES), FORMAT, file)
    hashes = typed(found.get("sha256"), dict[str, str], file, where="sha256")
    root = resolved(folder)
    for name in hashes:
        plain = "\0" not in name and ".." not in Path(name).parts and Path(name).as_posix() == name
        if not plain or root not in resolved(folder / name).parents:
            raise InputError(place=place, expected="files below the report's folder", got=repr(name)[:120])
    return hashes


def sha256_of(file: Path) -> str:
    """Of the file's bytes, read piece by piece."""
    with file.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def stored_files(folder: Path) -> Iterator[StoredFile]:
    """What of a report is listed with its hash: all but the page and its like."""
    for name in names_in(folder):
        path = folder / name
        if name not in MADE:
            yield StoredFile(path=name, sha256=sha256_of(path), bytes=path.stat().st_size)


def names_in(folder: Path) -> Iterator[str]:
    """Every file but the manifest, what comes and goes with the ledger, and hidden ones."""
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if name not in (MANIFEST, *PASSING) and not path.name.startswith(".") and path.is_file():
            yield name
