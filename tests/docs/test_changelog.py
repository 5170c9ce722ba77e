"""The changes since the last release: a line each, by the task of a user."""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path

import pytest

from safety_harness.base import moved

CHANGELOG = (Path(__file__).parents[2] / "CHANGELOG.md").read_text(encoding="utf-8")
UNRELEASED = re.split(r"^## ", CHANGELOG, flags=re.MULTILINE)[1]
LINES = [line for line in UNRELEASED.splitlines()[1:] if line.strip()]
ENTRIES = [line for line in LINES if line.startswith("- ")]
WIDEST = 110


def test_every_change_is_one_line_and_one_sentence() -> None:
    for entry in ENTRIES:
        assert len(entry) <= WIDEST, entry
        assert entry.endswith("."), entry
        assert not re.search(r"\w[.!?] [A-Z`]", entry), f"two sentences: {entry}"


def test_every_line_is_a_change_a_task_or_the_table_of_moves() -> None:
    others = [line for line in LINES if not line.startswith(("- ", "### ", "|"))]
    assert set(others) <= {"The moves below `safety_harness`:"}


def test_no_task_and_no_change_is_there_twice() -> None:
    heads = [line for line in LINES if line.startswith(("### ", "- "))]
    assert [head for head, count in Counter(heads).items() if count > 1] == []


def test_every_task_has_changes() -> None:
    pairs = zip(LINES, [*LINES[1:], "### the end"], strict=True)
    assert [head for head, then in pairs if head.startswith("### ") and not then.startswith("- ")] == []


@pytest.mark.parametrize("old", moved.MOVED)
def test_the_table_of_moves_has_every_package_whose_old_path_still_works(old: str) -> None:
    cells = re.findall(r"^\| (.*?) \|", CHANGELOG, flags=re.MULTILINE)
    package, *rest = old.split(".")
    there = f"`{package}`" if not rest or package not in moved.STAYED else f"`{rest[0]}`"
    assert package == "claims" or any(f"`{package}`" in cell and there in cell for cell in cells)
