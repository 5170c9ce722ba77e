"""Does what the report says follow from its ledger, and do its page and its JUnit XML say the same?

What depends on the words of the catalogue, or on the last bits of a trace, may come out otherwise with other
software than the report's: it is named then.  With the same software all of it has to come out the same.
"""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from safety_harness.campaign.ledger import Ledger
from safety_harness.campaign.plan import Plan
from safety_harness.certification.check import Check, few
from safety_harness.certification.credibility import agreement_of, reruns_of
from safety_harness.certification.document import as_text, plain
from safety_harness.certification.evidence import Evidence, Provenance
from safety_harness.certification.folder import JSON, JUNIT, MADE, PAGE, PDF
from safety_harness.certification.gather import Gathered, put_together, sessions_of
from safety_harness.certification.junit import junit_xml
from safety_harness.certification.page import render
from safety_harness.certification.stored import Stored
from safety_harness.certification.tools import Credibility
from safety_harness.exceptions import InputError, Place
from safety_harness.scenario.files import read_bytes

WORDS = {
    *("rationale", "exercised_when", "hazard", "terms", "why", "about", "assumptions", "exclusions", "lines"),
    *("system", "separation", "calibration", "credibility", "findings", "margin", "selftest_absent"),
}
LARGEST_PAGE_BYTES = 2**28
CLOSE = 1e-9  # relative: another scipy's last digits
_NUMBER = re.compile(rb"\d+(\.\d+)?")
_DRAWING = re.compile(rb"<svg.*?</svg>", re.DOTALL)


def check_numbers(
    plan: Plan,
    ledger: Ledger,
    folder: Path,
    recorded: Evidence,
    hashes: dict[str, str],
    *,
    same: bool,
    again: bool,
) -> tuple[Check, Gathered]:
    """Everything that follows from the ledger and the searches, computed anew.

    ``same``: with the same software.  ``again``: the runs are made again that doubt the simulator.
    """

    def credibility(stored: Sequence[Stored]) -> Credibility:
        known = replace(recorded.credibility, agreement=agreement_of()) if same else recorded.credibility
        return replace(known, reruns=reruns_of(stored)[0]) if again else known

    gathered = put_together(
        plan,
        ledger,
        folder,
        credibility=credibility,
        selftest=recorded.selftest,
        origin=_origin(recorded.provenance, ledger),
    )
    now = replace(gathered.evidence, files=recorded.files)
    faults: list[str] = []
    notes: list[str] = []
    for place, then, new in _differences(plain(recorded), plain(now), ""):
        names = set(re.split(r"[.\[\]\d]+", place))
        words = "largest" in names or (not same and WORDS & names)
        (notes if words else faults).append(f"{place}: {_short(then)} in the report, {_short(new)} comes out")
    faults += _files(folder, recorded, hashes)
    text = (
        f"{len(recorded.claims)} claims, with counts, bounds and verdicts, and all that is shown beside them"
    )
    if recorded.plan.search_runs:
        notes.append("the search was not made again: what it found is what its files say")
    unchecked = [] if again else ["the runs by which the simulator is doubted were not made again"]
    if recorded.selftest or recorded.credibility.oracles:
        unchecked.append("the trial of the harness and the table of oracles are what their files said")
    return Check("numbers", text, few(faults), few(notes), tuple(unchecked)), gathered


def _origin(recorded: Provenance, ledger: Ledger) -> Provenance:
    """As the ledger has it; when and by which command the report was made, nothing else says."""
    parts = dict(ledger.declared.identity.parts)
    began_at, machine, spent_s = sessions_of(ledger)
    libraries = ((name.removeprefix("the library "), version) for name, version in parts.items())
    return replace(
        recorded,
        source_hash=parts.get("the source of this package", ""),
        python=parts.get("Python", ""),
        platform=parts.get("the platform", ""),
        libraries=tuple(pair for pair in libraries if f"the library {pair[0]}" in parts),
        machine=machine or recorded.machine,
        began_at=began_at,
        run_seconds_s=spent_s,
    )


def _differences(then: Any, now: Any, place: str) -> Iterator[tuple[str, Any, Any]]:
    """Where two documents differ: as deep as they can be told apart."""
    if isinstance(then, dict) and isinstance(now, dict):
        for name in now:
            yield from _differences(then[name], now[name], f"{place}.{name}".lstrip("."))
    elif isinstance(then, list) and isinstance(now, list) and len(then) == len(now):
        for k, pair in enumerate(zip(then, now, strict=True)):
            yield from _differences(*pair, f"{place}[{k}]")
    elif isinstance(then, float) and isinstance(now, float):
        if not math.isclose(then, now, rel_tol=CLOSE):
            yield place, then, now
    elif then != now:
        yield place, then, now


def _short(value: Any) -> str:
    if isinstance(value, list):
        return f"{len(value)} of them"
    text = str(value)
    return text if len(text) <= 80 else f"{text[:77]}..."


def _files(folder: Path, recorded: Evidence, hashes: dict[str, str]) -> Iterator[str]:
    """The list in the evidence is that of the manifest, and the evidence the file that certify wrote."""
    listed = {one.path: one.sha256 for one in recorded.files}
    if listed != {name: digest for name, digest in hashes.items() if name not in MADE}:
        yield f"files: {JSON} lists others than the manifest"
    if _bytes_of(folder / JSON) != _written(as_text(recorded)):
        yield f"{JSON} has been edited: the same content is written otherwise"
    for command in (recorded.provenance.command, *recorded.provenance.commands):
        if not _is_ours(command):
            yield f"provenance: a command to be copied that certify does not write: {command[:80]}"


def _is_ours(command: str) -> bool:
    """One command of this package, of plain or quoted words: nothing else happens to who pastes it."""
    try:
        words = shlex.split(command)
    except ValueError:
        return False
    return words[:1] == ["safety-harness"] and shlex.join(words) == command and command.isprintable()


def check_pages(folder: Path, recorded: Evidence, gathered: Gathered, *, same: bool) -> Check:
    """The page and the JUnit XML, made again from the evidence."""
    faults, notes, unchecked = [], [], []
    if _bytes_of(folder / JUNIT) != _written(junit_xml(recorded)):
        faults.append(f"{JUNIT} does not say what {JSON} says")
    if not same:
        unchecked.append(f"{PAGE} was made by other software, whose page cannot be made here")
    else:
        there, made = _bytes_of(folder / PAGE), _written(render(recorded, gathered.runs))
        if there != made and _without_numbers(there) == _without_numbers(made):
            notes.append(f"{PAGE}: its drawings have other numbers than they would have here")
        elif there != made:
            faults.append(f"{PAGE} does not say what {JSON} says")
    if (folder / PDF).exists():
        unchecked.append(f"{PDF} is not compared with the page: print it anew")
    text = f"{PAGE} and {JUNIT}, made again from {JSON}"
    return Check("pages", text, tuple(faults), tuple(notes), tuple(unchecked))


def _bytes_of(path: Path) -> bytes:
    return read_bytes(path, most=LARGEST_PAGE_BYTES, place=Place(file=path), error=InputError)


def _written(text: str) -> bytes:
    """As ``write_whole`` writes it."""
    return text.encode("utf-8", "backslashreplace")


def _without_numbers(page: bytes) -> bytes:
    """Numbers of drawings left out: another version of what draws them moves a line by a hair."""
    return _DRAWING.sub(lambda drawing: _NUMBER.sub(b"0", drawing[0]), page)
