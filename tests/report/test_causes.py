"""Counterexamples that the same change of one ingredient mends are one cause."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

from safety_harness.report.search_attribution import SearchAttribution, causes_of


def attribution(*mending: str) -> Any:
    return SimpleNamespace(mending=mending)


def causes(**found: Any) -> tuple[dict[str, list[str]], list[str]]:
    """Of counterexamples with these names, and one that nothing is said of; and what is told."""
    said: list[str] = []
    written = [
        SimpleNamespace(path=Path(f"out/{name}.yaml"), one=SimpleNamespace(attribution=lines))
        for name, lines in (*((name, ("whose fault",)) for name in found), ("not attributed", ()))
    ]
    session: Any = SimpleNamespace(written=written, output=SimpleNamespace(say=said.append))
    return SearchAttribution(found).causes(session), said


def test_what_one_change_mends_is_told_once_and_is_one_finding() -> None:
    found, said = causes(
        a=attribution("the first made sound"),
        b=attribution("the second made sound"),
        c=attribution("the first made sound"),
        d=attribution(),
    )
    assert found == {"the first made sound": ["a.yaml", "c.yaml"]}
    assert said == [
        "4 causes in 5 counterexamples",
        "one cause of 2 counterexamples: the first made sound mends a.yaml, c.yaml",
    ]


def test_a_change_that_mends_two_merges_them_although_another_mends_the_one_as_well() -> None:
    found, _ = causes(
        a=attribution("another", "the same"), b=attribution("the same"), c=attribution("another")
    )
    assert sorted(map(len, found.values())) == [2]
    assert causes_of(3, found) == 2
    assert causes(a=attribution("one"), b=attribution("other")) == ({}, [])


def test_an_example_that_is_not_explained_has_no_cause_of_an_earlier_one_with_its_name() -> None:
    one = SimpleNamespace(path=Path("out/a.yaml"), one=SimpleNamespace(attribution=("whose fault: ...",)))
    other = SimpleNamespace(path=Path("out/b.yaml"), one=SimpleNamespace(attribution=()))
    session: Any = SimpleNamespace(written=[one, other])
    earlier = {"a": attribution("the same"), "b": attribution("the same")}
    assert SearchAttribution(earlier).causes(session) == {}
