"""The shared parts of every page: the templates, and the text of style and script."""

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
    """A table that a package adds to a page; the page escapes its texts.

    Args:
        page: ``run`` adds the table to each drawn run, ``evidence`` to the page of the evidence.
        heading: The heading of the section, plain text.
        caption: The caption of the table.
        heads: The heads of its columns.
        rows: Return the rows of texts for a run's ``JudgedRun``, or for the ``Evidence``.  An empty result
            omits the section.

    """

    page: str
    heading: str
    caption: str
    heads: tuple[str, ...]
    rows: Callable[[Any], Sequence[Sequence[str]]]


def added_sections(page: str, shown: object, prefix: str = "") -> list[dict[str, Any]]:
    """Return the sections that packages add to a page about ``shown``; a failure only gives a warning."""
    added: list[dict[str, Any]] = []
    for name, table in loaded(ExtensionPoint.PAGE_SECTIONS, PageSection):
        if table.page == page:
            try:
                rows = [tuple(map(str, row)) for row in table.rows(shown)]
            except Exception as error:  # of somebody else's module, which may raise anything
                warn(RegisteredPart(ExtensionPoint.PAGE_SECTIONS, name, ""), described(error))
                rows = []
            added += [{"id": f"{prefix}added-{len(added)}", "part": table, "rows": rows}] if rows else []
    return added


@lru_cache  # which compiles each template once
def templates(package: str = PACKAGE) -> Environment:
    """Return the templates; they escape their values, and a missing name is an error.

    ``package`` is a package with templates of its own beside the shared ones.
    """
    environment = Environment(
        loader=ChoiceLoader([PackageLoader(name) for name in dict.fromkeys((package, PACKAGE))]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters |= {"headings": _headings, "in_words": in_words}
    return environment


def _headings(page: str) -> list[tuple[str, Markup]]:
    """Return id and words of each part of a page for its table of contents, without articles."""
    parts = re.findall(r'<h2 id="([^"]+)"(?: tabindex="-1")?>(.*?)</h2>', page)
    return [(name, Markup(text)) for name, text in parts if not name.endswith("-heading")]


def asset(name: str, package: str = PACKAGE) -> str:
    """Return the text of a style sheet or script beside the templates, if possible from ``package``."""
    own = files(package) / "templates" / name
    return (own if own.is_file() else files(PACKAGE) / "templates" / name).read_text(encoding="utf-8")


def render_page(
    template: str,
    *,
    basis: str,
    package: str = PACKAGE,
    style: str = "",
    scripts: tuple[str, ...] = (),
    replays: bool = False,
    **values: object,
) -> str:
    """Return a page that needs no network: the template with the shared style sheet and script.

    Args:
        template: The name of the template.
        basis: The grounds of the page's verdicts; empty for a page without verdicts.
        package: The package of the template.
        style: A style sheet that follows the shared one.
        scripts: Scripts that follow the shared one.
        replays: Whether the page has the 3-D viewer of replays.  The page then carries three.js as text,
            which becomes a script at the first replay; the page's policy allows that script.
        values: The values of the template.

    """
    script = "".join(asset(name, package) for name in ("report.js", *scripts))
    sheets, also = [style] if style else [], ""
    if replays:
        script += f'const THREE_DEFLATED="{_three()}";\n{asset("replay.js")}'
        sheets, also = [*sheets, "replay.css"], f"' 'sha256-{_hash(asset(THREE))}"
    return (
        templates(package)
        .get_template(template)
        .render(
            style=Markup("".join(asset(name, package) for name in ("report.css", *sheets))),
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
    """Return a date and time for people."""
    zone = f" {moment.tzname()}" if moment.tzinfo else ""
    return f"{moment.day} {moment:%B %Y, %H:%M}{zone}"
