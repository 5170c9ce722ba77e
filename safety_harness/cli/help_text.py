"""Lay out the help of commands for the terminal's width, with the exit codes in a table."""

from __future__ import annotations

import re
import sys
import textwrap
from collections.abc import Iterator
from typing import Any

from safety_harness.cli.console import columns_of

_EXIT_CODE = re.compile(r"Exit code (\d+)(?: too)?: ")
_OF_CODE = 5  # columns of the table's first column


def lay_out_help(command: Any) -> Any:
    """Change the layout of ``--help`` for ``command`` and its subcommands, and return ``command``.

    The attribute ``help`` still contains the text of the docstring, because the reference pages are generated
    from it.
    """
    for part in getattr(command, "commands", {}).values():
        lay_out_help(part)
    plain_help = command.format_help

    def format_help(ctx: Any, formatter: Any) -> None:
        written = command.help
        plain = command.rich_markup_mode is None
        width = (formatter.width if plain else columns_of(sys.stdout) or 80) - 2  # click and Rich indent it
        command.help = laid_out(written or "", width, plain=plain)
        try:
            plain_help(ctx, formatter)
        finally:
            command.help = written

    command.format_help = format_help
    return command


def laid_out(text: str, width: int, *, plain: bool) -> str:
    """Return a docstring with each paragraph on one line, and its exit codes as a table.

    Args:
        text: The docstring.
        width: The width of the table.
        plain: Whether click folds the paragraphs. In this case, the table is protected from folding.

    """
    paragraphs = textwrap.dedent(text).strip().split("\n\n")
    return "\n\n".join(part for paragraph in paragraphs for part in _parts(paragraph, width, plain))


def _parts(paragraph: str, width: int, plain: bool) -> Iterator[str]:
    """Yield a paragraph on one line, and the exit codes at its end as a table."""
    prose, *codes = _EXIT_CODE.split(" ".join(paragraph.split()))
    if prose:
        yield prose.strip()
    meanings: dict[str, list[str]] = {}
    for code, meaning in zip(codes[::2], codes[1::2], strict=True):
        meanings.setdefault(code, []).append(meaning.strip().rstrip("."))
    if meanings:
        folder = textwrap.TextWrapper(width, subsequent_indent=" " * _OF_CODE)
        rows = [folder.fill(f"{code:{_OF_CODE}}{'; '.join(each)}") for code, each in meanings.items()]
        yield "\n".join(["\b"] * plain + ["Exit codes:", *rows])
