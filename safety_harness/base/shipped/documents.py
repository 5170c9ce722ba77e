"""Find pages and sections of the package's documents by name.

The documents are the HTML site if it was built, otherwise Markdown.  Every installation contains the
Markdown.
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
    """A page or a section of a page.

    ``name`` is a valid argument of ``safety-harness docs``, such as claims#proposals.
    """

    name: str
    title: str


def site() -> Path:
    """Return the folder of the site, which does not exist in a checkout before a build."""
    return contents() / "site"


def markdown() -> Path:
    """Return the folder of the Markdown documents."""
    return contents() / "docs"


def sections() -> tuple[Section, ...]:
    """Return every page and section of the site, or of the Markdown documents if there is no site."""
    index = site() / "search.json"
    if index.is_file():
        items = json.loads(index.read_text(encoding="utf-8"))["items"]
        return tuple(Section(item["location"].replace(".html", "", 1), item["title"]) for item in items)
    return tuple(section for page in sorted(markdown().rglob("*.md")) for section, _ in _headings(page))


def _headings(page: Path) -> Iterator[tuple[Section, int]]:
    """Yield a page and each of its sections, with the line number of the heading.

    The title of a page is its first heading, and lines count from 0.
    """
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
    """Return the Markdown of a section, including its subsections."""
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
        text: A page, a section (page#heading), or some words of a heading or a name.  A name from an earlier
            version is also accepted.

    Raises:
        ScenarioError: The text matches no section, and the hint states the most similar names.

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
    """Return the present name of a page or section.

    ``docs/moved.yaml`` contains the present name for each earlier name.
    """
    file = next((file for file in (site() / "moved.yaml", markdown() / "moved.yaml") if file.is_file()), None)
    lines = [] if file is None else file.read_text(encoding="utf-8").splitlines()
    moved = dict(line.split(": ", 1) for line in lines if not line.startswith("#"))
    page, mark, anchor = name.partition("#")
    return moved.get(name, f"{moved.get(page, page)}{mark}{anchor}")


def path_of(section: Section) -> tuple[Path, str]:
    """Return the file that contains a section, and the section's anchor.

    The file is a page of the site, or Markdown if there is no such page.
    """
    page, _, anchor = section.name.partition("#")
    made = site() / f"{page}.html"
    return (made if made.is_file() else markdown() / f"{page}.md"), anchor
