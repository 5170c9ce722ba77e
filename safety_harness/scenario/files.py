"""Bounded reading of files of unknown origin, with errors that name a place but no foreign content.

Files of other programs may have a ``scenario:`` or a ``seed:`` too.  A name may also lead to a confidential
file (``scenario.yaml`` a link to ``/etc/shadow``, or ``extends: ~/.netrc``).  Errors end up in the log of a
build, so an error never quotes a file that lacks all of our keys.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

from safety_harness.base.exceptions import InputError, Place, ScenarioError, refuse_other_type
from safety_harness.base.shipped.contents import is_installed, located, shipped_name

TITLES = ("scenario", "scenario space", "suite")
# Keys that few other programs have.
KEYS = (
    *(
        "extends",
        "without",
        "matrix",
        "tcp start",
        "avoider",
        "safety filter",
        "predictor",
        "hands",
        "faults",
        "hand sensor",
        "claims",
    ),
    *("scenarios", "plan", "strata", "proof"),
)
# Keys that are ours only beside a title.
COMMON = ("about", "duration", "seed", "robot", "controller", "object", "camera", "settings")
ALL = (*TITLES, *KEYS, *COMMON)
TOP_KEY = re.compile(rf"^[\"']?({'|'.join(ALL)})[\"']?[ \t]*:(?=[ \t\r\n]|$)", re.MULTILINE)


def as_path(source: str | Path, argument: str, *, of_text: str = "") -> Path:
    """Return ``source``, a path or its text, as a path with ``shipped:NAME`` resolved.

    Every path that a caller gives as a text passes through this function.

    Args:
        source: A path, or its text.
        argument: The name of the argument, for errors.
        of_text: The function that reads a text in place of a path, for the hint.

    Raises:
        InputError: ``source`` is no path, or is a text of several lines.

    """
    refuse_other_type(argument, source, str, Path, expected="a path")
    text = str(source)
    if not text.strip() or "\0" in text:
        raise InputError.of_option(argument, "a path", repr(text[:80]))
    if isinstance(source, str) and "\n" in text.strip():
        got = f"a text of {len(text.strip().splitlines())} lines"
        hint = f"{of_text}(text) reads a text" if of_text else ""
        raise InputError.of_option(argument, "a path", got, hint)
    return located(source)


def read_bytes(path: Path, *, most: int, place: Place, error: type[InputError]) -> bytes:
    """Return the first ``most`` + 1 bytes of a regular file.

    The extra byte lets ``decode`` refuse a file that is too large.  Devices and pipes are no regular files,
    because they may never end.

    Args:
        path: The file.
        most: The largest size that the caller accepts, in bytes.
        place: The place of its name.
        error: The type of the error for a missing or unreadable file.

    """
    problem = _no_file(path)
    if not problem:
        try:
            with path.open("rb") as stream:
                return stream.read(most + 1)
        except OSError as reason:
            problem = f"{path}: {reason.strerror}"
    raise error(place=place, expected="a file that can be read", got=problem)


def refuse_no_file(path: Path, expected: str, error: type[InputError]) -> None:
    """Raise ``error`` unless ``path`` is a regular file; opening a pipe might block for ever."""
    problem = _no_file(path)
    if problem:
        raise error(place=Place(file=path), expected=expected, got=problem)


def _no_file(path: Path) -> str:
    """Return why ``path`` is no regular file; empty if it is one."""
    try:
        if path.is_file():
            return ""
        return f"no such file: {path}" if not path.exists() else f"{path}, which is not a regular file"
    except OSError as reason:
        return f"{path}: {reason.strerror}"


def resolved(path: Path) -> Path:
    """Return the absolute path with links resolved; links that form a circle stay."""
    return Path(os.path.realpath(path))


def display_path(path: Path) -> Path:
    """Return the name of a file for a result: relative to the working directory, or its name alone.

    Results are public, and an absolute path would reveal a machine and its user.  A relative path stays as it
    is, unless it leads through the root or the folder of all homes.  A shipped file appears by its
    ``shipped:`` name.
    """
    full, here = resolved(path.parent) / path.name, resolved(Path())
    shipped = shipped_name(full)
    if here in full.parents and not (shipped and is_installed()):
        return full.relative_to(here)
    by_the_root = Path(os.path.commonpath([full, here])) in Path.home().parents
    return Path(shipped or path.name) if path.is_absolute() or by_the_root else path


def decode(data: bytes, *, most: int, file: Path | None, error: type[InputError]) -> str:
    """Return ``data`` as UTF-8; ``error`` if it is larger than ``most`` bytes or not UTF-8."""
    if len(data) > most:
        raise error(place=Place(file=file), expected=f"at most {most:,} bytes", got="more")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as reason:
        expected = "text in UTF-8"
        got = f"the byte 0x{data[reason.start]:02x}, which is not UTF-8 here"
        place = Place(file=file, line=data.count(b"\n", 0, reason.start) + 1)
        raise error(place=place, expected=expected, got=got) from reason


def has_a_key(text: str) -> bool:
    """Return whether a line of ``text`` begins with a title or a rare key of ours."""
    return not {*COMMON}.issuperset(TOP_KEY.findall(text))


def foreign(file: Path, place: Place | None) -> ScenarioError:
    """Return the error for a file that is not ours, without quoting the file."""
    expected = f"a scenario file, with keys such as {', '.join((*TITLES, 'hands'))}"
    hint = "nothing of it is shown here: it may be anybody's"
    got = f"{file}, which is none"
    return ScenarioError(place=place or Place(file=file), expected=expected, got=got, hint=hint)
