"""Counterexamples that the same change of one ingredient mends are one cause."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

from safety_harness.attribution.ingredients import Ingredient
from safety_harness.report.search_attribution import SearchAttribution


def attribution(words: str, *cause: Ingredient) -> Any:
    return SimpleNamespace(cause=cause, helping=(SimpleNamespace(words=words),) if cause else ())


def test_what_one_change_mends_is_told_once() -> None:
    first, second, *_ = Ingredient
    found: dict[str, Any] = {
        "a": attribution("the first made sound", first),
        "b": attribution("the second made sound", second),
        "c": attribution("the first made sound", first),
        "d": attribution("both made sound", first, second),
        "e": attribution("both made sound", first, second),
        "f": attribution("nothing"),
    }
    said: list[str] = []
    written = [SimpleNamespace(path=Path(f"out/{name}.yaml")) for name in (*found, "not attributed")]
    session: Any = SimpleNamespace(written=written, output=SimpleNamespace(say=said.append))
    assert SearchAttribution(found).causes(session) == {"the first made sound": ["a.yaml", "c.yaml"]}
    assert said == ["one cause of 2 counterexamples: the first made sound mends a.yaml, c.yaml"]
