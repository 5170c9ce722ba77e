"""What comes with the package, by name: ``shipped:fast-reach`` is a file, wherever that is installed.

A wheel has scenarios, spaces, plans, recordings, robots and examples in a folder of this package; a checkout
has them beside the package, where a build takes them from.  Both have one layout, so that what these files
say of each other holds in both.  ``located`` is the one place that knows the names.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache
from pathlib import Path, PurePath

from safety_harness.base.exceptions import Place, ScenarioError, near_miss

PREFIX = "shipped:"
PACKED = Path(__file__).resolve().parent
_TITLE = re.compile(r"^(?:scenario|scenario space|suite|plan|proof): *(.+)$", re.MULTILINE)


class ShippedKind(StrEnum):
    """The folders that have a name of their own, by that name."""

    SCENARIOS = "scenarios"
    SPACES = "spaces"
    PLANS = "plans"
    EXAMPLES = "examples"
    RECORDINGS = "recordings"
    ROBOTS = "robots"


FOLDERS = {
    ShippedKind.SCENARIOS: ("scenarios", "*.yaml"),
    ShippedKind.SPACES: ("scenarios/spaces", "*.yaml"),
    ShippedKind.PLANS: ("plans", "*.yaml"),
    ShippedKind.EXAMPLES: ("examples", "*.py"),
    ShippedKind.RECORDINGS: ("scenarios/recordings", "*.csv"),
    ShippedKind.ROBOTS: ("robots", "*.yaml"),
}
SUITES = "examples/suites"  # each of them a folder with files of its own


@dataclass(frozen=True)
class ShippedFile:
    """A file, or the folder of an example; ``name`` follows ``shipped:``."""

    kind: ShippedKind
    name: str
    path: Path

    @property
    def about(self) -> str:
        """One line that the file, or what lies beside it, says of it; empty if it says nothing."""
        path = self.path
        if self.kind is ShippedKind.RECORDINGS:
            row = re.search(rf"`{re.escape(path.name)}` \| ([^|]+)", _text(path.with_name("README.md")))
            return row[1].strip() if row else ""
        if self.kind is ShippedKind.EXAMPLES:
            file = next(iter(sorted(path.glob("test_*.py"))), None) if path.is_dir() else path
            words = ast.get_docstring(ast.parse(_text(file))) if file else ""
            return (words or "").partition("\n")[0]
        if self.kind is ShippedKind.ROBOTS:
            return _text(path).partition("\n")[0].removeprefix("# ")
        title = _TITLE.search(_text(path))
        return title[1].strip("'\"") if title else ""


def is_installed() -> bool:
    """Do the files lie in the package itself, as a wheel has them?"""
    return (PACKED / "scenarios").is_dir()


def contents() -> Path:
    """The folder of everything shipped: of this package in an installation, else the repository's."""
    return PACKED if is_installed() else PACKED.parents[2]


@lru_cache
def shipped_files() -> tuple[ShippedFile, ...]:
    """Everything that has a name, kind by kind."""
    return tuple(_listed(contents()))


def _listed(root: Path) -> Iterator[ShippedFile]:
    for kind, (folder, pattern) in FOLDERS.items():
        for path in sorted((root / folder).glob(pattern)):
            yield ShippedFile(kind, path.stem if path.suffix == ".yaml" else path.name, path)
        if kind is ShippedKind.EXAMPLES:
            for path in sorted((root / SUITES).glob("[a-z]*/")):
                yield ShippedFile(kind, path.name, path)


def is_shipped(path: str | PurePath) -> bool:
    """Does a part of the path begin with ``shipped:``?"""
    return any(part.startswith(PREFIX) for part in PurePath(path).parts)


def located(path: str | Path, place: Place | None = None) -> Path:
    """The path itself, unless a part of it begins with ``shipped:``: then the file or folder of that name.

    What comes before that part is dropped, so that ``folder / text`` can be asked for whatever a text in a
    file names.  A name is that of ``shipped_files``, with or without ``.yaml``, a folder's, or the way to a
    file from the root of them all.  ScenarioError, at ``place``, with the nearest names for any other.
    """
    parts = PurePath(path).parts
    first = next((n for n, part in enumerate(parts) if part.startswith(PREFIX)), None)
    if first is None:
        return Path(path)
    name = PurePath(*parts[first:]).as_posix().removeprefix(PREFIX)
    found = _found(name)
    if found is None:
        raise _unknown(name, place)
    return found


@lru_cache
def _by_name() -> dict[str, Path]:
    """Files by their names, those of YAML also with ``.yaml``, and folders."""
    found: dict[str, Path] = {kind: contents() / folder for kind, (folder, _) in FOLDERS.items()}
    found |= {file.path.name: file.path for file in shipped_files()}
    return found | {file.name: file.path for file in shipped_files()}


def _found(name: str) -> Path | None:
    if name in _by_name():
        return _by_name()[name]
    way = PurePath(name)
    ours = way.parts[:1] in {PurePath(folder).parts[:1] for folder, _ in FOLDERS.values()}
    path = contents() / way
    return path if ours and ".." not in way.parts and path.exists() else None


def _unknown(name: str, place: Place | None) -> ScenarioError:
    names = (PREFIX + one for one in (*FOLDERS, *(file.name for file in shipped_files())))
    expected = "the name of something shipped"
    hint = near_miss(PREFIX + name, names, most=3, all_of_them="safety-harness list")
    got = repr(name)
    return ScenarioError(place=place or Place(field=PREFIX + name), expected=expected, got=got, hint=hint)


def shipped_name(path: Path) -> str:
    """``shipped:NAME`` of a file or folder among them, an absolute path; empty for any other."""
    root = contents()
    if root not in path.parents:
        return ""
    name = next((name for name, one in reversed(_by_name().items()) if one == path), "")
    name = name or path.relative_to(root).as_posix()
    return PREFIX + name if _found(name) == path else ""


def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8") if path.is_file() else ""
