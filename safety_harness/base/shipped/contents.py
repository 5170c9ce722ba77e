"""Files that ship with the package, by name: ``shipped:fast-reach`` names a file in every installation.

A wheel contains scenarios, spaces, plans, recordings, robots and examples in a folder of this package.  A
checkout has them beside the package, and a build copies them from there.  Both have the same layout, so that
references between these files are valid in both.  Only ``located`` resolves the names.
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
    """The kinds of shipped files, which are also the names of their folders."""

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
SUITES = "examples/suites"  # each suite is a folder with its own files


@dataclass(frozen=True)
class ShippedFile:
    """A shipped file, or the folder of an example; ``name`` is the text after ``shipped:``."""

    kind: ShippedKind
    name: str
    path: Path

    @property
    def description(self) -> str:
        """A line that describes the file, from the file or from a file beside it; empty if there is none."""
        path = self.path
        if self.kind is ShippedKind.RECORDINGS:
            row = re.search(rf"`{re.escape(path.name)}` \| ([^|]+)", _text(path.with_name("README.md")))
            return row[1].strip() if row else ""
        if self.kind is ShippedKind.EXAMPLES:
            file = next(iter(sorted(path.glob("test_*.py"))), None) if path.is_dir() else path
            docstring = ast.get_docstring(ast.parse(_text(file))) if file else ""
            return (docstring or "").partition("\n")[0]
        if self.kind is ShippedKind.ROBOTS:
            return _text(path).partition("\n")[0].removeprefix("# ")
        title = _TITLE.search(_text(path))
        return title[1].strip("'\"") if title else ""


def is_installed() -> bool:
    """Return whether the files lie in the package itself, as in a wheel."""
    return (PACKED / "scenarios").is_dir()


def contents() -> Path:
    """Return the folder of all shipped files: in an installation the package, otherwise the repository."""
    return PACKED if is_installed() else PACKED.parents[2]


@lru_cache
def shipped_files() -> tuple[ShippedFile, ...]:
    """Return every shipped file that has a name, kind by kind."""
    return tuple(_listed(contents()))


def _listed(root: Path) -> Iterator[ShippedFile]:
    """Yield the files and folders below ``root``, kind by kind."""
    for kind, (folder, pattern) in FOLDERS.items():
        for path in sorted((root / folder).glob(pattern)):
            yield ShippedFile(kind, path.stem if path.suffix == ".yaml" else path.name, path)
        if kind is ShippedKind.EXAMPLES:
            for path in sorted((root / SUITES).glob("[a-z]*/")):
                yield ShippedFile(kind, path.name, path)


def is_shipped(path: str | PurePath) -> bool:
    """Return whether a part of the path begins with ``shipped:``."""
    return any(part.startswith(PREFIX) for part in PurePath(path).parts)


def located(path: str | Path, place: Place | None = None) -> Path:
    """Return the path itself, or the shipped file or folder if a part begins with ``shipped:``.

    The function drops the parts before ``shipped:``, so that a caller may pass ``folder / text`` for any text
    in a file.  A name may be that of a shipped file, with or without ``.yaml``, or of a folder.  It may also
    be a path below the root.

    Args:
        path: A path, perhaps with ``shipped:``.
        place: The place of the name, for the error; None: the name itself.

    Raises:
        ScenarioError: The name is unknown; the hint has the nearest names.

    """
    parts = PurePath(path).parts
    first = next((n for n, part in enumerate(parts) if part.startswith(PREFIX)), None)
    if first is None:
        return Path(path)
    name = PurePath(*parts[first:]).as_posix().removeprefix(PREFIX)
    target = _path_of(name)
    if target is None:
        raise _unknown(name, place)
    return target


@lru_cache
def _by_name() -> dict[str, Path]:
    """Return files by their names, folders by theirs; a YAML file has a name with and without ``.yaml``."""
    paths: dict[str, Path] = {kind: contents() / folder for kind, (folder, _) in FOLDERS.items()}
    paths |= {file.path.name: file.path for file in shipped_files()}
    return paths | {file.name: file.path for file in shipped_files()}


def _path_of(name: str) -> Path | None:
    """Return the path that a name stands for, or None if the name is unknown."""
    if name in _by_name():
        return _by_name()[name]
    below = PurePath(name)
    ours = below.parts[:1] in {PurePath(folder).parts[:1] for folder, _ in FOLDERS.values()}
    path = contents() / below
    return path if ours and ".." not in below.parts and path.exists() else None


def _unknown(name: str, place: Place | None) -> ScenarioError:
    """Return the error for an unknown name, with the names that resemble it."""
    names = (PREFIX + entry for entry in (*FOLDERS, *(file.name for file in shipped_files())))
    expected = "the name of something shipped"
    hint = near_miss(PREFIX + name, names, most=3, all_of_them="safety-harness list")
    got = repr(name)
    return ScenarioError(place=place or Place(field=PREFIX + name), expected=expected, got=got, hint=hint)


def shipped_name(path: Path) -> str:
    """Return ``shipped:NAME`` for the absolute path of a shipped file or folder, else an empty text."""
    root = contents()
    if root not in path.parents:
        return ""
    name = next((name for name, target in reversed(_by_name().items()) if target == path), "")
    name = name or path.relative_to(root).as_posix()
    return PREFIX + name if _path_of(name) == path else ""


def _text(path: Path) -> str:
    """Return the text of a file; empty if it does not exist."""
    return path.read_text(encoding="utf-8") if path.is_file() else ""
