"""What every page is made with: the templates, and the text of style and script."""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import lru_cache
from importlib.resources import files
from typing import Any

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from safety_harness.base.exceptions import described
from safety_harness.base.extension_points import ExtensionPoint, RegisteredPart, loaded, warn
from safety_harness.report.packing import deflated

PACKAGE = "safety_harness.report"
THREE = "three.js"
MOST_OPEN = 5  # parts of a page that need not be unfolded


@dataclass(frozen=True, kw_only=True)
class PageSection:
    """A table that a package adds to a page, which escapes its texts.

    Args:
        page: ``run``: one for each run that is drawn.  ``evidence``: one on the page of the evidence.
        heading: The heading of the section, plain text.
        caption: What the table shows.
        heads: The heads of its columns.
        rows: Return the rows of texts: of a run's ``JudgedRun``, or of the ``Evidence``.  With none, there is
            no section.

    """

    page: str
    heading: str
    caption: str
    heads: tuple[str, ...]
    rows: Callable[[Any], Sequence[Sequence[str]]]


def added_sections(page: str, shown: object, prefix: str = "") -> list[dict[str, Any]]:
    """Return what packages add to a page about ``shown``; what cannot be made is left out with a warning."""
    found: list[dict[str, Any]] = []
    for name, one in loaded(ExtensionPoint.PAGE_SECTIONS, PageSection):
        if one.page == page:
            try:
                rows = [tuple(map(str, row)) for row in one.rows(shown)]
            except Exception as error:  # of somebody else's module, which may raise anything
                warn(RegisteredPart(ExtensionPoint.PAGE_SECTIONS, name, ""), described(error))
                rows = []
            found += [{"id": f"{prefix}added-{len(found)}", "part": one, "rows": rows}] if rows else []
    return found


def templates(of: str = PACKAGE) -> Environment:
    """The templates: what they are given is escaped, and a name that is not given is an error.

    ``of`` is a package with templates of its own beside ours.
    """
    environment = Environment(
        loader=ChoiceLoader([PackageLoader(name) for name in dict.fromkeys((of, PACKAGE))]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters |= {"headings": _headings, "in_words": in_words}
    return environment


def _headings(page: str) -> list[tuple[str, Markup]]:
    """The id and the words of each part of a page, for its table of contents; without those of articles."""
    found = re.findall(r'<h2 id="([^"]+)"(?: tabindex="-1")?>(.*?)</h2>', page)
    return [(name, Markup(words)) for name, words in found if not name.endswith("-heading")]


def asset(name: str, of: str = PACKAGE) -> str:
    """The text of a style sheet or script beside the templates, of the package ``of`` if it has one."""
    own = files(of) / "templates" / name
    return (own if own.is_file() else files(PACKAGE) / "templates" / name).read_text(encoding="utf-8")


def render_page(
    template: str,
    *,
    basis: str,
    of: str = PACKAGE,
    style: str = "",
    scripts: tuple[str, ...] = (),
    replays: bool = False,
    **values: object,
) -> str:
    """A page that asks nothing of the network: the template with the shared style sheet and script.

    ``style`` names a style sheet of its own that follows the shared one, ``scripts`` scripts likewise;
    ``of`` is the package that the template lies in.  ``replays``: with the viewer of replays in 3-D, and
    three.js as text that becomes a script, which the page's policy allows, when one is looked at.
    ``basis`` says what the page's verdicts rest on; empty for a page without any.
    """
    script = "".join(asset(name, of) for name in ("report.js", *scripts))
    sheets, also = [style] if style else [], ""
    if replays:
        script += f'const THREE_DEFLATED="{_three()}";\n{asset("replay.js")}'
        sheets, also = [*sheets, "replay.css"], f"' 'sha256-{_hash(asset(THREE))}"
    return (
        templates(of)
        .get_template(template)
        .render(
            style=Markup("".join(asset(name, of) for name in ("report.css", *sheets))),
            script=Markup(script),
            script_hash=Markup(_hash(script) + also),
            basis=basis,
            **values,
        )
    )


@lru_cache(maxsize=1)
def _three() -> str:
    return deflated(asset(THREE).encode())


def _hash(script: str) -> str:
    return base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()


def in_words(moment: datetime) -> str:
    """A date and time for people."""
    zone = f" {moment.tzname()}" if moment.tzinfo else ""
    return f"{moment.day} {moment:%B %Y, %H:%M}{zone}"
