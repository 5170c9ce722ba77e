"""What the command line prints: results on standard output, everything else on standard error."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Sequence
from typing import TextIO, TypeVar

from safety_harness.exceptions import InputError, explanation

_Item = TypeVar("_Item")
_Made = TypeVar("_Made")
AS_EXPECTED, DIFFERS, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130


def strip_control_chars(text: str) -> str:
    """Without the characters that command a terminal: names of files and traces may come from anybody."""
    return text if text.isprintable() else "".join(c if c.isprintable() or c in "\n\t" else "?" for c in text)


def say(*lines: str) -> None:
    """Remarks on standard error."""
    _print(lines, sys.stderr)


def result(*lines: str) -> None:
    """Lines of results on standard output."""
    _print(lines, sys.stdout)


def _print(lines: Sequence[str], stream: TextIO) -> None:
    for line in lines:
        stream.write(strip_control_chars(line) + "\n")
        stream.flush()


def explain(error: Exception) -> None:
    """A user's mistake: where, what was expected, what came, and the hint on a line of its own."""
    say(f"error: {explanation(error)}")


def usable(items: Iterable[_Item], make: Callable[[_Item], _Made]) -> tuple[list[_Made], list[InputError]]:
    """What is made of each item, and the mistakes in those of which nothing can be made."""
    made: list[_Made] = []
    errors: list[InputError] = []
    for item in items:
        try:
            made.append(make(item))
        except InputError as error:
            errors.append(error)
    return made, errors


def explain_each(errors: Sequence[InputError]) -> int:
    """Each once, and how many: what is wrong in a file that others extend is the same mistake for all."""
    once = {str(error): error for error in errors}
    for error in once.values():
        explain(error)
    return len(once)


def say_shared_modules() -> None:
    """Warn of packages that own the same module: one lies over the other, and nobody knows which runs."""
    from safety_harness.trace.provenance import shared_modules

    for module, packages in shared_modules().items():
        say(f"warning: {' and '.join(packages)} own the module {module}; uninstall all, install one")
