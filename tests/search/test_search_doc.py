"""docs/explanation/search.md: its example prints what it says; names and numbers are the program's."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from safety_harness.search.counterexample import DRAWS
from safety_harness.search.coverage import Coverage
from safety_harness.search.findings import LEAST_APART
from safety_harness.search.searchers import SEARCHERS
from safety_harness.search.session import MOST_SHRUNK, SHRINKING_RUNS
from tests.search.planted import BUGS, BY_LOT, CUBE, FRESH

DOCS = Path(__file__).parents[2] / "docs"
TEXT = (DOCS / "explanation/search.md").read_text()
POWER = (DOCS / "results/search-power.md").read_text()


def test_the_example_prints_what_it_says(capsys: pytest.CaptureFixture[str]) -> None:
    (example,) = re.findall(r"^```python\n(.*?)^```$", TEXT, re.MULTILINE | re.DOTALL)
    exec(compile(example, "search.md", "exec"), {})
    (promised,) = re.findall(r"^print.*  # (.*)$", example, re.MULTILINE)
    assert capsys.readouterr().out.strip() == promised


def test_every_searcher_is_in_the_table_and_no_other() -> None:
    assert re.findall(r"^\| `([a-z-]+)` \| [A-Z]", TEXT, re.MULTILINE) == [make.name for make in SEARCHERS]


def test_every_planted_bug_has_its_row() -> None:
    for bug in (*BUGS, *BY_LOT, *FRESH):
        assert f"| `{bug.__name__}` |" in POWER, bug.__name__


def test_the_numbers_are_the_programs() -> None:
    assert CUBE.dimension == 17
    assert f"{len(Coverage().holes):,} cells" in TEXT
    assert f"at most {LEAST_APART} apart" in " ".join(TEXT.split())
    assert (SHRINKING_RUNS, MOST_SHRUNK, DRAWS) == (200, 3, 10)
    assert "200 runs at most" in " ".join(TEXT.split())
    assert "until there are three structures, or six groups were shrunk" in " ".join(TEXT.split())
    assert "in how many of ten draws" in " ".join(TEXT.split())
