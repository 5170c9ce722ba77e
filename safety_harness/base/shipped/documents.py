"""The documents: the packaged site, its sections by name, and how a message leads to one of them."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from safety_harness.base.exceptions import Place, ScenarioError, near_miss
from safety_harness.base.shipped.contents import contents, is_installed

COMMAND = "safety-harness docs"


@dataclass(frozen=True)
class Section:
    """A page, or a part of one; ``name`` is what ``safety-harness docs`` takes: claims#proposals."""

    name: str
    title: str


def site() -> Path:
    """The folder of the site, which need not be there: a checkout has it once it was built."""
    return contents() / "site"


def missing() -> ScenarioError:
    """What is said where there is no site."""
    markdown = contents() / "docs"
    hint = f"make docs builds it; as Markdown it is in {markdown}"
    return ScenarioError(
        place=Place(field="docs"),
        expected="the documents as a site",
        got=f"none in {site()}",
        hint="this package was built without it: make wheel packs it" if is_installed() else hint,
    )


def sections() -> tuple[Section, ...]:
    """Every page and heading of the site; ScenarioError if there is none."""
    index = site() / "search.json"
    if not index.is_file():
        raise missing()
    found = json.loads(index.read_text(encoding="utf-8"))["items"]
    return tuple(Section(one["location"].replace(".html", "", 1), one["title"]) for one in found)


def section_named(words: str) -> Section:
    """The page, the section page#heading, or the first with these words in its heading or its name.

    ScenarioError with the nearest for any other.
    """
    known, asked = sections(), words.strip().lower()
    for one in known:
        if one.name.lower() == asked:
            return one
    for one in known:
        if asked and (asked in one.title.lower() or asked.replace(" ", "-") in one.name.lower()):
            return one
    expected = "a page, page#section, or words of a heading"
    hint = near_miss(asked, (one.name for one in known), most=3) or "without any the first page is opened"
    raise ScenarioError.of_option("docs", expected, repr(words), hint)


def path_of(section: Section) -> tuple[Path, str]:
    """The file of a section, and the place in it."""
    page, _, anchor = section.name.partition("#")
    return site() / f"{page}.html", anchor
