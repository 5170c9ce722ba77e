"""The documents of the package: the packaged site, its sections by name, and the search for a section."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from safety_harness.base.exceptions import Place, ScenarioError, near_miss
from safety_harness.base.shipped.contents import contents, is_installed

COMMAND = "safety-harness docs"


@dataclass(frozen=True)
class Section:
    """A page or a part of a page; ``name`` is the argument of ``safety-harness docs``: claims#proposals."""

    name: str
    title: str


def site() -> Path:
    """Return the folder of the site, which a checkout lacks before a build."""
    return contents() / "site"


def missing() -> ScenarioError:
    """Return the error for a site that was not built."""
    markdown = contents() / "docs"
    hint = f"make docs builds it; as Markdown it is in {markdown}"
    return ScenarioError(
        place=Place(field="docs"),
        expected="the documents as a site",
        got=f"none in {site()}",
        hint="this package was built without it: make wheel packs it" if is_installed() else hint,
    )


def sections() -> tuple[Section, ...]:
    """Return every page and heading of the site; ScenarioError if there is no site."""
    index = site() / "search.json"
    if not index.is_file():
        raise missing()
    items = json.loads(index.read_text(encoding="utf-8"))["items"]
    return tuple(Section(item["location"].replace(".html", "", 1), item["title"]) for item in items)


def section_named(text: str) -> Section:
    """Return the first section that matches a text.

    Args:
        text: A page, a section page#heading, or words of a heading or a name.  A name of an earlier version
            leads to the present place.

    Raises:
        ScenarioError: No section matches; the hint lists the nearest names.

    """
    known, name = sections(), _present(text.strip().lower())
    for page in known:
        if page.name.lower() == name:
            return page
    for page in known:
        if name and (name in page.title.lower() or name.replace(" ", "-") in page.name.lower()):
            return page
    expected = "a page, page#section, or words of a heading"
    hint = near_miss(name, (page.name for page in known), most=3) or "without any the first page is opened"
    raise ScenarioError.of_option("docs", expected, repr(text), hint)


def _present(name: str) -> str:
    """Return the present name of a page or section; ``docs/moved.yaml`` maps earlier names to it."""
    file = site() / "moved.yaml"
    lines = file.read_text(encoding="utf-8").splitlines() if file.is_file() else []
    moved = dict(line.split(": ", 1) for line in lines if not line.startswith("#"))
    page, mark, anchor = name.partition("#")
    return moved.get(name, f"{moved.get(page, page)}{mark}{anchor}")


def path_of(section: Section) -> tuple[Path, str]:
    """Return the file that contains a section, and the section's anchor in the file."""
    page, _, anchor = section.name.partition("#")
    return site() / f"{page}.html", anchor
