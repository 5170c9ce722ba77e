"""All scenarios to which a path leads.

The path leads to a file, possibly with a matrix, to a folder, or to a suite.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

from safety_harness.base.exceptions import InputError, Place, ScenarioError
from safety_harness.base.shipped.contents import located
from safety_harness.scenario.compose import (
    SUITE,
    Library,
    Variant,
    is_space,
    merged,
    variants,
    without_keys,
)
from safety_harness.scenario.fields import Field, Fields, each, every_mistake, is_meant, is_sentence
from safety_harness.scenario.files import as_path, resolved
from safety_harness.scenario.kinds import FileKind, refuse_other_kind
from safety_harness.scenario.model import Scenario
from safety_harness.scenario.nodes import Mapping, Node, Scalar, parse_tree
from safety_harness.scenario.ours import files_of, yaml_files
from safety_harness.scenario.read import scenario_of_variant
from safety_harness.scenario.reference_tables import SUITE as SUITE_TABLE
from safety_harness.scenario.reference_tables import TOP

DEEPEST_SUITE = 8  # a choice, as the next two numbers
MOST_FILES = 1_000
MOST_SCENARIOS = 10_000
# For each key, the keys that its value depends on.  Beside an example of these, its error would mislead.
READ_WITH = {"duration": ("settings",)}
LONGEST = "duration: 60 min"  # an example within which every fault begins


class Mended(NamedTuple):
    """A scenario from a file with mistakes.

    An example replaces the value of each top key that has a mistake.
    """

    scenario: Scenario
    faulty: frozenset[str]


@dataclass
class Gathered:
    """The scenarios to which several paths lead, with all mistakes in their files.

    Spaces are included on request. The object visits files, folders and suites, path by path.
    """

    scenarios: list[Scenario] = field(default_factory=list)
    spaces: list[tuple[Variant, Path]] = field(default_factory=list)  # trees, for the package ``space``
    errors: list[InputError] = field(default_factory=list)
    mended: list[Mended] = field(default_factory=list)
    aside: list[Path] = field(default_factory=list)  # YAML files of folders that are not ours
    _spaces_too: bool = False
    _library: Library = field(default_factory=Library)
    _seen: set[Path] = field(default_factory=set)
    _names: dict[str, Path] = field(default_factory=dict)

    @property
    def _kinds(self) -> tuple[FileKind, ...]:
        """The kinds of file that the object accepts."""
        return (FileKind.SCENARIO, FileKind.SUITE, *[FileKind.SPACE] * self._spaces_too)

    def add(self, path: Path, place: Place | None = None, suites: tuple[Path, ...] = ()) -> None:
        """Add the scenarios to which ``path`` leads, and append the mistakes to ``errors``.

        Args:
            path: A file, a folder or a suite.
            place: The place at which the path's name is written, for error messages. None means the file
                itself.
            suites: The suites that led to ``path``, from the outermost to the innermost. The last suite
                contains the name of ``path``.

        """
        try:
            if path.is_dir() and not any(yaml_files(path)):
                refuse_other_kind(path, *self._kinds, FileKind.FOLDER, place=place)
            files, aside = files_of(path, self._kinds, place)
            self.aside += aside
            for file in files:
                # A suite that leads to itself must not be skipped here, because ``_add_suite`` reports the
                # circle.
                asked_for_itself = resolved(file) in suites and file == located(path)
                if resolved(file) in self._seen and not asked_for_itself:
                    continue
                self._seen.add(resolved(file))
                if len(self._seen) > MOST_FILES:
                    expected = f"at most {MOST_FILES:,} files"
                    raise ScenarioError(place=place or Place(file=file), expected=expected, got="more")
                self._add_file(file, place, suites)
        except InputError as error:
            self.errors.append(error)

    def _add_file(self, file: Path, place: Place | None, suites: tuple[Path, ...]) -> None:
        """Add the scenarios of one file.

        If the file is a suite, add the scenarios of the suite.
        """
        try:
            refuse_other_kind(file, *self._kinds, place=place)
            tree = self._library.tree(file, place)
            if isinstance(tree, Mapping) and any(key.text == SUITE for key, _ in tree.entries):
                self._add_suite(Field(tree, file, path="", line=1), file, place, suites)
                return
            rows: dict[Scenario, str] = {}
            for variant in variants(file, self._library):
                if self._spaces_too and is_space(variant.tree):
                    self.spaces.append((variant, file))
                    continue
                try:
                    scenario = scenario_of_variant(variant, file)
                except InputError:
                    self.errors += mistakes_of(variant, file, self.mended)
                    return
                if scenario.name.endswith("]"):
                    same = rows.setdefault(replace(scenario, name=""), scenario.name)
                    if same != scenario.name:  # its result would have a misleading name
                        place = Place(file=file, field="matrix")
                        got = f"{scenario.name} is the same as {same}"
                        raise ScenarioError(place=place, expected="rows that differ", got=got)
                self.take(scenario)
        except InputError as error:
            self.errors.append(error)

    def _add_suite(self, root: Field, file: Path, place: Place | None, suites: tuple[Path, ...]) -> None:
        """Add the scenarios of a suite and its mistakes.

        Raise ScenarioError if suites refer to each other in a circle or are nested too deeply.
        """
        if resolved(file) in suites:
            circle = " names ".join(suite.name for suite in (*suites, file))
            raise ScenarioError(
                place=place or root.place, expected="suites that do not name each other", got=circle
            )
        if len(suites) >= DEEPEST_SUITE:
            expected = f"suites of at most {DEEPEST_SUITE} levels"
            raise ScenarioError(place=place or root.place, expected=expected, got="a deeper one")
        listed = list[tuple[Path, Place]]()

        def read(item: Field) -> None:
            path = item.sentence("a file, a folder or a suite, relative to this one")
            listed.append((file.parent / path, item.place))

        def read_list(given: Fields) -> None:
            each(read, given.required("scenarios").items("a list of files, folders and suites", least=1))

        with every_mistake() as mistakes:
            given = root.fields(SUITE_TABLE.names)
            each(lambda read: read(given), (SUITE_TABLE.values, read_list))
        self.errors += mistakes
        for path, at in listed:
            self.add(path, at, (*suites, resolved(file)))

    def take(self, scenario: Scenario) -> None:
        """Add a scenario.

        Raise ScenarioError if the scenario's name is already in use, or if there are too many scenarios.
        """
        if scenario.name in self._names:
            got = f"the name {scenario.name!r} again, after {self._names[scenario.name]}"
            raise ScenarioError.of_file(scenario.file, "file names that tell the scenarios apart", got)
        if len(self._names) >= MOST_SCENARIOS:
            expected = f"at most {MOST_SCENARIOS:,} scenarios"
            raise ScenarioError(place=Place(file=scenario.file), expected=expected, got="more")
        self._names[scenario.name] = scenario.file or Path(scenario.name)
        self.scenarios.append(scenario)


def read_all_scenarios(path: str | Path) -> tuple[Scenario, ...]:
    """Return every scenario of a file, a folder or a suite.

    Args:
        path: The file or folder. A name of the form ``shipped:NAME`` is also accepted.

    Raises:
        InputError: The first mistake in the files.

    """
    gathered = gather([as_path(path, "read_all_scenarios(path)")])
    if gathered.errors:
        raise gathered.errors[0]
    return tuple(gathered.scenarios)


def gather(paths: Iterable[Path], *, spaces: bool = False) -> Gathered:
    """Return the scenarios of several paths, with all mistakes.

    A file is read once, even if several paths lead to it. For a file with a matrix, the result reports only
    the mistakes of the first faulty scenario.

    Args:
        paths: Files, folders and suites.
        spaces: Whether to accept scenario spaces. If this is false, a space is a mistake.

    """
    gathered, paths = Gathered(_spaces_too=spaces), list(paths)
    for path in paths:
        gathered.add(path)
    if not (gathered.scenarios or gathered.spaces or gathered.errors):
        place = Place(file=paths[0] if paths else None)
        gathered.errors.append(ScenarioError(place=place, expected="at least one scenario", got="none"))
    return gathered


def mistakes_of(variant: Variant, file: Path, mended: list[Mended]) -> list[InputError]:
    """Return the mistakes of a scenario.

    A mistake in one top key may hide mistakes in another. Therefore the function replaces each wrong top key
    by an example, and reads the scenario again. The function appends the scenario with these examples to
    ``mended``.
    """
    errors, tree, faulty, there = list[InputError](), variant.tree, set[str](), set[str]()
    while True:
        with every_mistake() as mistakes:
            scenario = scenario_of_variant(replace(variant, tree=tree), file)
        if not mistakes:
            mended.append(Mended(scenario, frozenset(faulty)))
        if not isinstance(tree, Mapping) or not mistakes:
            return errors or mistakes
        there = there or {key.text for key, _ in tree.entries}
        named = [(_top_key(tree, error), error) for error in mistakes]
        # Later passes report only further keys, and no error that an example may have caused.
        for name, error in named:
            if not faulty:
                errors.append(error)
            elif name and name not in faulty and faulty.isdisjoint(READ_WITH.get(name, ())):
                missing = ScenarioError(place=error.place, expected=error.expected, got="none")
                errors.append(error if name in there else missing)  # its own text would mention examples
        meant = {key for key in TOP.names if any(is_meant(key, error) for error in mistakes)} - there
        names = {name for name, _ in named if name}.union(meant) - faulty
        if not names:
            return errors
        faulty |= names
        examples = [key.lines for key in TOP.keys if key.name in names and key.required]
        text = "\n".join(LONGEST if line.startswith("duration:") else line for line in examples)
        # The example of claims would hide mistakes in the file's own sentences, so keep the sentences.
        claims = [(key, _as_holding(node)) for key, node in tree.entries if key.text == "claims" in names]
        tree = merged(without_keys(tree, names), parse_tree(text or "{}", None))
        tree = merged(tree, Mapping(tuple(claims), 1))


def _as_holding(claims: Node) -> Mapping:
    """Return the sentences of ``claims``, each with the expected verdict "holds"."""
    entries = claims.entries if isinstance(claims, Mapping) else ()
    sentences = (key for key, _ in entries if is_sentence(key.text))
    return Mapping(tuple((key, Scalar("holds", key.line, key.file)) for key in sentences), claims.line)


def _top_key(tree: Mapping, error: InputError) -> str | None:
    """Return the top key that caused ``error``, or None if no key caused it.

    The cause may be the key's value or its absence.
    """
    field = error.place.field or ""
    names = (*TOP.names, *(key.text for key, _ in tree.entries))
    return next((name for name in names if re.match(rf"{re.escape(name)}($|[.\[])", field)), None)
