"""No page, message or document of the repository calls a robot safe, compliant or certified."""

from __future__ import annotations

import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FOLDERS = ("safety_harness", "docs", "plans", "scenarios", "robots", "examples", "paper", "benchmarks")
KINDS = {".md", ".py", ".j2", ".yaml", ".yml", ".toml", ".cff", ".svg", ".html", ".js"}
OTHERS = ("CHANGELOG.md", "moved.yaml")  # of earlier versions
FILES = [
    file
    for place in (*ROOT.glob("*.*"), *(one for name in FOLDERS for one in (ROOT / name).rglob("*")))
    if (file := place.relative_to(ROOT)).suffix in KINDS and file.name not in OTHERS and place.is_file()
]
CLAIM = re.compile(r"\b(?:safe|compliant|certified)\b", re.IGNORECASE)
# What denies it, what a thing is named, and a paper's title.
DENIED = (
    r"\blooks? safe\b",
    r"\b(?:is|are) never (?:counted as )?safe\b",
    r"\b(?:no|not)\b[^.:;]{0,60}\ba safe (?:one|run|controller)\b",
    r"\bthe safe side\b",
    r"\bsafe for colour-blind readers\b",
    r"\bBayesian Deep Neural Network for Safe Visual Servoing\b",
    r"\bcertified\.json\b",
    r"``certified``",
)


def texts(file: Path) -> Iterator[str]:
    """The words of a file: of a program its strings and comments, of a template all but filters."""
    text = file.read_text("utf-8")
    if file.suffix == ".py":
        kinds = {tokenize.STRING, tokenize.COMMENT, getattr(tokenize, "FSTRING_MIDDLE", -1)}
        for one in tokenize.generate_tokens(io.StringIO(text).readline):
            if one.type in kinds and one.string not in ('"safe"', '"certified"'):  # as a library names a mode
                yield one.string
    else:
        code = r"\|\s*safe\b|'unsafe-inline'|\b\w+\.certified\b" if file.suffix == ".j2" else r"(?!)"
        yield re.sub(code, "", text)


def claimed(text: str) -> list[str]:
    """Where the text calls something so, with what stands about it."""
    text = " ".join(text.replace("#", " ").split())
    for one in DENIED:
        text = re.sub(one, "", text, flags=re.IGNORECASE)
    return [text[max(found.start() - 60, 0) : found.end() + 40] for found in CLAIM.finditer(text)]


@pytest.mark.parametrize("folder", [".", *FOLDERS])
def test_no_text_calls_a_robot_safe_compliant_or_certified(folder: str) -> None:
    found = [
        f"{file}: {claim}"
        for file in FILES
        if file.parts[0] == folder or (folder == "." and len(file.parts) == 1)
        for text in texts(ROOT / file)
        for claim in claimed(text)
    ]
    assert found == []


@pytest.mark.parametrize(
    "text", ["The arm is safe.", "a compliant robot", "# certified to ISO 10218", "not slow: it is safe"]
)
def test_such_a_text_would_be_found(text: str) -> None:
    assert len(claimed(text)) == 1


@pytest.mark.parametrize("text", ["A gate makes a bad avoider look safe.", "NaN is never\n# safe"])
def test_what_denies_it_is_none(text: str) -> None:
    assert claimed(text) == []
