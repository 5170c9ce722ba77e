"""Help texts, errors, hints and lines of output read easily: hard constructions are rare in them too."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest
from prose import found_in, worst

PACKAGE = Path(__file__).parents[2] / "safety_harness"
MOST = 20  # in 100 texts; the same as on pages and in docstrings
KEYWORDS = {"help", "expected", "got", "hint", "reason"}
PRINTING = {"say", "result", "warn", "next_step", "refuse", "error", "inadmissible"}


def texts() -> Iterator[tuple[str, str]]:
    """Yield the kind of each text that a person reads, and the text with NAME for each value."""
    for path in sorted(PACKAGE.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call):
                for keyword in node.keywords:
                    if keyword.arg in KEYWORDS:
                        yield from ((keyword.arg, text) for text in spelled(keyword.value))
                called = getattr(node.func, "id", getattr(node.func, "attr", ""))
                if called in PRINTING:
                    yield from ((called, text) for given in node.args for text in spelled(given))


def spelled(value: ast.expr) -> Iterator[str]:
    """Yield a text of at least four words that an expression spells."""
    if isinstance(value, ast.JoinedStr):
        text = "".join(part.value if isinstance(part, ast.Constant) else "NAME" for part in value.values)  # type: ignore[misc]
    elif isinstance(value, ast.Constant) and isinstance(value.value, str):
        text = value.value
    else:
        return
    if len(text.split()) >= 4:
        yield " ".join(text.split())


@pytest.mark.parametrize("kinds", [{"help"}, KEYWORDS - {"help"} | PRINTING], ids=["help", "messages"])
def test_texts_of_the_program_have_at_most_20_hard_constructions_in_100(kinds: set[str]) -> None:
    found = [(text, found_in(text)) for kind, text in texts() if kind in kinds]
    share = 100 * sum(len(names) for _, names in found) / len(found)
    assert len(found) > 100
    assert share <= MOST, f"{share:.1f} in 100 texts\n{worst(found)}"
