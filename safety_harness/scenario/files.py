"""Files that a stranger may have written: bytes and text, bounded, errors with a place; is one of them ours?

Other programs have files with a ``scenario:`` or a ``seed:`` too.  And a name may lead to a file that is not
for everybody's eyes (``scenario.yaml`` a link to ``/etc/shadow``, or ``extends: ~/.netrc``), while errors go
into the log of a build: none quotes a file that has none of our keys.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

from safety_harness.base.exceptions import InputError, Place, ScenarioError, refuse_other_type
from safety_harness.base.shipped.contents import is_installed, located, shipped_name

TITLES = ("scenario", "scenario space", "suite")
# Keys that few others have.
KEYS = (
    *("extends", "without", "matrix", "tcp start", "avoider", "hands", "faults", "hand sensor", "claims"),
    *("scenarios", "plan", "strata", "proof"),
)
# Ours beside a title only.
COMMON = ("about", "duration", "seed", "robot", "controller", "object", "camera", "settings")
ALL = (*TITLES, *KEYS, *COMMON)
TOP_KEY = re.compile(rf"^[\"']?({'|'.join(ALL)})[\"']?[ \t]*:(?=[ \t\r\n]|$)", re.MULTILINE)


def as_path(source: str | Path, argument: str, *, of_text: str = "") -> Path:
    """Where a text of a caller becomes a path, also one of ``shipped:NAME``: the one place.

    InputError, naming the ``argument``, for what is neither, and for a text of several lines, which is
    no path but what ``of_text`` reads.
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
    """The first ``most`` + 1 bytes of a regular file, so that ``decode`` sees whether there are more.

    ``error`` at ``place`` when there is no such file; devices and pipes, which may never end, are none.
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
    """``error`` unless there is a regular file at ``path``: opening a pipe might wait for ever."""
    problem = _no_file(path)
    if problem:
        raise error(place=Place(file=path), expected=expected, got=problem)


def _no_file(path: Path) -> str:
    try:
        if path.is_file():
            return ""
        return f"no such file: {path}" if not path.exists() else f"{path}, which is not a regular file"
    except OSError as reason:
        return f"{path}: {reason.strerror}"


def resolved(path: Path) -> Path:
    """The absolute path without links; of links that lead to each other what can be said of it."""
    return Path(os.path.realpath(path))


def told(path: Path) -> Path:
    """How a result names a file: as the working directory sees it, or by its name alone.

    Results are shown to anybody, and a path from the root tells of one machine and who works at it.  What
    was named relatively stays so, unless the way leads by the root or by the folder of everybody's homes.
    What is shipped has the name that everybody has it by.
    """
    full, here = resolved(path.parent) / path.name, resolved(Path())
    shipped = shipped_name(full)
    if here in full.parents and not (shipped and is_installed()):
        return full.relative_to(here)
    by_the_root = Path(os.path.commonpath([full, here])) in Path.home().parents
    return Path(shipped or path.name) if path.is_absolute() or by_the_root else path


def decode(data: bytes, *, most: int, file: Path | None, error: type[InputError]) -> str:
    """``data`` as UTF-8; ``error`` when it is larger than ``most`` bytes or not UTF-8."""
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
    """Has a text a title or a key that few others have, at the beginning of a line?"""
    return not {*COMMON}.issuperset(TOP_KEY.findall(text))


def foreign(file: Path, place: Place | None) -> ScenarioError:
    """What is said of a file that is not ours: nothing of what is in it."""
    expected = f"a scenario file, with keys such as {', '.join((*TITLES, 'hands'))}"
    hint = "nothing of it is shown here: it may be anybody's"
    got = f"{file}, which is none"
    return ScenarioError(place=place or Place(file=file), expected=expected, got=got, hint=hint)
