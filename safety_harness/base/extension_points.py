"""What a package can add to the core: one group of entry points for each kind of part.

A package names its parts in its ``pyproject.toml``, and the core loads a part when it needs it:

    [project.entry-points."safety_harness.commands"]
    certify = "safety_harness.extensions.assurance.commands.certify:of_certify"

The parts of this distribution come first, then those of others by their names.  A part that cannot be loaded,
that is of another type, or whose name is taken is left out with a warning, and stops or replaces nothing.
"""

from __future__ import annotations

import sys
import tomllib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any, TypeVar

from safety_harness.base.distribution import DISTRIBUTION, PYPROJECT
from safety_harness.base.exceptions import MissingPackageError

_Part = TypeVar("_Part")
OWN_TITLES = ("scenario", "scenario space", "suite")  # of files that the core reads itself


class ExtensionPoint(StrEnum):
    """The groups, each with the type of its parts and what the core does with them."""

    COMMANDS = "safety_harness.commands"
    """``typer.Typer``: has a command, or is a group of commands, with the name of this part."""
    INPUTS = "safety_harness.inputs"
    """``InputFile``: a kind of file that commands take, by the key that titles it, which is its name."""
    CLAIMS = "safety_harness.claims"
    """``claims.properties.entry.CatalogueEntry``: a claim of the catalogue."""
    SIGNALS = "safety_harness.signals"
    """``claims.signals.signal.Signal``: a signal of formulas."""
    CLAIM_NOTES = "safety_harness.claim_notes"
    """``Callable[[CatalogueEntry], Iterator[tuple[str, str]]]``: lines that ``claims`` adds to an entry's."""
    WORLDS = "safety_harness.worlds"
    """``cell.simulation.worlds.WorldEntry``: a world for ``--world`` and ``world:``."""
    SCENARIO_KEYS = "safety_harness.scenario_keys"
    """``scenario.codec.Key``: a key of scenario files, below ``extensions:``, by its name."""
    CONTROLLERS = "safety_harness.controllers"
    """``seams.contract.ControllerOpener``: a way to a controller, for ``controller: NAME:REST``."""
    RUN_FORMATS = "safety_harness.run_formats"
    """``Callable[[Trace, Sequence[Evaluation], Path], Sequence[Path]]``: writes a run, for ``export --out
    FILE.NAME``, and returns its files."""
    LEDGER_COLUMNS = "safety_harness.ledger_columns"
    """``Callable[[Trace], float]``: a number of an episode, which a campaign's ledger keeps in a column."""
    PAGE_SECTIONS = "safety_harness.page_sections"
    """``report.page_parts.PageSection``: a table on the page of runs or of evidence."""
    WARMING = "safety_harness.warming"
    """``Callable[[], None]``: makes the machine code that a package needs, for ``warm``."""


@dataclass(frozen=True, kw_only=True)
class CheckedFile:
    """A file that can be used, in ``words`` for people and ``data`` for programs, and its scenario spaces."""

    file: Path
    words: str
    data: dict[str, object]
    spaces: tuple[Any, ...] = ()


@dataclass(frozen=True, kw_only=True)
class InputFile:
    """A kind of file.  What is None is not done with such a file.

    Args:
        words: The kind with its article, as messages call it: ``a plan``.
        command: What to type for such a file; ``{file}`` stands for its path.
        check: Read the file at a path and raise InputError if it cannot be used; the function that it is
            handed admits a scenario and executes nothing.  For ``validate``.
        explain: Print what is in the file at a path and return the exit code.  For ``explain``.
        draft: Write such a file from another one (the first path) to the second, and return the exit code.
            For ``new``.
        tables: Return its ``KeyTable`` s, for ``explain KEY``.
        schema: Return its JSON Schema, for ``schema``.
        recorded: Read the file at a path as a recorded run, with claims in place of its own.  For ``judge``,
            ``view`` and pytest.
        title: The key that titles such files: the name of the entry point, which fills it in.

    """

    words: str
    command: str
    check: Callable[[Path, Callable[[Any], object]], CheckedFile] | None = None
    explain: Callable[[Path], int] | None = None
    draft: Callable[[Path | None, Path | None], int] | None = None
    tables: Callable[[], tuple[Any, ...]] | None = None
    schema: Callable[[], dict[str, Any]] | None = None
    recorded: Callable[[Path, tuple[Any, ...]], Any] | None = None
    title: str = ""


@dataclass(frozen=True)
class RegisteredPart:
    """An entry point.  ``package`` is the distribution that has it, with its version; empty if it is ours."""

    group: str
    name: str
    value: str
    package: str = ""

    def __str__(self) -> str:
        return f"{self.group} {self.name}{self.package and f' of {self.package}'}"


@lru_cache
def parts(point: ExtensionPoint) -> tuple[RegisteredPart, ...]:
    """Return the parts of a kind without loading them: ours, then those of other packages, by name.

    Ours are those of ``pyproject.toml`` in a checkout, whatever an earlier installation of it has noted.
    """
    found = {RegisteredPart(point, name, value) for name, value in _of_the_checkout().get(point, {}).items()}
    for one in entry_points(group=point):
        dist = one.dist
        ours = dist is not None and dist.name in (DISTRIBUTION, f"{DISTRIBUTION}-paper")
        if not (ours and dist is not None and dist.name == DISTRIBUTION and _of_the_checkout()):
            package = "" if ours else "nobody" if dist is None else f"{dist.name} {dist.version}"
            found.add(RegisteredPart(point, one.name, one.value, package))
    return tuple(sorted(found, key=lambda one: (bool(one.package), one.name, one.value)))


@lru_cache
def _of_the_checkout() -> dict[str, dict[str, str]]:
    """Return the entry points by group where the sources lie in a checkout; elsewhere nothing."""
    try:
        project = tomllib.loads(PYPROJECT.read_text("utf-8"))["project"]
        return dict(project["entry-points"]) if project["name"] == DISTRIBUTION else {}
    except (OSError, KeyError, tomllib.TOMLDecodeError):
        return {}


def foreign_parts() -> tuple[RegisteredPart, ...]:
    """Return the parts that other distributions add, for evidence to name."""
    return tuple(one for point in ExtensionPoint for one in parts(point) if one.package)


def load(part: RegisteredPart, kind: type[_Part]) -> _Part | None:
    """Return the loaded part, or None with a warning where it cannot be loaded or is no ``kind``."""
    try:
        found = EntryPoint(part.name, part.value, part.group).load()
    except Exception as error:  # of somebody else's module, which may raise anything
        if not is_absent(part, error):
            warn(part, f"{type(error).__name__}: {error}")
        return None
    if not isinstance(found, kind):
        warn(part, f"expected {kind.__name__}, got {type(found).__name__}")
        return None
    return found


def is_absent(part: RegisteredPart, error: Exception) -> bool:
    """Return whether a part of ours is missing since its wing is not installed, which is no mistake."""
    wing = ".".join(part.value.split(".")[:3])
    return not part.package and isinstance(error, ModuleNotFoundError) and wing.startswith(error.name or "?")


@lru_cache
def warn(part: RegisteredPart, why: str) -> None:
    """Say once on standard error that a part is left out."""
    if sys.stderr is not None:
        sys.stderr.write(f"warning: left out, {part}: {why}\n")


def loaded(
    point: ExtensionPoint, kind: type[_Part], *, taken: tuple[str, ...] = ()
) -> Iterator[tuple[str, _Part]]:
    """Yield name and part of a kind, without those whose name is ``taken`` or that cannot be used."""
    names = {*taken}
    for part in parts(point):
        if part.name in names:
            warn(part, "the name is taken")
        elif (found := load(part, kind)) is not None:
            names.add(part.name)
            yield part.name, found


@lru_cache
def names_of(point: ExtensionPoint) -> frozenset[str]:
    """Return the names of the parts of a kind, which are not loaded."""
    return frozenset(part.name for part in parts(point))


@lru_cache
def part_named(point: ExtensionPoint, name: str, kind: type[_Part]) -> _Part:
    """Return the part of a name; MissingPackageError where no package adds one that can be used."""
    for part in parts(point):
        if part.name == name and (found := load(part, kind)) is not None:
            return found
    expected = f"a package that adds the entry point {name} to {point}"
    hint = f"pip install --force-reinstall {DISTRIBUTION}, or the package that added it"
    got = "none that can be loaded" if name in names_of(point) else "none"
    raise MissingPackageError.of_option(name, expected, got, hint)


def _identities(part: object) -> set[str]:
    """Return the texts by which files and commands choose a part, in lower case."""
    texts = (getattr(part, name, None) for name in ("name", "label", "example", "words"))
    return {text.casefold() for text in texts if isinstance(text, str)}


class Registry(list[_Part]):
    """The core's own parts of a kind; those that packages add follow when somebody first looks.

    Not when this is made: a package's module may hold parts of several kinds, and import what makes this.
    """

    def __init__(self, own: Iterable[_Part], point: ExtensionPoint, kind: type[_Part]) -> None:
        super().__init__(own)
        self._waiting: tuple[ExtensionPoint, type[_Part]] | None = (point, kind)

    def _complete(self) -> None:
        if self._waiting is not None:
            (point, kind), self._waiting = self._waiting, None
            own = tuple(str(getattr(one, "name", "")) for one in list.__iter__(self))
            for name, part in loaded(point, kind, taken=own):
                if any(_identities(part) & _identities(one) for one in list.__iter__(self)):
                    warn(RegisteredPart(point, name, ""), "its name is taken")
                else:
                    self.append(part)

    def __iter__(self) -> Iterator[_Part]:
        """Iterate over all parts."""
        self._complete()
        return super().__iter__()

    def __len__(self) -> int:
        """Count all parts."""
        self._complete()
        return super().__len__()

    def __getitem__(self, index: Any) -> Any:
        """Return the part, or the parts, at an index."""
        self._complete()
        return super().__getitem__(index)


@lru_cache
def input_files() -> dict[str, InputFile]:
    """Return the kinds of file that packages add, by the key that titles them."""
    found = loaded(ExtensionPoint.INPUTS, InputFile, taken=OWN_TITLES)
    return {title: replace(one, title=title) for title, one in found}
