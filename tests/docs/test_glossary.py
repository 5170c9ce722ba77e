"""The documents use the field's words (docs/reference/glossary.md), none of our private ones.

What a program prints and what a scenario file says stands in code, where anything may stand.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
WRITTEN = {"docs/results/paper-numbers.md", "docs/results/networks.md"}  # by a program, from what it prints
PAGES = [
    page
    for pattern in ("*.md", "docs/**/*.md", "paper/*.md", "scenarios/recordings/*.md")
    for page in sorted(ROOT.glob(pattern))
    if page.name != "CHANGELOG.md" and str(page.relative_to(ROOT)) not in WRITTEN
]
PRIVATE = {  # what we said: what the field says
    r"to the test": "exercised",
    r"on trial": "mutation testing",
    r"kill table": "mutation score",
    r"giv(e|es|ing|en) way": "retreat",
    r"asked (where it is|elsewhere)": "called in-process, out of process",
    r"deaf to|not heard": "ignores",
    r"mishaps?": "run error",
    r"one story": "have the same structure",
    r"gravest|as grave as": "the worst claim decides",
    r"given that they can be tried": "conditioned on admissibility",
    r"numbers? that (are|is) none|(is|are) no number|is none to": "NaN or infinity; not a valid one",
    r"(the|this|these|other|every) rooms?": "package",
    r"(values?|points?|all|region|scale) alike": "uniform",
    r"a millionth of it": "truncation leaves at least 1e-6 of the mass",
    r"nothing is remembered": "stateless",
    r"the house": "the package",
    r"by lot": "at random",
}


def prose(text: str) -> str:
    """A page without its generated tables and its code, on one line."""
    for code in (r"<!-- table: .*?<!-- end -->", r"^```.*?^```$", r"`[^`\n]*`"):
        text = re.sub(code, " ", text, flags=re.DOTALL | re.MULTILINE)
    return " ".join(text.split())


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_a_page_has_no_private_words(page: Path) -> None:
    text = prose(page.read_text())
    found = {
        found[0]: word for said, word in PRIVATE.items() for found in re.finditer(rf"\b{said}\b", text, re.I)
    }
    assert not found


def test_what_is_printed_may_be_quoted() -> None:
    page = "It says `on trial`.\n\n```\nalso on trial\n```\n<!-- table: a -->\n| gives way |\n<!-- end -->\n"
    assert prose(page) == "It says ."


def test_a_phrase_is_found_over_the_end_of_a_line() -> None:
    assert re.search("put to the test", prose("a claim that no run put\nto the test"))
