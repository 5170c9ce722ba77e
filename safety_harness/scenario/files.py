"""Read files of unknown origin.

The size of these files is limited, and errors do not quote content that may be confidential. Files of other
programs may also have a key ``scenario:`` or ``seed:``. A file name may also lead to a confidential file. For
example, ``scenario.yaml`` may be a link to ``/etc/shadow``, or a file may contain ``extends: ~/.netrc``.
Errors appear in build logs. Therefore an error never quotes a file that has no key of the harness.
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
    """Return ``source`` as a path.

    ``source`` is a path, or the text of a path. A ``shipped:NAME`` becomes the path of the file. Every path
    that a caller gives as a text passes through this function.

    Args:
        source: A path, or its text.
        argument: The name of the argument, for errors.
        of_text: The name of the function that reads the content from a text, for the hint.

    Raises:
        InputError: ``source`` is not a path, or is a text of several lines.

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
        place: The place where the file's name is written.
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
    """Raise ``error`` unless ``path`` is a regular file.

    Opening a pipe might block for ever.
    """
    problem = _no_file(path)
    if problem:
        raise error(place=Place(file=path), expected=expected, got=problem)


def _no_file(path: Path) -> str:
    """Return the reason why ``path`` is no regular file, or an empty text if it is a regular file."""
    try:
        if path.is_file():
            return ""
        return f"no such file: {path}" if not path.exists() else f"{path}, which is not a regular file"
    except OSError as reason:
        return f"{path}: {reason.strerror}"


def resolved(path: Path) -> Path:
    """Return the absolute path with its links resolved.

    Links that form a circle are not resolved.
    """
    return Path(os.path.realpath(path))


def display_path(path: Path) -> Path:
    """Return the name of a file for a result.

    The result is relative to the working directory, or is only the file's own name. Results are public, and
    an absolute path would reveal a machine and its user. A relative path is unchanged, unless it leads
    through the root or the folder that contains all home folders. The name of a shipped file begins with
    ``shipped:``.
    """
    full, here = resolved(path.parent) / path.name, resolved(Path())
    shipped = shipped_name(full)
    if here in full.parents and not (shipped and is_installed()):
        return full.relative_to(here)
    by_the_root = Path(os.path.commonpath([full, here])) in Path.home().parents
    return Path(shipped or path.name) if path.is_absolute() or by_the_root else path


def decode(data: bytes, *, most: int, file: Path | None, error: type[InputError]) -> str:
    """Return ``data`` as UTF-8 text.

    Raise ``error`` if the data are larger than ``most`` bytes or are not UTF-8.
    """
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
    """Return whether a line of ``text`` begins with a key of the harness that is uncommon in other files."""
    return not {*COMMON}.issuperset(TOP_KEY.findall(text))


def foreign(file: Path, place: Place | None) -> ScenarioError:
    """Return the error for a file that does not belong to the harness.

    The error does not quote the file's content.
    """
    expected = f"a scenario file, with keys such as {', '.join((*TITLES, 'hands'))}"
    hint = "nothing of it is shown here: it may be anybody's"
    got = f"{file}, which is none"
    return ScenarioError(place=place or Place(file=file), expected=expected, got=got, hint=hint)
