"""Extension points: the kinds of parts that a package can add to the core by means of entry points.

A package lists its parts in its ``pyproject.toml``, and the core loads a part when it needs it:

    [project.entry-points."safety_harness.commands"]
    certify = "safety_harness.extensions.assurance.commands.certify:of_certify"

The parts of this distribution come first, and the parts of other distributions follow in the order of their
names.  The core skips a part and prints a warning if the part cannot be loaded or has a wrong type.  The core
also skips a part that has the same name as an earlier part.  A skipped part has no effect on other parts.
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
    """The groups of entry points.

    The text of each group states the type of its parts and the core's use of them.
    """

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
    WORLD_PROGRAMS = "safety_harness.world_programs"
    """``Callable[[str], cell.simulation.worlds.WorldEntry]``: makes the world for ``NAME:REST``."""
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
    """``extensions.pages.page_parts.PageSection``: a table on the page of runs or of evidence."""
    PAGES = "safety_harness.pages"
    """``Callable``: writes the page or picture of a job's result; its name is ``runs``, ``fuzz``,
    ``coverage`` or ``attribution``."""
    EXPLAINERS = "safety_harness.explainers"
    """``type[search.explaining.SearchExplainer]``: explains the violations that a search finds."""
    WARMING = "safety_harness.warming"
    """``Callable[[], None]``: makes the machine code that a package needs, for ``warm``."""


@dataclass(frozen=True, kw_only=True)
class CheckedFile:
    """A valid file.

    ``words`` describes the file for people, ``data`` describes it for programs, and ``spaces`` lists the
    spaces that it contains.
    """

    file: Path
    words: str
    data: dict[str, object]
    spaces: tuple[Any, ...] = ()


@dataclass(frozen=True, kw_only=True)
class InputFile:
    """A kind of file that a package adds.  A command skips such files if the field for this command is None.

    Args:
        words: The name of the kind with an article, for use in messages, such as ``a plan``.
        command: The command for such a file, in which ``{file}`` stands for the path.
        check: A function for ``validate`` that reads the file at a path, and raises InputError if the file
            cannot be used.  Its second argument is a function that admits a scenario and executes no user
            code.
        explain: A function for ``explain`` that prints the content of the file at a path, and returns the
            exit code.
        draft: A function for ``new`` that reads another file at the first path, writes a file of this kind to
            the second path, and returns the exit code.
        tables: A function for ``explain KEY`` that returns the ``KeyTable`` objects of this kind of file.
        schema: A function for ``schema`` that returns the file's JSON Schema.
        recorded: A function for ``judge``, ``view`` and pytest that reads the file at a path as a recorded
            run.  Its second argument contains claims that replace the claims of the file.
        title: The key at the top of such a file, by which commands recognise its kind.  The field is filled
            in automatically with the name of the entry point.

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
    """An entry point of a package.

    ``package`` is the distribution with its version, or an empty text for a part of this distribution.
    """

    group: str
    name: str
    value: str
    package: str = ""

    def __str__(self) -> str:
        return f"{self.group} {self.name}{self.package and f' of {self.package}'}"


@lru_cache
def parts(point: ExtensionPoint) -> tuple[RegisteredPart, ...]:
    """Return the parts of a kind without loading them.

    Our own parts come first.  The parts of other distributions follow in the order of their names.  In a
    checkout, our own parts come from its ``pyproject.toml``, even if an older installation lists different
    parts.
    """
    known = {RegisteredPart(point, name, value) for name, value in _of_the_checkout().get(point, {}).items()}
    for entry in entry_points(group=point):
        dist = entry.dist
        ours = dist is not None and dist.name in (DISTRIBUTION, f"{DISTRIBUTION}-paper")
        if not (ours and dist is not None and dist.name == DISTRIBUTION and _of_the_checkout()):
            package = "" if ours else "nobody" if dist is None else f"{dist.name} {dist.version}"
            known.add(RegisteredPart(point, entry.name, entry.value, package))
    return tuple(sorted(known, key=lambda entry: (bool(entry.package), entry.name, entry.value)))


@lru_cache
def _of_the_checkout() -> dict[str, dict[str, str]]:
    """Return the checkout's entry points by group, or an empty mapping outside a checkout."""
    try:
        project = tomllib.loads(PYPROJECT.read_text("utf-8"))["project"]
        return dict(project["entry-points"]) if project["name"] == DISTRIBUTION else {}
    except (OSError, KeyError, tomllib.TOMLDecodeError):
        return {}


def foreign_parts() -> tuple[RegisteredPart, ...]:
    """Return the parts that come from other distributions.

    Evidence records these parts.
    """
    return tuple(part for point in ExtensionPoint for part in parts(point) if part.package)


def load(part: RegisteredPart, kind: type[_Part]) -> _Part | None:
    """Load a part and return it.

    Return None after a warning if the part cannot be loaded or is not of type ``kind``.
    """
    try:
        loaded_part = EntryPoint(part.name, part.value, part.group).load()
    except Exception as error:  # a foreign module may raise anything
        if not is_absent(part, error):
            warn(part, f"{type(error).__name__}: {error}")
        return None
    if not isinstance(loaded_part, kind):
        warn(part, f"expected {kind.__name__}, got {type(loaded_part).__name__}")
        return None
    return loaded_part


def is_absent(part: RegisteredPart, error: Exception) -> bool:
    """Return whether loading failed only because the part belongs to a wing that is not installed.

    A missing wing is allowed and causes no warning.
    """
    wing = ".".join(part.value.split(".")[:3])
    return not part.package and isinstance(error, ModuleNotFoundError) and wing.startswith(error.name or "?")


@lru_cache
def warn(part: RegisteredPart, why: str) -> None:
    """Print a warning on standard error that the harness skips ``part``.

    Further calls with the same arguments print no warning.

    ``why`` is the reason that the warning states.
    """
    if sys.stderr is not None:
        sys.stderr.write(f"warning: skipped {part}: {why}\n")


def loaded(
    point: ExtensionPoint, kind: type[_Part], *, reserved: tuple[str, ...] = ()
) -> Iterator[tuple[str, _Part]]:
    """Yield the name and the object of each usable part of a kind.

    Args:
        point: The group of entry points.
        kind: The type that a part must have.  A part of another type causes a warning.
        reserved: Names that a part may not have.

    """
    names = {*reserved}
    for part in parts(point):
        if part.name in names:
            warn(part, "another part has its name")
        elif (usable := load(part, kind)) is not None:
            names.add(part.name)
            yield part.name, usable


@lru_cache
def names_of(point: ExtensionPoint) -> frozenset[str]:
    """Return the names of the parts of a kind without loading them."""
    return frozenset(part.name for part in parts(point))


def optional_part(point: ExtensionPoint, name: str, kind: type[_Part]) -> _Part | None:
    """Return the part named ``name`` of the type ``kind``, or None if no package adds a usable one."""
    usable = (load(part, kind) for part in parts(point) if part.name == name)
    return next((part for part in usable if part is not None), None)


@lru_cache
def part_named(point: ExtensionPoint, name: str, kind: type[_Part]) -> _Part:
    """Return the part named ``name``.

    Args:
        point: The group of entry points.
        name: The name of the part.
        kind: The type that the part must have.

    Raises:
        MissingPackageError: No package adds a usable part of that name.

    """
    if (usable := optional_part(point, name, kind)) is not None:
        return usable
    expected = f"a package that adds the entry point {name} to {point}"
    hint = f"pip install --force-reinstall {DISTRIBUTION}, or the package that added it"
    got = "an entry point that does not load" if name in names_of(point) else "no such entry point"
    raise MissingPackageError.of_option(name, expected, got, hint)


def _identities(part: object) -> set[str]:
    """Return the texts by which files and commands refer to a part, in lower case."""
    texts = (getattr(part, name, None) for name in ("name", "label", "example", "words"))
    return {text.casefold() for text in texts if isinstance(text, str)}


class Registry(list[_Part]):
    """The core's own parts of a kind, followed by the parts that packages add.

    The registry loads the added parts when it is first used.  The registry cannot load these parts earlier,
    when the registry is created.  The reason is that a package's module may import the module that creates
    this registry.
    """

    def __init__(self, own: Iterable[_Part], point: ExtensionPoint, kind: type[_Part]) -> None:
        super().__init__(own)
        self._waiting: tuple[ExtensionPoint, type[_Part]] | None = (point, kind)

    def _complete(self) -> None:
        """Load the parts of other packages, unless this was already done.

        Warn about each part with a name that already exists.
        """
        if self._waiting is not None:
            (point, kind), self._waiting = self._waiting, None
            own = tuple(str(getattr(present, "name", "")) for present in list.__iter__(self))
            for name, part in loaded(point, kind, reserved=own):
                if any(_identities(part) & _identities(present) for present in list.__iter__(self)):
                    warn(RegisteredPart(point, name, ""), "another part has its name")
                else:
                    self.append(part)

    def __iter__(self) -> Iterator[_Part]:
        """Iterate over all parts; load the added parts only if the iteration goes on after the core's own."""
        own = list.__len__(self)
        yield from (list.__getitem__(self, k) for k in range(own))
        self._complete()
        yield from (list.__getitem__(self, k) for k in range(own, list.__len__(self)))

    def __len__(self) -> int:
        """Count all parts."""
        self._complete()
        return super().__len__()

    def __getitem__(self, index: Any) -> Any:
        """Return the part at an index, or the parts in a slice."""
        self._complete()
        return super().__getitem__(index)


@lru_cache
def input_files() -> dict[str, InputFile]:
    """Return the kinds of file that packages add, indexed by the key at the top of such a file."""
    added = loaded(ExtensionPoint.INPUTS, InputFile, reserved=OWN_TITLES)
    return {title: replace(kind, title=title) for title, kind in added}
