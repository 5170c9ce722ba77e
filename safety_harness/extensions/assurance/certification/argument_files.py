"""The argument beside the page: for other tools, and for what its author has to say.

``argument.gsn.yaml`` is in the format of gsn2x (github.com/jonasthewolf/gsn2x), an open program that checks
and draws goal structures; its documentation has the keys ("Syntax in YAML", "Dialectic Extension").  The text
is JSON, which is YAML as well.

``argument.yaml`` has the author's notes, one for each goal, strategy and defeater, by names that outlive a
run: ``certify`` reads them, shows them as justifications, and writes the file again around them.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from safety_harness.base.exceptions import Place, ScenarioError
from safety_harness.extensions.assurance.certification.argument import DONE, Element, ElementKind, argument_of
from safety_harness.extensions.assurance.certification.evidence import ArgumentNote, Evidence
from safety_harness.report.svg import plain
from safety_harness.scenario.fields import Field
from safety_harness.scenario.files import decode, read_bytes
from safety_harness.scenario.nodes import parse_tree

GSN, NOTES = "argument.gsn.yaml", "argument.yaml"
MOST_LETTERS, MOST_BYTES = 2000, 2**20  # of a note, of all
_ABOUT = """\
# Yours to write: a note on any element of the argument. certify keeps it and shows it as a justification of
# yours; it changes no verdict. Run certify again when you have written, for the report has this file's hash.
"""
_AGAINST = (ElementKind.DEFEATER, ElementKind.ANSWER)
_BESIDE = (ElementKind.CONTEXT, ElementKind.ASSUMPTION, ElementKind.JUSTIFICATION)


def gsn_text(evidence: Evidence, page: str) -> str:
    """The argument for gsn2x; elements lead to their places on the ``page``."""
    found: dict[str, dict[str, Any]] = {}
    for one, challenged in _walk(argument_of(evidence), ""):
        made: dict[str, Any] = {"text": one.text, "url": f"{page}#{one.place}"}
        if support := [each.key for each in one.below if each.kind not in _AGAINST]:
            made["supportedBy"] = support
        elif one.kind in (ElementKind.GOAL, ElementKind.STRATEGY, ElementKind.DEFEATER):
            made["undeveloped"] = True
        if one.beside:
            made["inContextOf"] = [each.key for each in one.beside]
        if challenged:
            made["challenges"] = challenged
        if one.kind is ElementKind.DEFEATER and one.state == DONE:
            made["defeated"] = True
        found[one.key] = made
    return json.dumps(found, indent=1, ensure_ascii=False) + "\n"


def _walk(element: Element, above: str) -> Iterator[tuple[Element, str]]:
    """Every element, and the key of what it challenges."""
    yield element, above if element.kind in _AGAINST else ""
    yield from ((one, "") for one in element.beside)
    for one in element.below:
        yield from _walk(one, element.key)


def read_notes(folder: Path) -> tuple[ArgumentNote, ...]:
    """The author's notes in a report's folder, none where there is no file; ScenarioError with its place."""
    file = folder / NOTES
    if not file.is_file():
        return ()
    data = read_bytes(file, most=MOST_BYTES, place=Place(file=file), error=ScenarioError)
    text = decode(data, most=MOST_BYTES, file=file, error=ScenarioError)
    root = Field(parse_tree(text, file), file, path="", line=1)
    found = []
    for name, field in root.entries("a mapping of the argument's elements to notes"):
        text = field.prose("a note on this element", lines=True).strip()
        if len(text) > MOST_LETTERS:
            raise field.error(f"a note of {MOST_LETTERS} characters at most", got=str(len(text)))
        if text:
            found.append(ArgumentNote(element=name, text=text))
    return tuple(found)


def notes_text(evidence: Evidence) -> str:
    """The file of notes: an entry for each element that may have one, and every note that there is."""
    elements = {one.name: one for one in argument_of(evidence).every() if one.name}
    notes = {one.element: one.text for one in evidence.notes}
    lines = [_ABOUT]
    for name in dict.fromkeys((*elements, *notes)):
        one = elements.get(name)
        told = f"{one.kind.name.lower()}: {plain(one.text, longest=160)}" if one else "on no element any more"
        lines.append(f"\n# {told}\n{json.dumps(name, ensure_ascii=False)}:{_scalar(notes.get(name, ''))}\n")
    return "".join(lines)


def _scalar(text: str) -> str:
    """As YAML: several lines as they were written."""
    if "\n" not in text:
        return f" {json.dumps(text, ensure_ascii=False)}"
    return " |2-\n" + "\n".join(f"  {line}" if line else "" for line in text.split("\n"))
