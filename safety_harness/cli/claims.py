"""``safety-harness claims``: what can be claimed, from the entries behind the documentation."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Sequence

from safety_harness.cli.console import AS_EXPECTED, result, say
from safety_harness.exceptions import Place, ScenarioError
from safety_harness.formulas.signals import SIGNALS
from safety_harness.properties.catalogue import CATALOGUE
from safety_harness.properties.entry import CatalogueEntry, told
from safety_harness.scenario.units import near_miss

WIDTH = 110


def explain_claims(words: Sequence[str]) -> int:
    """Print every sentence, or all about those that contain the words; returns the exit code.

    The words may be a whole sentence with a limit of one's own: what understands it is explained.
    """
    asked = " ".join(" ".join(words).split())
    if not asked:
        result(*(entry.example for entry in CATALOGUE))
        say(f"or a formula (docs/formulas.md) over: {', '.join(signal.words for signal in SIGNALS)}")
        return AS_EXPECTED
    found = [entry for entry in CATALOGUE if entry.understands(asked)]
    wanted = set(asked.lower().split())
    found = found or [entry for entry in CATALOGUE if wanted <= set(entry.example.lower().split())]
    if not found:
        examples = [entry.example for entry in CATALOGUE]
        raise ScenarioError(
            place=Place(field="claims"),
            expected="words of a claim of the catalogue; without any, all claims are listed",
            got=asked,
            hint=near_miss(asked, examples, most=3),
        )
    for number, entry in enumerate(found):
        result(*([""] if number else []), *_lines(entry))
    return AS_EXPECTED


def _lines(entry: CatalogueEntry) -> Iterator[str]:
    yield entry.example
    for name, text in told(entry):
        yield from textwrap.wrap(
            text, WIDTH, initial_indent=f"  {name:<13}", subsequent_indent=" " * 15, break_on_hyphens=False
        )
