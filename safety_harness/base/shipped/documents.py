"""The documents of the package: the site if it was built, otherwise Markdown; sections by name.

Every installation contains the Markdown.
"""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from safety_harness.base.exceptions import ScenarioError, near_miss
from safety_harness.base.shipped.contents import contents

COMMAND = "safety-harness docs"


@dataclass(frozen=True)
class Section:
    """A page or a part of a page; ``name`` is the argument of ``safety-harness docs``: claims#proposals."""

    name: str
    title: str


def site() -> Path:
    """Return the folder of the site, which a checkout lacks before a build."""
    return contents() / "site"


def markdown() -> Path:
    """Return the folder of the documents as Markdown."""
    return contents() / "docs"


def sections() -> tuple[Section, ...]:
    """Return every page and heading of the site, or of the Markdown if there is no site."""
    index = site() / "search.json"
    if index.is_file():
        items = json.loads(index.read_text(encoding="utf-8"))["items"]
        return tuple(Section(item["location"].replace(".html", "", 1), item["title"]) for item in items)
    return tuple(section for page in sorted(markdown().rglob("*.md")) for section, _ in _headings(page))


def _headings(page: Path) -> Iterator[tuple[Section, int]]:
    """Yield a page and each of its headings with its line, from 0; a page has the title of its first one."""
    name, slugs, code = page.relative_to(markdown()).with_suffix("").as_posix(), Counter[str](), False
    for line, text in enumerate(page.read_text(encoding="utf-8").splitlines()):
        code ^= text.startswith("```")
        if code or not text.startswith("#"):
            continue
        title = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", text.lstrip("# ")).replace("`", "")
        slug = re.sub(r"[-\s]+", "-", re.sub(r"[^\w\s-]", "", title).strip().lower())
        anchor = f"#{slug}" + (f"_{slugs[slug]}" if slugs[slug] else "")
        if not slugs:
            yield Section(name, title), line
        yield Section(name + anchor, title), line
        slugs[slug] += 1


def text_of(section: Section) -> str:
    """Return the Markdown of a section, up to the next heading that is not below it."""
    page = markdown() / f"{section.name.partition('#')[0]}.md"
    lines, begin, level = page.read_text(encoding="utf-8").splitlines(), -1, 0
    for heading, line in _headings(page):
        depth = len(lines[line]) - len(lines[line].lstrip("#"))
        if 0 <= begin < line and depth <= level:
            return "\n".join(lines[begin:line])
        if heading.name == section.name:
            begin, level = line, depth
    return "\n".join(lines[max(begin, 0) :])


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
    file = next((file for file in (site() / "moved.yaml", markdown() / "moved.yaml") if file.is_file()), None)
    lines = [] if file is None else file.read_text(encoding="utf-8").splitlines()
    moved = dict(line.split(": ", 1) for line in lines if not line.startswith("#"))
    page, mark, anchor = name.partition("#")
    return moved.get(name, f"{moved.get(page, page)}{mark}{anchor}")


def path_of(section: Section) -> tuple[Path, str]:
    """Return the file that contains a section, a page of the site or Markdown, and the section's anchor."""
    page, _, anchor = section.name.partition("#")
    made = site() / f"{page}.html"
    return (made if made.is_file() else markdown() / f"{page}.md"), anchor
