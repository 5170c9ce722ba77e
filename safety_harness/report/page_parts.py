"""What every page is made with: the templates, and the text of style and script."""

from __future__ import annotations

from importlib.resources import files

from jinja2 import Environment, PackageLoader, StrictUndefined

PACKAGE = "safety_harness.report"


def templates() -> Environment:
    """The templates: what they are given is escaped, and a name that is not given is an error."""
    return Environment(
        loader=PackageLoader(PACKAGE),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )


def asset(name: str) -> str:
    """The text of a style sheet or script beside the templates."""
    return (files(PACKAGE) / "templates" / name).read_text(encoding="utf-8")
