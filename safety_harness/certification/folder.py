"""The folder of a report: the page, JSON, JUnit XML, the plan's files, the ledger, and hashes of them all."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

from safety_harness.campaign.files import unpacked
from safety_harness.campaign.ledger import Ledger
from safety_harness.campaign.session import LEDGER
from safety_harness.certification.document import as_text
from safety_harness.certification.evidence import Evidence, StoredFile
from safety_harness.certification.junit import junit_xml
from safety_harness.certification.page import write_page
from safety_harness.exceptions import InputError, OutputError, Place
from safety_harness.report.evidence import JudgedRun
from safety_harness.scenario.files import refuse_no_file
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
LARGEST_MANIFEST_BYTES = 16 * 2**20


def write_folder(folder: Path, evidence: Evidence, runs: Mapping[int, JudgedRun], ledger: Ledger) -> Evidence:
    """Write all but the PDF and the manifest; the evidence with the hashes of the files beside it.

    OutputError for what cannot be written.
    """
    try:
        unpacked(ledger.files, folder / PLAN)
        evidence = replace(evidence, files=tuple(_files(folder)))
        write_whole(folder / JSON, as_text(evidence))
        write_whole(folder / JUNIT, junit_xml(evidence))
        write_page(folder / PAGE, evidence, runs)
    except OSError as error:
        raise OutputError.of(folder, error) from error
    return evidence


def write_manifest(folder: Path) -> None:
    """Hashes of everything, last of all: the ledger has to be closed."""
    made = (folder / name for name in MADE)
    hashes = {file.name: sha256_of(file) for file in made if file.is_file()}
    hashes |= {stored.path: stored.sha256 for stored in _files(folder)}
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
    try:
        with file.open("rb") as stream:
            found = json.loads(stream.read(LARGEST_MANIFEST_BYTES))
        if found["format"] != FORMAT:
            raise ValueError(f"format {found['format']!r}")
        hashes = {str(name): str(digest) for name, digest in found["sha256"].items()}
    except OSError as error:
        expected = "the folder of a report that certify wrote"
        raise InputError(place=place, expected=expected, got=error.strerror or "none") from error
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise InputError(place=place, expected=FORMAT, got=f"{error}"[:120]) from error
    for name in hashes:
        path = (folder / name).resolve()
        if folder.resolve() not in path.parents:
            raise InputError(place=place, expected="files below the report's folder", got=repr(name)[:120])
    return hashes


def sha256_of(file: Path) -> str:
    """Of the file's bytes, read piece by piece."""
    with file.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _files(folder: Path) -> Iterator[StoredFile]:
    """Everything but the page and its like, the manifest, and what comes and goes with the ledger."""
    passing = {f"{LEDGER}{suffix}" for suffix in ("-wal", "-shm", ".lock")}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.is_file() and name not in (*MADE, MANIFEST, *passing) and not path.name.startswith("."):
            yield StoredFile(path=name, sha256=sha256_of(path), bytes=path.stat().st_size)
