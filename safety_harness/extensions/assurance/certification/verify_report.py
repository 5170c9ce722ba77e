"""Check that a report's statements follow from its ledger, and that its pages follow from its evidence.

Some statements depend on the words of the catalogue, or on the last bits of a trace. Such statements may
differ if other software made the report, and the check then reports the difference. All other statements must
be equal.

The check compares all text of the page exactly, including the text in drawings and the text for screen
readers. In plots, only coordinates (``x``, ``y``, ``d``) may differ, by at most a tenth of a pixel.
Coordinates have one decimal, and a difference in the last bit on another processor can change this decimal.
"""

from __future__ import annotations

import json
import math
import re
import shlex
from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import datetime
from functools import partial
from hashlib import sha256
from itertools import zip_longest
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from safety_harness.base.exceptions import InputError, Place
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.plan import Plan
from safety_harness.extensions.assurance.campaign.session import LEDGER
from safety_harness.extensions.assurance.certification.counterexamples import (
    FINDINGS,
    SEARCH,
    Example,
    told_whose_fault,
    with_fault,
)
from safety_harness.extensions.assurance.certification.credibility import credibility_of
from safety_harness.extensions.assurance.certification.evidence import Evidence, EvidenceProvenance, as_text
from safety_harness.extensions.assurance.certification.folder import (
    JSON,
    JUNIT,
    MADE,
    OPENED,
    PAGE,
    PDF,
    PLAN,
    argument_texts,
    junit_xml,
)
from safety_harness.extensions.assurance.certification.gather import (
    GatheredEvidence,
    libraries_of,
    put_together,
    sessions_of,
)
from safety_harness.extensions.assurance.certification.lodged import declaration_of
from safety_harness.extensions.assurance.certification.page import render
from safety_harness.extensions.assurance.certification.proofs import (
    CERTIFICATE,
    NETWORK,
    networks_of,
    stored_proof,
)
from safety_harness.extensions.assurance.certification.stored import Stored
from safety_harness.extensions.assurance.certification.tools import Credibility, HarnessTrials
from safety_harness.extensions.assurance.certification.verify_files import Examination, ReportFolder, few
from safety_harness.extensions.assurance.certification.whose_fault import whose_fault
from safety_harness.report.search_job import COVERAGE
from safety_harness.report.search_job import PAGE as SEARCH_PAGE
from safety_harness.scenario.files import read_bytes
from safety_harness.scenario.typed_json import plain
from safety_harness.trace.provenance import provenance

LARGEST_PAGE_BYTES = 2**28  # 256 MiB: a limit of the memory for a damaged or forged report
TOLERANCE_PX = 0.1  # a step of a coordinate's last decimal
PROOF = (CERTIFICATE, NETWORK)
_PLOT = re.compile(rb'<svg (?=[^<>]*role="img")(?![^<>]*"coverage-map-)')
_VERDICT = re.compile(rb'<(span class="verdict [^"<>]*"|div class="banner [^"<>]*" role="note"><p><strong)>')
_ANSWERS = b'<ul class="answers">'  # on top: the bound and the verdict of each claim
_VERDICTS = re.compile(rb'<table class="[^"<>]*\bverdicts"[^<>]*>')
_NUMBERS = re.compile(rb'<(td)[^<>]*class="number"[^<>]*>')
_CLOSING = re.compile(rb"</(?:strong|td)>|(?<!</svg>)</span>")
_HIDING = re.compile(rb"<!--|<template\b", re.IGNORECASE)  # could hide a verdict, and no version writes it
_LONGEST_BADGE = 2_000  # bytes, with its icon
_MARKUP = re.compile(rb"<[^<>]*>")
_TAG = re.compile(rb"<\w[^<>]*>")
_WHERE = re.compile(rb'( (?:d|x|y)=")([^"]*)"')
_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?")
_NOT_PASSED = {"failure", "error", "skipped"}
_AROUND = 60  # letters shown before and after a difference


def check_pages(report: ReportFolder, gathered: GatheredEvidence) -> Examination:
    """Make the page and the JUnit XML again from the evidence, and compare them with the files.

    If other software made the report, a difference is an unchecked point instead of a fault.

    Args:
        report: The report.
        gathered: The evidence from the ledger, with the runs of the counterexamples.

    """
    folder, recorded = report.folder, report.recorded
    faults, notes = list(_traces(folder, gathered)), []
    unchecked: list[str] = []
    junit, own = bytes_of(folder / JUNIT), written(junit_xml(recorded))
    if junit != own:  # a rule derives the passing claims from the evidence in every version
        same = not report.same_words and passed_in(junit) == passed_in(own)
        (unchecked if same else faults).append(f"{JUNIT} and {JSON} disagree")
    for name, text in argument_texts(recorded).items():
        file = folder / name
        absent = not file.is_file() and not report.same_words  # earlier versions did not write it
        if not absent and not (file.is_file() and bytes_of(file) == written(text)):
            (faults if report.same_words else unchecked).append(f"{name} and {JSON} disagree")
    there, made = bytes_of(folder / PAGE), written(render(recorded, gathered.runs))
    differs = differences(there, made)
    # Earlier versions wrote no list of answers.
    alike = made if _answers(there) else made.replace(_answers(made), b"", 1)
    if verdicts_in(there) != verdicts_in(alike):
        faults.append(f"{PAGE}: its verdicts do not follow from {JSON}")
    if differs and report.same_words:
        faults += [f"{PAGE} and {JSON} disagree: {line}" for line in differs]
    elif differs:
        unchecked += [f"{PAGE} comes from other software, and differs: {line}" for line in differs]
    elif there != made:
        notes.append(f"{PAGE}: lines of its plots are up to {TOLERANCE_PX} px from where they are drawn here")
    if (folder / PDF).exists():
        unchecked.append(f"{PDF} is not compared with the page: print it anew")
    text = f"{PAGE} and {JUNIT}, made again from {JSON}"
    return Examination("pages", text, few(faults), tuple(notes), few(unchecked))


def differences(there: bytes, made: bytes) -> tuple[str, ...]:
    """Return the lines in which the report's page ``there`` differs from ``made``, the page made here.

    Coordinates may differ within the tolerance.
    """
    (text, places), (own_text, own_places) = _parted(there), _parted(made)
    if text != own_text:
        style, text = _without_style(text, own_text)
        pairs = zip_longest(text.splitlines(), own_text.splitlines(), fillvalue=b"")
        return (*style, *few([_shown(line, own_line) for line, own_line in pairs if line != own_line]))
    gap = max((abs(a - b) for a, b in zip(places, own_places, strict=True)), default=0.0)
    return () if gap <= TOLERANCE_PX + 1e-9 else (f"a line of a plot is {gap:.1f} px from its place",)


def _parted(page: bytes) -> tuple[bytes, list[float]]:
    """Return the page without the coordinates in its plots, and these coordinates."""
    places: list[float] = []

    def number(match: re.Match[bytes]) -> bytes:
        places.append(float(match[0]))
        return b"#"

    def where(match: re.Match[bytes]) -> bytes:
        return match[1] + _NUMBER.sub(number, match[2]) + b'"'

    parts, done = [], 0
    for match in _PLOT.finditer(page):
        if match.start() < done:
            continue
        end = page.find(b"</svg>", match.start())
        if end < 0:  # then no later plot has an end
            break
        parts.append(page[done : match.start()])
        parts.append(_TAG.sub(lambda tag: _WHERE.sub(where, tag[0]), page[match.start() : end]))
        done = end
    return b"".join([*parts, page[done:]]), places


def passed_in(junit: bytes) -> list[tuple[str, str]] | None:
    """Return a pair (stratum, claim) for each passed case in ``junit``, or None if ``junit`` is no XML."""
    try:
        cases = ElementTree.fromstring(junit).iter("testcase")
        passed = (case for case in cases if _NOT_PASSED.isdisjoint(child.tag for child in case))
        return sorted((case.get("classname", ""), case.get("name", "")) for case in passed)
    except ElementTree.ParseError:
        return None


def verdicts_in(page: bytes) -> list[bytes]:
    """Return the verdicts on ``page`` with their classes, and the numbers in the table and list of verdicts.

    In every version of the software, a rule derives these verdicts and numbers from the evidence.
    """
    badges = sorted(opening + text for opening, text in _texts(page, _VERDICT))
    table = _VERDICTS.search(page)
    begin = len(page) if table is None else table.end()
    end = page.find(b"</table>", begin)
    return [
        *badges,
        *_HIDING.findall(page),
        *(text for _, text in _texts(page[begin : end if end >= 0 else len(page)], _NUMBERS)),
        *_NUMBER.findall(_MARKUP.sub(b"", _answers(page))),
    ]


def _answers(page: bytes) -> bytes:
    """Return the list of answers at the top of ``page``, or empty bytes if there is no such list."""
    begin = page.find(_ANSWERS)
    end = page.find(b"</ul>", begin)
    return b"" if begin < 0 else page[begin : end if end >= 0 else len(page)]


def _texts(page: bytes, openings: re.Pattern[bytes]) -> Iterator[tuple[bytes, bytes]]:
    """Yield each match of ``openings``, and the text from the match to the next closing tag.

    A text without a closing tag is cut.
    """
    for match in openings.finditer(page):
        some = page[match.end() : match.end() + _LONGEST_BADGE]
        yield match[1], _MARKUP.sub(b"", _CLOSING.split(some, maxsplit=1)[0])


def _without_style(there: bytes, made: bytes) -> tuple[tuple[str, ...], bytes]:
    """Replace the style sheet of the page ``there`` by the style sheet of ``made``.

    Return a remark if the style sheets differ, and the resulting page. The function replaces the style sheet
    only if the parts of the pages before the style sheet are equal. If the parts before differ, a browser
    might show the style sheet as text.
    """
    theirs, ours = _styled(there), _styled(made)
    if theirs is None or ours is None or theirs[0] != ours[0] or theirs[1] == ours[1]:
        return (), there
    remark = "its style sheet differs, and may hide or add text: not compared"
    return (remark,), theirs[0] + ours[1] + theirs[2]


def _styled(page: bytes) -> tuple[bytes, bytes, bytes] | None:
    """Return the parts of ``page`` before, in and after its first style sheet.

    Return None if the page has no style sheet.
    """
    begin = page.find(b"<style>") + len(b"<style>")
    end = page.find(b"</style>", begin)
    return None if begin < len(b"<style>") or end < 0 else (page[:begin], page[begin:end], page[end:])


def _shown(there: bytes, made: bytes) -> str:
    """Return the text around the first difference between two lines, once from each line."""
    at = next((k for k, pair in enumerate(zip_longest(there, made)) if pair[0] != pair[1]), 0)
    theirs, ours = (
        line[max(at - _AROUND, 0) : at + _AROUND].decode("utf-8", "replace") for line in (there, made)
    )
    return f"{theirs!r} in place of {ours!r}"


def _traces(folder: Path, gathered: GatheredEvidence) -> Iterator[str]:
    """Yield each declared counterexample whose file differs from the trace in the ledger."""
    for item in gathered.examples:
        if item.data is not None:
            file = folder / item.shown.trace_file
            if not file.is_file() or file.read_bytes() != item.data:
                yield f"{item.shown.trace_file} is not the trace that the ledger keeps"


def bytes_of(path: Path) -> bytes:
    """Return the content of ``path``, a file in a report that may come from a stranger.

    Raises:
        InputError: The file cannot be read, or is too large.

    """
    return read_bytes(path, most=LARGEST_PAGE_BYTES, place=Place(file=path), error=InputError)


def written(text: str) -> bytes:
    """Return ``text`` as the bytes that ``write_whole`` writes."""
    return text.encode("utf-8", "backslashreplace")


def rewritten(text: bytes) -> str:
    """Return a JSON text in the form that every version writes.

    The fields of the JSON may be of an earlier version.
    """
    return json.dumps(json.loads(text), indent=1, ensure_ascii=False) + "\n"


PROSE_FIELDS = {
    *("rationale", "exercised_when", "hazard", "terms", "why", "about", "assumptions", "exclusions", "lines"),
    *("system", "separation", "calibration", "credibility", "findings", "margin", "selftest_absent"),
    *("whose_fault", "steps", "approaches"),
}
OF_RUNS = frozenset({"reruns", "absent", "whose_fault", "lines"})  # fields that follow from repeated runs
CLOSE = 1e-9  # relative: the last digits depend on the version of scipy


def check_numbers(report: ReportFolder, *, again: bool) -> tuple[Examination, GatheredEvidence]:
    """Recompute everything that follows from the ledger and the searches, and compare it with the report.

    Args:
        report: The report.
        again: Whether to repeat the runs that test the simulator and the runs that attribute violations.

    Returns:
        The examination, and the evidence from the ledger.

    """
    recorded, ledger, same = report.recorded, report.ledger, report.same
    then = recorded.credibility

    def believe(stored: Sequence[Stored], trials: HarnessTrials) -> Credibility:
        now = credibility_of(stored, trials, reruns=None if again else then.reruns)
        return now if report.same_words else replace(now, agreement=then.agreement)

    oracles_with = then.oracles_measured_with if then.oracles else ""
    # a declaration can only be about this plan and the ledger's software
    declared = recorded.record.declaration_sha256
    gathered = put_together(
        report.plan,
        ledger,
        report.folder,
        HarnessTrials(
            selftest=recorded.selftest, oracles=then.oracles, oracles_with=oracles_with, cells=then.cells
        ),
        declaration=declared and declaration_of(report.plan, ledger.declared.identity).sha256,
        origin=_origin(recorded.provenance, ledger, same=same),
        believe=believe,
        explain=told_whose_fault if again else partial(_as_recorded, recorded),
        blame=whose_fault if again else lambda plan, ledger: recorded.whose_fault,
        proven=recorded.proven,  # check_proof compares it
        notes=recorded.notes,
    )
    now = replace(gathered.evidence, files=recorded.files)
    if recorded.learned is None and not report.same_words:  # earlier versions had no such part
        now = replace(now, learned=None)
    faults: list[str] = []
    doubts: list[str] = []
    for place, was, new in _differences(plain(recorded), plain(now), ""):
        names = set(re.split(r"[.\[\]\d]+", place))
        lenient = frozenset() if same else OF_RUNS if report.same_words else PROSE_FIELDS
        minor = lenient & names or ("largest" in names and _is_close(was, new))
        (doubts if minor else faults).append(f"{place}: {_short(was)} in the report, {_short(new)} comes out")
    faults += _files(report)
    faults += _origin_faults(recorded.provenance)
    text = f"{len(recorded.claims)} claims, with counts, bounds and verdicts, and the tables beside them"
    unchecked = (
        [] if again else ["verify did not repeat the runs that test the simulator or attribute a fault"]
    )
    if not report.same_words:
        unchecked.append("the agreement of the worlds is as the report says: another version measured it")
    if recorded.plan.search_runs:
        unchecked.append("verify did not repeat the search: its result is as its files say")
    if recorded.selftest or then.oracles or then.cells:
        unchecked.append(
            "the trial of the harness, the table of oracles and recorded cells are as their files say"
        )
    unchecked += list(_unread(gathered.evidence, report.hashes))
    unchecked += few([f"{line}: other software, or it was altered" for line in doubts])
    return Examination("numbers", text, few(faults), unchecked=tuple(unchecked)), gathered


def _as_recorded(recorded: Evidence, plan: Plan, met: Sequence[Example | str]) -> Iterator[Example | str]:
    """Yield the counterexamples, each with the attribution that the report states for it.

    If no runs are repeated, the attribution cannot be computed again.
    """
    lines_of = {item.trace_file: item.lines for item in recorded.counterexamples}
    for item in met:
        if isinstance(item, Example):
            lines = lines_of.get(item.shown.trace_file, ())
            more = max(len(lines) - len(item.shown.lines), 0)
            item = with_fault(item, lines[1 : 1 + more])
        yield item


def check_proof(report: ReportFolder) -> Examination | None:
    """Check the certificate again with the independent checker.

    Return None if the report has no certificate.
    """
    recorded = report.recorded.proven
    faults: list[str] = []
    unchecked: list[str] = []
    try:
        now = stored_proof(report.folder, report.plan)
    except InputError as error:
        faults, now = [str(error)], None
    if recorded is None and now is None and not faults:
        return None
    if not faults and plain(recorded) != plain(now):
        faults.append(f"{JSON} and the certificate disagree about the proven claims")
    if now is not None:
        own = {sha256(data).hexdigest() for data in networks_of(report.plan)}
        if now.network_sha256 not in own:
            fault = "the network of the certificate is not the network of the plan's avoider"
            (faults if report.same else unchecked).append(fault)
    text = "the certificate about the network, bounded anew by code that is independent of the prover"
    return Examination("proof", text, few(faults), unchecked=tuple(unchecked))


def _origin(recorded: EvidenceProvenance, ledger: Ledger, *, same: bool) -> EvidenceProvenance:
    """Return the report's origin as the ledger states it.

    The time and the command are copied from ``recorded``.
    """
    parts = dict(ledger.declared.identity.parts)
    began_at, machine, spent_s = sessions_of(ledger)
    return replace(
        recorded,
        package_version=provenance("").package_version if same else recorded.package_version,
        source_hash=parts.get("the source of this package", ""),
        python=parts.get("Python", ""),
        platform=parts.get("the platform", ""),
        libraries=libraries_of(ledger),
        machine=machine or recorded.machine,
        began_at=began_at,
        run_seconds_s=spent_s,
    )


def _differences(then: Any, now: Any, place: str) -> Iterator[tuple[str, Any, Any]]:
    """Yield each difference between two documents, with the path to the innermost value that differs."""
    if isinstance(then, dict) and isinstance(now, dict):
        for name in now:
            yield from _differences(then[name], now[name], f"{place}.{name}".lstrip("."))
    elif isinstance(then, tuple) and isinstance(now, tuple) and len(then) == len(now):
        for k, pair in enumerate(zip(then, now, strict=True)):
            yield from _differences(*pair, f"{place}[{k}]")
    elif isinstance(then, float) and isinstance(now, float):
        if not math.isclose(then, now, rel_tol=CLOSE):
            yield place, then, now
    elif then != now:
        yield place, then, now


def _is_close(then: object, now: object) -> bool:
    """Return True if two margins with units differ only by rounding errors of another processor."""
    if not (isinstance(then, str) and isinstance(now, str)):  # lists of different lengths
        return False
    (value, *unit), (own, *own_unit) = (text.replace("\u2212", "-").split(" ", 1) for text in (then, now))
    try:
        return unit == own_unit and math.isclose(float(value), float(own), rel_tol=0.01, abs_tol=0.1)
    except ValueError:
        return False


def _short(value: Any) -> str:
    """Return ``value`` as text with at most 80 letters."""
    if isinstance(value, tuple):
        return f"{len(value)} of them"
    text = str(value)
    return text if len(text) <= 80 else f"{text[:77]}..."


def _files(report: ReportFolder) -> Iterator[str]:
    """Yield each edit of the evidence, and each difference between its list of files and the manifest."""
    folder, recorded = report.folder, report.recorded
    listed = {item.path: item.sha256 for item in recorded.files}
    sizes = {name: (folder / name).stat().st_size for name in listed if (folder / name).is_file()}
    if any(item.bytes != sizes.get(item.path) for item in recorded.files):
        yield f"files: {JSON} lists wrong sizes"
    if listed != {name: digest for name, digest in report.hashes.items() if name not in MADE}:
        yield f"files: {JSON} and the manifest list different files"
    there = bytes_of(folder / JSON)
    if there != written(as_text(recorded) if report.same_words else rewritten(there)):
        yield f"{JSON} was edited: certify writes the same content in another form"


def _origin_faults(origin: EvidenceProvenance) -> Iterator[str]:
    """Yield faults in the statements about the origin that only the maker of the report can confirm.

    These statements must have the form that ``certify`` writes.
    """
    for command in (origin.command, *origin.commands):
        if not _is_ours(command):
            yield f"provenance has a command that certify does not write: {command[:80]}"
            return
    again, *rest = [shlex.split(command)[1:] for command in origin.commands] or [[]]
    name = rest[0][-1] if rest else ""
    expected = [["verify", name], ["campaign", "status", f"{name}/{LEDGER}"]]
    if origin.commands[:1] != (origin.command,) or again[:1] != ["certify"] or rest != expected:
        yield f"provenance has commands that certify does not write: {'; '.join(origin.commands)[:200]}"
    try:
        ended = datetime.strptime(origin.ended_at, "%d %B %Y, %H:%M UTC")
        early = origin.began_at and ended < datetime.strptime(origin.began_at, "%d %B %Y, %H:%M UTC")
    except ValueError:
        early = True
    if early:
        yield f"provenance: it ended on {origin.ended_at[:40]!r}, and began on {origin.began_at!r}"


def _unread(evidence: Evidence, hashes: dict[str, str]) -> Iterator[str]:
    """Yield a line for each file in the report that no check reads."""
    shown = {item.trace_file for item in evidence.counterexamples}
    for name in hashes:
        inside = Path(name).parts[0] in (PLAN, OPENED)
        inside |= Path(name).parts[0] == SEARCH and name.endswith((".yaml", ".trace", f"/{FINDINGS}"))
        folder, *rest = Path(name).parts
        if folder == SEARCH and len(rest) == 2 and rest[1] in (SEARCH_PAGE, COVERAGE):
            yield f"{name}: verify did not make this file of the search again"
        elif name not in (*MADE, LEDGER, *PROOF, *shown) and not inside:
            yield f"{name}: a file that no report has"


def _is_ours(command: str) -> bool:
    """Return whether ``command`` is a single command of this package, with plain or quoted words.

    If the result is True, a reader who pastes the command into a shell runs no other command.
    """
    try:
        argv = shlex.split(command)
    except ValueError:
        return False
    return argv[:1] == ["safety-harness"] and shlex.join(argv) == command and command.isprintable()
