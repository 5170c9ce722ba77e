"""Two files of the argument beside the page.

The first file is for external tools, and the second file is for the author's notes. ``argument.gsn.yaml`` has
the format of gsn2x (github.com/jonasthewolf/gsn2x), an open program that checks and draws goal structures.
The sections "Syntax in YAML" and "Dialectic Extension" of its documentation list the keys. The text is JSON,
which is valid YAML.

``argument.yaml`` has the author's notes, one for each goal, strategy and defeater. The names of these
elements stay the same from run to run. ``certify`` reads the notes and adds the notes to the argument as
justifications. Then the program writes the file again and keeps the notes.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from safety_harness.base.exceptions import Place, ScenarioError
from safety_harness.extensions.assurance.certification.argument import DONE, Element, ElementKind, argument_of
from safety_harness.extensions.assurance.certification.evidence import ArgumentNote, Evidence
from safety_harness.extensions.pages.svg import plain
from safety_harness.scenario.fields import Field
from safety_harness.scenario.files import decode, read_bytes
from safety_harness.scenario.nodes import parse_tree

GSN, NOTES = "argument.gsn.yaml", "argument.yaml"
MOST_LETTERS, MOST_BYTES = 2000, 2**20  # letters of a note, bytes of the file
_HEADER = """\
# Write a note on any element of the argument here. certify keeps it and shows it as your justification; it
# changes no verdict. Run certify again after each change, because the report has this file's hash.
"""
_AGAINST = (ElementKind.DEFEATER, ElementKind.ANSWER)
_BESIDE = (ElementKind.CONTEXT, ElementKind.ASSUMPTION, ElementKind.JUSTIFICATION)


def gsn_text(evidence: Evidence, page: str) -> str:
    """Return the argument of ``evidence`` in gsn2x's format.

    Each element links to its place on ``page``.
    """
    elements: dict[str, dict[str, Any]] = {}
    for element, challenged in _walk(argument_of(evidence), ""):
        made: dict[str, Any] = {"text": element.text, "url": f"{page}#{element.place}"}
        if support := [each.key for each in element.below if each.kind not in _AGAINST]:
            made["supportedBy"] = support
        elif element.kind in (ElementKind.GOAL, ElementKind.STRATEGY, ElementKind.DEFEATER):
            made["undeveloped"] = True
        if element.beside:
            made["inContextOf"] = [each.key for each in element.beside]
        if challenged:
            made["challenges"] = challenged
        if element.kind is ElementKind.DEFEATER and element.state == DONE:
            made["defeated"] = True
        elements[element.key] = made
    return json.dumps(elements, indent=1, ensure_ascii=False) + "\n"


def _walk(element: Element, above: str) -> Iterator[tuple[Element, str]]:
    """Yield ``element`` and everything below it, each element with the key of the element that it challenges.

    ``above`` is the key of the parent. The yielded key is empty if the element supports its parent.
    """
    yield element, above if element.kind in _AGAINST else ""
    yield from ((child, "") for child in element.beside)
    for child in element.below:
        yield from _walk(child, element.key)


def read_notes(folder: Path) -> tuple[ArgumentNote, ...]:
    """Return the author's notes in a report's ``folder``, or an empty tuple if there is no file of notes.

    Raises:
        ScenarioError: The file is too large, or it does not map elements to short texts.

    """
    file = folder / NOTES
    if not file.is_file():
        return ()
    data = read_bytes(file, most=MOST_BYTES, place=Place(file=file), error=ScenarioError)
    text = decode(data, most=MOST_BYTES, file=file, error=ScenarioError)
    root = Field(parse_tree(text, file), file, path="", line=1)
    notes = []
    for name, field in root.entries("a mapping of the argument's elements to notes"):
        text = field.prose("a note on this element", lines=True).strip()
        if len(text) > MOST_LETTERS:
            raise field.error(f"a note of {MOST_LETTERS} characters at most", got=str(len(text)))
        if text:
            notes.append(ArgumentNote(element=name, text=text))
    return tuple(notes)


def notes_text(evidence: Evidence) -> str:
    """Return the text of the file of notes, with an entry for each element that may have a note.

    The text keeps all notes of ``evidence``. If the element of a note no longer exists, a remark states this.
    """
    elements = {element.name: element for element in argument_of(evidence).every() if element.name}
    notes = {note.element: note.text for note in evidence.notes}
    lines = [_HEADER]
    for name in dict.fromkeys((*elements, *notes)):
        part = elements.get(name)
        head = (
            f"{part.kind.name.lower()}: {plain(part.text, longest=160)}" if part else "on no element any more"
        )
        lines.append(f"\n# {head}\n{json.dumps(name, ensure_ascii=False)}:{_scalar(notes.get(name, ''))}\n")
    return "".join(lines)


def _scalar(text: str) -> str:
    """Return ``text`` as a YAML scalar that preserves line breaks."""
    if "\n" not in text:
        return f" {json.dumps(text, ensure_ascii=False)}"
    return " |2-\n" + "\n".join(f"  {line}" if line else "" for line in text.split("\n"))
