"""The catalogue as pages show it: written from the entries, so that it says what the code knows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from safety_harness.properties.base import Unit
from safety_harness.properties.entry import CatalogueEntry

UNIT_WORDS = {
    Unit.LENGTH: "mm",
    Unit.ANGLE: "deg",
    Unit.SPEED: "mm/s",
    Unit.ANGULAR_SPEED: "deg/s",
    Unit.TIME: "s",
    Unit.ACCELERATION: "m/s2",
    Unit.ANGULAR_ACCELERATION: "deg/s2",
    Unit.FRACTION: "%",
    Unit.COUNT: "a number",
}
NONE = "-"


def told(entry: CatalogueEntry) -> Iterator[tuple[str, str]]:
    """(name, text) of everything that an entry says for people, in the order to read it in."""
    yield "why", entry.rationale
    yield "source", entry.source
    yield "margin", f"{entry.margin} ({UNIT_WORDS[entry.unit]})"
    yield "parameters", entry.parameters
    yield "exercised", entry.exercised
    yield "inconclusive", _also(entry.inconclusive)
    yield "tried in", f"scenarios/{entry.scenario}.yaml"
    yield "broken by", entry.broken_by


def _also(text: str) -> str:
    return "only for the reasons that make any claim so" if text == NONE else text


def markdown_of_claims(entries: Sequence[CatalogueEntry]) -> str:
    """A table of all sentences, then each with everything that its entry says."""
    rows = ["| sentence | margin in | exercised when |", "|---|---|---|"]
    rows += [f"| `{e.example}` | {UNIT_WORDS[e.unit]} | {e.exercised} |" for e in entries]
    sections = []
    for entry in entries:
        lines = [f"### {entry.example}", ""]
        lines += [f"- *{name}*: {text}" for name, text in told(entry)]
        sections.append("\n".join(lines))
    return "\n".join(rows) + "\n\n" + "\n\n".join(sections) + "\n"
