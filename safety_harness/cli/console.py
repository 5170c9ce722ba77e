"""Print results on standard output, and everything else on standard error.

The option ``--json`` replaces lines of results by one JSON document.
"""

from __future__ import annotations

import errno
import json
import os
import re
import sys
import textwrap
from collections.abc import Callable, Sequence
from contextvars import ContextVar
from dataclasses import dataclass, field
from math import isfinite
from typing import Any, TextIO

from safety_harness.base.distribution import installed_version
from safety_harness.base.exceptions import InputError, OutputError, SafetyHarnessError, explanation
from safety_harness.base.input_errors import each_once
from safety_harness.base.output import AS_EXPECTED as AS_EXPECTED
from safety_harness.base.output import BAD_INPUT as BAD_INPUT
from safety_harness.base.output import DIFFERS as DIFFERS
from safety_harness.base.output import INTERRUPTED as INTERRUPTED

JSON_FORMAT = "safety-harness answer 1"
NARROW = 70  # columns; on narrower terminals, runs of blanks are closed, and help has no boxes
_NARROWEST = 20
_NO_BREAK = "\N{NO-BREAK SPACE}"


@dataclass
class _Answer:
    """The results of a command with ``--json``, which are printed as one document when the command ends."""

    result: dict[str, object] = field(default_factory=dict)
    lines: list[str] = field(default_factory=list)
    errors: list[dict[str, object]] = field(default_factory=list)


_as_json: ContextVar[_Answer | None] = ContextVar("as_json", default=None)


def strip_control_chars(text: str) -> str:
    """Replace control characters in a text, because untrusted names of files could control the terminal."""
    return text if text.isprintable() else "".join(c if c.isprintable() or c in "\n\t" else "?" for c in text)


def say(*lines: str) -> None:
    """Print remarks on standard error."""
    _print(lines, "stderr")


def result(*lines: str) -> None:
    """Print lines of results on standard output.

    If ``--json`` is given, store them for the document instead.
    """
    if (answer := _as_json.get()) is None:
        _print(lines, "stdout")
    else:
        answer.lines += lines


def next_step(command: str, purpose: str = "") -> None:
    """Print on standard error the command that the user most likely needs next, and the command's purpose."""
    say(f"next: {command}" + (f"    ({purpose})" if purpose else ""))


def asked_for_json() -> bool:
    """Return whether the command answers with a JSON document."""
    return _as_json.get() is not None


def document(**fields: object) -> None:
    """Add results to the document of ``--json``.

    The names of ``fields`` include the units.
    """
    if (answer := _as_json.get()) is not None:
        answer.result |= fields


def verbatim(text: str) -> None:
    """Print ``text``, which is meant for programs, on standard output without folding its lines."""
    if _as_json.get() is None:
        _write(strip_control_chars(text) + "\n", "stdout")


def answered_as_json(command: Callable[[], int]) -> int:
    """Run ``command``, print all its results as one JSON document, and return the exit code.

    The document is printed even if the command fails or is interrupted.
    """
    answer = _Answer()
    token = _as_json.set(answer)
    try:
        code = command()
    except SafetyHarnessError as error:
        explain(error)
        code = BAD_INPUT
    except KeyboardInterrupt:
        code = INTERRUPTED
    finally:
        _as_json.reset(token)
    whole = {
        "format": JSON_FORMAT,
        "package_version": installed_version(),
        "exit_code": code,
        "errors": answer.errors,
        "result": answer.result or ({"lines": answer.lines} if answer.lines else None),
    }
    _write(json.dumps(_plain(whole), indent=1, allow_nan=False) + "\n", "stdout")
    return code


def _plain(value: object) -> Any:
    """Return ``value`` in types that JSON supports.

    A number that is not finite becomes null.
    """
    from msgspec import to_builtins

    own = to_builtins(value, enc_hook=_of_another_type, str_keys=True)
    return _finite(own)


def _of_another_type(value: Any) -> object:
    """Return arrays and numbers of NumPy as Python objects, and any other value as its text."""
    return value.tolist() if hasattr(value, "tolist") else str(value)


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(part) for key, part in value.items()}
    if isinstance(value, list):
        return [_finite(part) for part in value]
    return None if isinstance(value, float) and not isfinite(value) else value


def _print(lines: Sequence[str], name: str) -> None:
    for line in lines:
        _write(folded(strip_control_chars(line), columns_of(getattr(sys, name))) + "\n", name)


def _write(text: str, name: str) -> None:
    """Write ``text`` to the standard stream ``name``, which is ``sys.stdout`` or ``sys.stderr``.

    If the stream or its pipe is closed, later text is discarded.  The command continues in that case, because
    its files matter more than its output.

    Raises:
        OutputError: The disk is full.

    """
    stream: TextIO | None = getattr(sys, name)
    if stream is None:
        return
    try:
        stream.write(text)
        stream.flush()
    except OSError as error:
        give_up(stream)
        if error.errno not in (errno.EPIPE, errno.EBADF, errno.EIO):  # EIO: the terminal hung up
            place = "standard output" if name == "stdout" else "standard error"
            raise OutputError.of_option(place, "room for what is printed", str(error)) from error


def give_up(stream: TextIO) -> None:
    """Discard the buffered text of a stream, and all text written to it later."""
    # Buffered text must go somewhere; otherwise Python would fail again when it closes the stream.
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def no_escapes() -> bool:
    """Return whether the terminal must not receive escape codes.

    This is the case if NO_COLOR is set, or if TERM states a terminal without escape codes.
    """
    return bool(os.environ.get("NO_COLOR")) or os.environ.get("TERM", "").lower() in ("dumb", "unknown")


def columns_of(stream: TextIO | None) -> int | None:
    """Return the number of columns at which lines are folded, from COLUMNS or from the terminal.

    Return None for pipes and files, whose lines are not folded.
    """
    columns_text = os.environ.get("COLUMNS", "")
    if columns_text.isdecimal() and 0 < int(columns_text) < 100_000:
        return max(int(columns_text), _NARROWEST)
    try:
        return None if stream is None else os.get_terminal_size(stream.fileno()).columns or None
    except (OSError, ValueError):  # no terminal, or not even a file
        return None


def folded(text: str, columns: int | None) -> str:
    """Fold the lines of ``text`` to ``columns`` columns.

    A longer word, such as a file name, is not split.
    """
    if columns is None or all(len(line) <= columns for line in text.split("\n")):
        return text
    return "\n".join(part for line in text.split("\n") for part in _parts(line, columns))


def _parts(line: str, columns: int) -> list[str]:
    if len(line) <= columns:
        return [line]
    text = line.strip()
    indent = " " * min(len(line) - len(line.lstrip()), columns // 4)
    if columns < NARROW:
        text = " ".join(text.split())
    together = re.sub(r"(?<=\d) (?=[a-z%])", _NO_BREAK, text)  # a number and its unit
    wrapped = textwrap.wrap(
        together,
        columns,
        initial_indent=indent,
        subsequent_indent=indent + "  ",
        break_long_words=False,
        break_on_hyphens=False,
    )
    return [part.replace(_NO_BREAK, " ") for part in wrapped]


def explain(error: Exception) -> None:
    """Print an error message for the user: the place, the expected input, the actual input and the hint."""
    if (answer := _as_json.get()) is not None:
        answer.errors.append(_error_fields(error))
    say(f"error: {explanation(error)}")


def _error_fields(error: Exception) -> dict[str, object]:
    """Return the fields that describe ``error`` in the document of ``--json``."""
    fields: dict[str, object] = {"kind": type(error).__name__, "message": str(error)}
    if isinstance(error, InputError):
        place = {name: getattr(error.place, name) for name in ("file", "line", "field")}
        fields |= place | {"expected": error.expected, "got": error.got, "hint": error.hint or None}
    return fields


def explain_each(errors: Sequence[InputError]) -> list[InputError]:
    """Explain each distinct error once, and return the distinct errors.

    If several files extend the same faulty file, they all have the same error.
    """
    once = each_once(errors)
    for error in once:
        explain(error)
    return once


def say_shared_modules() -> None:
    """Warn if several packages own the same module.

    In this case, the version of a package does not show which code runs.
    """
    from safety_harness.trace.provenance import shared_modules

    for module, packages in shared_modules().items():
        say(f"warning: {' and '.join(packages)} own the module {module}; uninstall all, install one")
