"""Are the page, the JUnit XML and the traces beside them what is made of the evidence?

Text is compared to the letter, wherever it stands: between tags, in drawings, in what a screen reader says.
So are drawings of our own.  In plots of matplotlib only where a thing stands (``x``, ``y``, ``d``) may be a
tenth of a pixel off: coordinates are cut after the first decimal, where another processor's last bit shows.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import zip_longest
from pathlib import Path

from safety_harness.certification.check import Examination, few
from safety_harness.certification.evidence import Evidence
from safety_harness.certification.folder import JSON, JUNIT, PAGE, PDF
from safety_harness.certification.gather import GatheredEvidence
from safety_harness.certification.junit import junit_xml
from safety_harness.certification.page import render
from safety_harness.certification.record import drawn_with
from safety_harness.exceptions import InputError, Place
from safety_harness.scenario.files import read_bytes

LARGEST_PAGE_BYTES = 2**28
TOLERANCE_PX = 0.1
_PLOT = re.compile(rb'<svg (?=[^<>]*role="img")(?![^<>]*"coverage-map-).*?</svg>', re.DOTALL)
_TAG = re.compile(rb"<\w[^<>]*>")
_WHERE = re.compile(rb'( (?:d|x|y)=")([^"]*)"')
_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?")
_AROUND = 60  # letters shown before and after a difference


def check_pages(folder: Path, recorded: Evidence, gathered: GatheredEvidence, *, same: bool) -> Examination:
    """The page and the JUnit XML, made again from the evidence; with other software a difference is said."""
    faults, notes, unchecked = list(_traces(folder, gathered)), [], []
    if bytes_of(folder / JUNIT) != written(junit_xml(recorded)):
        faults.append(f"{JUNIT} does not say what {JSON} says")
    there, made = bytes_of(folder / PAGE), written(render(recorded, gathered.runs))
    differs = differences(there, made)
    if differs and same and recorded.record.drawn_with == drawn_with():
        faults += [f"{PAGE} does not say what {JSON} says: {one}" for one in differs]
    elif differs:
        unchecked += [f"{PAGE} was made by other software, and says otherwise: {one}" for one in differs]
    elif there != made:
        notes.append(f"{PAGE}: lines of its plots are up to {TOLERANCE_PX} px from where they are drawn here")
    if (folder / PDF).exists():
        unchecked.append(f"{PDF} is not compared with the page: print it anew")
    text = f"{PAGE} and {JUNIT}, made again from {JSON}"
    return Examination("pages", text, few(faults), tuple(notes), few(unchecked))


def differences(there: bytes, made: bytes) -> tuple[str, ...]:
    """In which lines a page differs from the one that is made here, in words; none within the tolerance."""
    (text, places), (own_text, own_places) = _parted(there), _parted(made)
    if text != own_text:
        pairs = zip_longest(text.splitlines(), own_text.splitlines(), fillvalue=b"")
        return few([_shown(one, other) for one, other in pairs if one != other])
    off = max((abs(a - b) for a, b in zip(places, own_places, strict=True)), default=0.0)
    return () if off <= TOLERANCE_PX + 1e-9 else (f"a line of a plot is {off:.1f} px from its place",)


def _parted(page: bytes) -> tuple[bytes, list[float]]:
    """The page without the numbers that say where things of plots stand, and these numbers."""
    places: list[float] = []

    def number(found: re.Match[bytes]) -> bytes:
        places.append(float(found[0]))
        return b"#"

    def where(found: re.Match[bytes]) -> bytes:
        return found[1] + _NUMBER.sub(number, found[2]) + b'"'

    def plot(found: re.Match[bytes]) -> bytes:
        return _TAG.sub(lambda tag: _WHERE.sub(where, tag[0]), found[0])

    return _PLOT.sub(plot, page), places


def _shown(there: bytes, made: bytes) -> str:
    """The letters about the first difference."""
    at = next((k for k, pair in enumerate(zip_longest(there, made)) if pair[0] != pair[1]), 0)
    one, other = (
        line[max(at - _AROUND, 0) : at + _AROUND].decode("utf-8", "replace") for line in (there, made)
    )
    return f"{one!r} in place of {other!r}"


def _traces(folder: Path, gathered: GatheredEvidence) -> Iterator[str]:
    """Declared counterexamples of which the file is not the ledger's trace."""
    for one in gathered.examples:
        if one.shown is not None and one.data is not None:
            file = folder / one.shown.trace_file
            if not file.is_file() or file.read_bytes() != one.data:
                yield f"{one.shown.trace_file} is not the trace that the ledger keeps"


def bytes_of(path: Path) -> bytes:
    """A file of a report, which may be a stranger's."""
    return read_bytes(path, most=LARGEST_PAGE_BYTES, place=Place(file=path), error=InputError)


def written(text: str) -> bytes:
    """As ``write_whole`` writes it."""
    return text.encode("utf-8", "backslashreplace")
