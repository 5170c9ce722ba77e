"""The folder of a report: page, JSON, JUnit XML, the plan's files, the ledger, and hashes of all files."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

from safety_harness.base.exceptions import InputError, OutputError, Place
from safety_harness.base.whole_file import sha256_of, write_whole
from safety_harness.extensions.assurance.campaign.identity import unpacked
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.session import LEDGER
from safety_harness.extensions.assurance.certification.argument_files import GSN, NOTES, gsn_text, notes_text
from safety_harness.extensions.assurance.certification.counterexamples import write_traces
from safety_harness.extensions.assurance.certification.evidence import (
    ClaimEvidence,
    ClaimResult,
    ClaimStatus,
    Evidence,
    StoredFile,
    as_text,
)
from safety_harness.extensions.assurance.certification.gather import GatheredEvidence
from safety_harness.extensions.assurance.certification.guard import ReportGuard
from safety_harness.extensions.assurance.certification.page import drawn
from safety_harness.scenario.files import refuse_no_file, resolved
from safety_harness.scenario.kinds import FileKind, refuse_other_kind
from safety_harness.scenario.typed_json import of_format, read_json, typed

PAGE, JSON, JUNIT, PDF = "evidence.html", "evidence.json", "junit.xml", "evidence.pdf"
MANIFEST, PLAN, OPENED = "manifest.json", "plan", "opened"
FORMAT = "safety-harness manifest 1"
MADE = (PAGE, JSON, JUNIT, PDF, GSN, NOTES)
LOG = f"{LEDGER}-wal"
PASSING = (LOG, f"{LEDGER}-shm", f"{LEDGER}.lock")
LARGEST_MANIFEST_BYTES = 2**21  # some 20,000 files
LARGEST_TRACE_BYTES = 2**26
MOST_OPENED_BYTES = 2**26  # of all files that programs opened; above this, a report has only their hashes


def write_folder(folder: Path, gathered: GatheredEvidence, ledger: Ledger) -> Evidence:
    """Write a report's folder, except its PDF and manifest.

    The function first removes the PDF, the manifest and the copies of an earlier report.

    Args:
        folder: The folder of the report, with its ledger.
        gathered: The evidence and its counterexamples.
        ledger: The open ledger.

    Returns:
        The evidence with the hashes of the files, and with a finding for each part that could not be written.

    Raises:
        OutputError: A file cannot be written.

    """
    try:
        _clear(folder)
        guard = ReportGuard()
        # The copies come first, because the evidence lists their hashes.
        guard.run("the copy of the plan", lambda: unpacked(ledger.files, folder / PLAN), Path())
        guard.run("the copies of opened files", lambda: _pack_opened(folder / OPENED, ledger), None)
        guard.run("the copies of traces", lambda: write_traces(gathered.examples, folder), None)
        evidence = replace(gathered.evidence, files=tuple(stored_files(folder)))
        texts = guard.run("the files of the argument", lambda: argument_texts(evidence), {})
        texts[JUNIT] = guard.run(JUNIT, lambda: junit_xml(evidence), "")
        evidence = replace(evidence, findings=(*evidence.findings, *guard.findings))
        texts[PAGE], evidence = drawn(evidence, gathered.runs)
        # The evidence comes after the page, because drawing may add findings.
        for name, text in {JSON: as_text(evidence), **texts}.items():
            write_whole(folder / name, text)
    except OSError as error:
        raise OutputError.from_os_error(folder, error) from error
    return evidence


def _pack_opened(folder: Path, ledger: Ledger) -> None:
    """Copy the files that programs opened, unless their total size is too large.

    The name of each copy is the hash of the file.
    """
    own = ledger.declared.plan_file.parent
    there = {sha256: own / name for name, sha256 in ledger.opened.items() if is_file_of(own / name, sha256)}
    if there and sum(file.stat().st_size for file in there.values()) <= MOST_OPENED_BYTES:
        folder.mkdir(exist_ok=True)
        for sha256, file in there.items():
            shutil.copyfile(file, folder / sha256)


def is_file_of(path: Path, sha256: str) -> bool:
    """Return whether ``path`` is a file with the hash ``sha256``."""
    return path.is_file() and sha256_of(path) == sha256


def put_back_opened(report: Path, plan: Path, root: Path, ledger: Ledger) -> None:
    """Restore the files that programs opened during the runs.

    Each file is copied to its place beside the unpacked ``plan``. The files come from the report, or from a
    folder beside the report that the user fills.

    Args:
        report: The report's folder.
        plan: The plan's file, unpacked below ``root``.
        root: The only folder that may receive files.
        ledger: The ledger, which has the names and hashes of these files.

    Raises:
        InputError: A file is missing, or a different file has the same path. The error states the hash and
            the place of the file.

    """
    for name, sha256 in ledger.opened.items():
        target = (plan.parent / name).resolve()
        if not sha256 or resolved(root) not in target.parents or is_file_of(target, sha256):
            continue
        places = [
            folder / sha256 for folder in (report / OPENED, report.with_name(f"{report.name}.{OPENED}"))
        ]
        packed = next((folder for folder in places if is_file_of(folder, sha256)), None)
        if packed is None or target.exists():
            expected = f"{name} with the SHA-256 {sha256}, which its program opened"
            hint = f"put it at {places[1]}"
            raise InputError(
                place=Place(file=report), expected=expected, got="no file, or another file", hint=hint
            )
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(packed, target)


def argument_texts(evidence: Evidence) -> dict[str, str]:
    """Return a mapping from the name of each file of the argument to its text."""
    return {GSN: gsn_text(evidence, PAGE), NOTES: notes_text(evidence)}


def _clear(folder: Path) -> None:
    """Remove the PDF and the manifest of an earlier report, and the copies that the manifest lists."""
    try:
        earlier = read_manifest(folder)
    except InputError:
        earlier = {}
    (folder / PDF).unlink(missing_ok=True)
    (folder / MANIFEST).unlink(missing_ok=True)
    # Remove only what a manifest lists: other files in the folder may be the user's.
    for name in earlier:
        if name.startswith((f"{PLAN}/", f"{OPENED}/")):
            (folder / name).unlink(missing_ok=True)


def write_manifest(folder: Path, files: Iterable[StoredFile]) -> None:
    """Write the hashes of all files in ``folder``.

    Call this function last, after the ledger is closed. The hashes of ``files`` are already known.

    Raises:
        OutputError: The manifest cannot be written.

    """
    made = (folder / name for name in MADE)
    hashes = {file.name: sha256_of(file) for file in made if file.is_file()}
    hashes |= {stored.path: stored.sha256 for stored in files}
    text = json.dumps({"format": FORMAT, "sha256": dict(sorted(hashes.items()))}, indent=1)
    try:
        write_whole(folder / MANIFEST, text + "\n")
    except OSError as error:
        raise OutputError.from_os_error(folder / MANIFEST, error) from error


def read_manifest(folder: Path) -> dict[str, str]:
    """Return the path and the hash of every file that the manifest in ``folder`` lists.

    Raises:
        InputError: The folder is no report, or its manifest has an unknown field or lists a file outside of
            the folder.

    """
    file = folder / MANIFEST
    place = Place(file=file)
    refuse_other_kind(folder, FileKind.REPORT, error=InputError)
    refuse_no_file(file, "the folder of a report that certify wrote", InputError)
    document = of_format(read_json(file, FORMAT, most=LARGEST_MANIFEST_BYTES), FORMAT, file)
    if unknown := sorted(document.keys() - {"format", "sha256"}):
        raise InputError(place=place, expected="the fields format and sha256", got=repr(unknown[0])[:120])
    hashes = typed(document.get("sha256"), dict[str, str], file, where="sha256")
    root = resolved(folder)
    for name in hashes:
        # A stranger's manifest must not make the program read files outside the folder.
        plain = "\0" not in name and ".." not in Path(name).parts and Path(name).as_posix() == name
        if not plain or root not in resolved(folder / name).parents:
            raise InputError(place=place, expected="files below the report's folder", got=repr(name)[:120])
    return hashes


def stored_files(folder: Path) -> Iterator[StoredFile]:
    """Yield the files in ``folder`` that the evidence lists, which are all files except those in ``MADE``."""
    for name in names_in(folder):
        path = folder / name
        if name not in MADE:
            yield StoredFile(path=name, sha256=sha256_of(path), bytes=path.stat().st_size)


def names_in(folder: Path) -> Iterator[str]:
    """Yield every file below ``folder`` except the manifest, hidden files and temporary files of the ledger.

    ``PASSING`` lists these temporary files, which come and go with the ledger.
    """
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if name not in (MANIFEST, *PASSING) and not path.name.startswith(".") and path.is_file():
            yield name


_NOT_XML = re.compile(r"[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def junit_xml(evidence: Evidence) -> str:
    """Return the claims of ``evidence`` as JUnit XML, for tools that accept or reject a build by its tests.

    A stratum is a suite, and a claim is a case. Only a claim with the status SHOWN passes. A refuted claim is
    a failure. A claim without a target is a failure if it was violated, and is skipped otherwise. Every other
    status is an error, so that an open claim never looks green.
    """
    name = evidence.plan.name + (f"; {evidence.fallback}" if evidence.fallback else "")
    root = ElementTree.Element("testsuites", name=_xml_text(name))
    for stratum in evidence.strata:
        suite = ElementTree.SubElement(root, "testsuite", name=_xml_text(stratum.name))
        for claim in evidence.claims:
            for outcome in claim.outcomes:
                if outcome.stratum == stratum.name:
                    _case(suite, claim, outcome, evidence)
        tags = [child.tag for case in suite for child in case]
        for name, tag in (("failures", "failure"), ("errors", "error"), ("skipped", "skipped")):
            suite.set(name, str(tags.count(tag)))
        suite.set("tests", str(len(suite)))
    ElementTree.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def _case(suite: ElementTree.Element, claim: ClaimEvidence, outcome: ClaimResult, evidence: Evidence) -> None:
    case = ElementTree.SubElement(
        suite, "testcase", classname=_xml_text(outcome.stratum), name=_xml_text(claim.sentence)
    )
    if outcome.standing is not ClaimStatus.SHOWN:
        _not_passed(case, outcome)
    # A reader of one case then sees the basis of this claim in this stratum alone.
    only = replace(evidence, claims=(replace(claim, outcomes=(outcome,)),))
    ElementTree.SubElement(case, "system-out").text = _xml_text(only.basis)


def _not_passed(case: ElementTree.Element, outcome: ClaimResult) -> None:
    """Add an XML element ``failure``, ``error`` or ``skipped`` to the case of a claim that does not pass."""
    untargeted = "failure" if outcome.violated else "skipped"
    tag = {ClaimStatus.REFUTED: "failure", ClaimStatus.ESTIMATED: untargeted}.get(outcome.standing, "error")
    element = ElementTree.SubElement(case, tag, message=_xml_text(f"{outcome.standing.value}: {outcome.why}"))
    if tag != "skipped":
        element.set("type", outcome.standing.value)


def _xml_text(text: str) -> str:
    return _NOT_XML.sub("\ufffd", text)


BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
LIMIT_S = 180.0  # for the browser to print


def browser() -> str:
    """Return the path of an installed Chromium or Chrome, which prints the PDF.

    Raises:
        InputError: No such browser is installed.

    """
    path = next(filter(None, map(shutil.which, BROWSERS)), None)
    if path is not None:
        return path
    raise InputError(
        place=Place(field="--pdf"),
        expected="an installed Chromium or Chrome, which prints the page",
        got="none of " + ", ".join(BROWSERS) + " on the path",
        hint="the page itself prints well from any browser",
    )


def write_pdf(page: Path, path: Path) -> None:
    """Print ``page`` to the file ``path``.

    Raises:
        InputError: No browser is installed.
        OutputError: The browser failed. The error has the last message of the browser.

    """
    # A profile of its own: with the user's profile, a browser that already runs would take over the command.
    with tempfile.TemporaryDirectory() as profile:
        command = [
            browser(),
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--no-first-run",
            "--disable-background-networking",
            "--no-pdf-header-footer",
            f"--user-data-dir={profile}",
            f"--print-to-pdf={path.resolve()}",
            page.resolve().as_uri(),
        ]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S, check=False)
        except subprocess.TimeoutExpired as error:
            raise _failed(path, f"the browser did not finish in {LIMIT_S:.0f} s") from error
    if done.returncode != 0 or not path.is_file():
        raise _failed(path, done.stderr.strip().splitlines()[-1] if done.stderr.strip() else "nothing")
    with path.open("rb") as file:
        if file.read(5) != b"%PDF-":
            raise _failed(path, "no PDF")


def _failed(path: Path, got: str) -> OutputError:
    return OutputError(place=Place(file=path), expected="a PDF that the browser prints", got=got[:200])
