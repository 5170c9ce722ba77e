"""Causes of a search's violations: examples with a common cause are one, and all others are counted."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from safety_harness.search.session import SearchSession
from safety_harness.search.written import Causes


def session(
    *, left: int = 0, explains_all: bool = False, interrupted: bool = False, **causes: tuple[str, ...] | None
) -> Any:
    """A search with these examples (None: of two groups, whose cause cannot be told), and some ``left``."""
    written = [
        SimpleNamespace(
            path=Path(f"out/{name}.yaml"),
            one=SimpleNamespace(causes=known or (), attribution=() if known == () else ("whose fault",)),
            groups=[object()] if known else [object(), object()],
        )
        for name, known in causes.items()
    ]
    examples = [SimpleNamespace(left=[object()] * left)]
    return SimpleNamespace(
        written=written, examples=examples, explains_all=explains_all, interrupted=interrupted
    )


def causes_of(**options: Any) -> Causes:
    """The causes of such a search."""
    found: Any = SearchSession.causes
    counted: Causes = found.fget(session(**options))
    return counted


def test_examples_with_a_common_cause_are_one_cause() -> None:
    found = causes_of(a=("the first",), b=("the second",), c=("the first",))
    assert found.explained == {"the first": ["a.yaml", "c.yaml"], "the second": ["b.yaml"]}
    assert found.summary == "2 causes explained"


def test_a_change_that_mends_two_merges_them_although_another_mends_the_one_as_well() -> None:
    found = causes_of(a=("another", "the same"), b=("the same",), c=("another",))
    assert sorted(map(len, found.explained.values())) == [1, 2]


@pytest.mark.parametrize(
    ("options", "words", "unasked"),
    [
        ({"a": ("the first",), "left": 1}, "1 cause explained, 1 example not explained yet", 1),
        ({"a": (), "left": 3}, "0 causes explained, 5 examples not explained yet", 5),
        ({"a": None}, "0 causes explained, 2 examples not explained", 0),
        ({"a": None, "left": 3, "explains_all": True}, "0 causes explained, 2 examples not explained", 0),
        (
            {"left": 1, "explains_all": True, "interrupted": True},
            "0 causes explained, 1 example not explained",
            0,
        ),
    ],
)
def test_examples_without_a_known_cause_are_counted(
    options: dict[str, Any], words: str, unasked: int
) -> None:
    found = causes_of(**options)
    assert (found.summary, found.unasked) == (words, unasked)
