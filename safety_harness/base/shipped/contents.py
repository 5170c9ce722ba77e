"""Files that ship with the package, and their names.

A name such as ``shipped:fast-reach`` denotes the same file in every installation.  A wheel contains
scenarios, spaces, plans, recordings, robots and examples in a folder of this package.  A checkout has these
folders beside the package, and a build copies them into the package.  The layout is the same, so references
between these files are valid in a wheel and in a checkout.  Only the function ``located`` resolves such
names.
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
    """A shipped file, or the folder of an example.

    ``name`` is the part of its name after ``shipped:``.
    """

    kind: ShippedKind
    name: str
    path: Path

    @property
    def description(self) -> str:
        """A line that describes the file, or an empty text.

        The line comes from the file itself or from a file beside it.
        """
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
    """Return whether the shipped files are in the package itself, as in a wheel."""
    return (PACKED / "scenarios").is_dir()


def contents() -> Path:
    """Return the folder of all shipped files.

    In an installation, this folder is the package's folder.  In a checkout, it is the repository.
    """
    return PACKED if is_installed() else PACKED.parents[2]


@lru_cache
def shipped_files() -> tuple[ShippedFile, ...]:
    """Return every shipped file that has a name, ordered by kind."""
    return tuple(_listed(contents()))


def _listed(root: Path) -> Iterator[ShippedFile]:
    """Yield the shipped files and folders below ``root``, ordered by kind."""
    for kind, (folder, pattern) in FOLDERS.items():
        for path in sorted((root / folder).glob(pattern)):
            yield ShippedFile(kind, path.stem if path.suffix == ".yaml" else path.name, path)
        if kind is ShippedKind.EXAMPLES:
            for path in sorted((root / SUITES).glob("[a-z]*/")):
                yield ShippedFile(kind, path.name, path)


def is_shipped(path: str | PurePath) -> bool:
    """Return whether some component of the path begins with ``shipped:``."""
    return any(part.startswith(PREFIX) for part in PurePath(path).parts)


def located(path: str | Path, place: Place | None = None) -> Path:
    """Return ``path``, or the shipped file or folder if a component of ``path`` begins with ``shipped:``.

    The components before ``shipped:`` have no effect, so that a caller may always pass ``folder / text``.  A
    name denotes a shipped file or a folder.  The name of a YAML file may omit the ending ``.yaml``.  A path
    below the folder of all shipped files is also a valid name.

    Args:
        path: A path, which may contain ``shipped:``.
        place: The place of the name in the user's input, for the error message.  None means that the error
            only states the name.

    Raises:
        ScenarioError: The name is unknown.  The hint states the most similar names.

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
    """Return all shipped files and folders by their names.

    A YAML file has a name with ``.yaml`` and a name without it.
    """
    paths: dict[str, Path] = {kind: contents() / folder for kind, (folder, _) in FOLDERS.items()}
    paths |= {file.path.name: file.path for file in shipped_files()}
    return paths | {file.name: file.path for file in shipped_files()}


def _path_of(name: str) -> Path | None:
    """Return the path for a name, or None if the name is unknown."""
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
    """Return the name ``shipped:NAME`` of a shipped file or folder.

    The result is an empty text if the absolute path ``path`` is not shipped.
    """
    root = contents()
    if root not in path.parents:
        return ""
    name = next((name for name, target in reversed(_by_name().items()) if target == path), "")
    name = name or path.relative_to(root).as_posix()
    return PREFIX + name if _path_of(name) == path else ""


def _text(path: Path) -> str:
    """Return the text of a file, or an empty text if the file does not exist."""
    return path.read_text(encoding="utf-8") if path.is_file() else ""
