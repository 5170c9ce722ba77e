"""A reader understands a sentence of the documents the first time: hard constructions are rare."""

from __future__ import annotations

import re
from pathlib import Path

import prose
import pytest

ROOT = Path(__file__).parents[2]
WRITTEN_BY_PROGRAMS = {"networks.md", "paper-numbers.md", "controllers.md"}
PYTHON = ROOT / "docs" / "reference" / "python"  # pages of docstrings
EVERY = [
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "PACKAGE.md")),
    *(ROOT / "docs").rglob("*.md"),
]
PAGES = [
    page
    for page in sorted(EVERY)
    if page.name not in {*WRITTEN_BY_PROGRAMS, "PACKAGE.md"}
    and (page.parent != PYTHON or page.name == "jobs.md")
]
READERS = {"all", "test", "research", "assess", "integrate", "contribute"}
FIRST = re.compile(
    r"<!-- reader: (?P<reader>\w+); (?:words: (?P<words>\d+)|written by: (?P<by>[\w/]+\.py)); "
    r"question: .+\? -->\n\n# "
)
MOST = 20  # in 100 sentences; Hypothesis and pytest have 11 and 16


@pytest.mark.parametrize("page", EVERY, ids=lambda page: str(page.relative_to(ROOT)))
def test_a_page_begins_with_its_reader_its_question_and_its_budget(page: Path) -> None:
    first = FIRST.match(page.read_text("utf-8"))
    assert first
    assert first["reader"] in READERS
    assert (page.name in WRITTEN_BY_PROGRAMS) == bool(first["by"])
    assert not first["by"] or (ROOT / first["by"]).is_file()


@pytest.mark.parametrize("page", EVERY, ids=lambda page: str(page.relative_to(ROOT)))
def test_a_page_keeps_to_its_budget_of_words(page: Path) -> None:
    text = page.read_text("utf-8")
    budget = FIRST.match(text)
    assert budget
    if budget["words"]:
        count = prose.words(text)
        assert count <= 1.15 * int(budget["words"]), f"{count} words"


@pytest.mark.parametrize("page", EVERY, ids=lambda page: str(page.relative_to(ROOT)))
def test_the_program_that_printed_a_table_is_there(page: Path) -> None:
    for program in re.findall(r"<!-- printed by: (.*?) -->", page.read_text("utf-8")):
        assert (ROOT / program).is_file()


def test_words_are_counted_without_tables_of_programs_code_and_addresses() -> None:
    written = "<!-- reader -->\n```\ncode\n```\n<!-- table: a -->\n| x |\n<!-- end -->\n"
    written += "<!-- printed by: b.py -->\n| y |\n<!-- end -->\n"
    page = written + "# Two words\n| a | `b` |\n[to](x.md)\n"
    assert prose.words(page) == 5


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
