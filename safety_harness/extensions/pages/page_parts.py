"""Provide the parts that all pages share: the templates, and the text of style sheets and scripts."""

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
from safety_harness.extensions.pages.packing import deflated

PACKAGE = "safety_harness.extensions.pages"
THREE = "three.js"
MOST_OPEN = 5  # parts of a page that are open at first


@dataclass(frozen=True, kw_only=True)
class PageSection:
    """A table that a package adds to a page.

    The page escapes the texts of the table.

    Args:
        page: The place of the table. ``run`` adds the table to each drawn run, and ``evidence`` adds it to
            the evidence page.
        heading: The heading of the section, in plain text.
        caption: The caption of the table.
        heads: The headings of the columns.
        rows: The function that receives the ``JudgedRun`` or the ``Evidence`` and returns the rows of texts.
            If it returns no rows, the page omits the section.

    """

    page: str
    heading: str
    caption: str
    heads: tuple[str, ...]
    rows: Callable[[Any], Sequence[Sequence[str]]]


def added_sections(page: str, shown: object, prefix: str = "") -> list[dict[str, Any]]:
    """Return the sections that packages add to a page about ``shown``.

    Warn of each section that fails.
    """
    added: list[dict[str, Any]] = []
    for name, table in loaded(ExtensionPoint.PAGE_SECTIONS, PageSection):
        if table.page == page:
            try:
                rows = [tuple(map(str, row)) for row in table.rows(shown)]
            except Exception as error:  # a module of another package may raise anything
                warn(RegisteredPart(ExtensionPoint.PAGE_SECTIONS, name, ""), described(error))
                rows = []
            added += [{"id": f"{prefix}added-{len(added)}", "part": table, "rows": rows}] if rows else []
    return added


@lru_cache  # so that each template is compiled only once
def templates(package: str = PACKAGE) -> Environment:
    """Return the templates.

    The templates escape their values, and raise an error for an undefined name. The loader finds the
    templates of ``package`` and the shared templates.
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
    """Return the id and title of each part of ``page``, for the table of contents of the page.

    The table omits the headings of articles.
    """
    parts = re.findall(r'<h2 id="([^"]+)"(?: tabindex="-1")?>(.*?)</h2>', page)
    return [(name, Markup(text)) for name, text in parts if not name.endswith("-heading")]


def asset(name: str, package: str = PACKAGE) -> str:
    """Return the text of a style sheet or script.

    A file of ``package`` takes precedence over the shared file with the same name.
    """
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
    """Return the page of ``template`` with the shared style sheet and script.

    The page needs no network.

    Args:
        template: The name of the template.
        basis: A sentence on the evidence behind the page's verdicts, or an empty text if the page has no
            verdicts.
        package: The package that contains the template.
        style: A style sheet to add after the shared style sheet.
        scripts: Scripts to add after the shared script.
        replays: Whether the page contains the 3-D viewer of replays.  The page then carries three.js as text.
            The first replay turns this text into a script, which the page's security policy allows.
        values: The values that the template refers to.

    """
    # The page's security policy lists the hash of each script, so all of them are one.
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
    """Return the date and time ``moment`` for people to read."""
    zone = f" {moment.tzname()}" if moment.tzinfo else ""
    return f"{moment.day} {moment:%B %Y, %H:%M}{zone}"
