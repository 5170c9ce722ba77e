"""A reader understands a sentence of the documents the first time: hard constructions are rare."""

from __future__ import annotations

from pathlib import Path

import prose
import pytest

ROOT = Path(__file__).parents[2]
WRITTEN_BY_PROGRAMS = {"models.md", "reproduction-results.md", "shipped-controllers.md"}
PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *(one for one in sorted((ROOT / "docs").glob("*.md")) if one.name not in WRITTEN_BY_PROGRAMS),
    *sorted((ROOT / "docs" / "tutorials").glob("*.md")),
]
MOST = 20  # in 100 sentences; Hypothesis and pytest have 11 and 16


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_hard_constructions_are_rare_on_each_page(page: Path) -> None:
    found = [(one, prose.found_in(one)) for one in prose.sentences(page.read_text("utf-8"))]
    assert found
    hits = sum(len(names) for _, names in found)
    assert 100 * hits <= MOST * len(found), f"{hits} in {len(found)} sentences\n{prose.worst(found)}"


@pytest.mark.parametrize(
    ("sentence", "name"),
    [
        ("A sentence " + "with words " * 15 + "never ends.", "over 30 words"),
        ("It has these: one thing; and another thing.", "two or more colons or semicolons"),
        ("The reader says what it is.", "'what X is' as a noun"),
        ("Of a trace all claims are judged.", "begins with Of, As, What, With"),
        ("The result is then told to the user.", "is told, said, named, asked, tried"),
        ("It reads all columns but for two.", "no X is Y, but for, none"),
        ("It refuses those that are late.", "one, others, those as nouns"),
        ("Who waits longer gets less.", "relative clause before its verb"),
    ],
)
def test_each_construction_is_found(sentence: str, name: str) -> None:
    assert list(prose.sentences(sentence)) == [sentence.strip()]
    assert name in prose.found_in(sentence)
    assert prose.found_in("The reader skips messages without an arm joint.") == []
