"""Every scenario that a path leads to: a file, each combination of its matrix, a folder, a suite."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path

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
from safety_harness.scenario.fields import Field
from safety_harness.scenario.files import as_path, resolved
from safety_harness.scenario.kinds import FileKind, refuse_other_kind
from safety_harness.scenario.model import Scenario
from safety_harness.scenario.nodes import Mapping, parse_tree
from safety_harness.scenario.ours import files_of, yaml_files
from safety_harness.scenario.read import scenario_of_variant
from safety_harness.scenario.reference_tables import SUITE as SUITE_TABLE
from safety_harness.scenario.reference_tables import TOP

DEEPEST_SUITE = 8
MOST_FILES = 1_000
MOST_SCENARIOS = 10_000
# What a key's value is held against: of one read beside an example of that no mistake is told.
READ_WITH = {"duration": ("settings",), "faults": ("duration", "settings")}


@dataclass
class Gathered:
    """What several paths lead to: the scenarios, the spaces if asked for, the mistakes on the way.

    It walks through files, folders and suites, path by path.
    """

    scenarios: list[Scenario] = field(default_factory=list)
    spaces: list[tuple[Variant, Path]] = field(default_factory=list)  # trees, which another room reads
    errors: list[InputError] = field(default_factory=list)
    mended: list[Scenario] = field(default_factory=list)  # files with mistakes, examples in their places
    aside: list[Path] = field(default_factory=list)  # YAML files of folders that are not taken
    _spaces_too: bool = False
    _library: Library = field(default_factory=Library)
    _seen: set[Path] = field(default_factory=set)
    _names: dict[str, Path] = field(default_factory=dict)

    @property
    def _kinds(self) -> tuple[FileKind, ...]:
        return (FileKind.SCENARIO, FileKind.SUITE, *[FileKind.SPACE] * self._spaces_too)

    def add(self, path: Path, place: Place | None = None, suites: tuple[Path, ...] = ()) -> None:
        """What ``path``, named at ``place`` in the last of ``suites``, leads to."""
        try:
            if path.is_dir() and not any(yaml_files(path)):
                refuse_other_kind(path, *self._kinds, FileKind.FOLDER, place=place)
            files, aside = files_of(path, self._kinds, place)
            self.aside += aside
            for file in files:
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
                except InputError as first:
                    self.errors += mistakes_of(variant, file, first, self.mended)
                    return
                if scenario.name.endswith("]"):
                    same = rows.setdefault(replace(scenario, name=""), scenario.name)
                    if same != scenario.name:  # it would hold under a name that says otherwise
                        place = Place(file=file, field="matrix")
                        got = f"{scenario.name} is the same as {same}"
                        raise ScenarioError(place=place, expected="rows that differ", got=got)
                self.take(scenario)
        except InputError as error:
            self.errors.append(error)

    def _add_suite(self, root: Field, file: Path, place: Place | None, suites: tuple[Path, ...]) -> None:
        if resolved(file) in suites:
            words = " names ".join(one.name for one in (*suites, file))
            raise ScenarioError(
                place=place or root.place, expected="suites that do not name each other", got=words
            )
        if len(suites) >= DEEPEST_SUITE:
            expected = f"suites of at most {DEEPEST_SUITE} levels"
            raise ScenarioError(place=place or root.place, expected=expected, got="a deeper one")
        given = root.fields(SUITE_TABLE.names)
        SUITE_TABLE.values(given)
        for item in given.required("scenarios").items("a list of files, folders and suites", least=1):
            path = file.parent / item.sentence("a file, a folder or a suite, relative to this one")
            self.add(path, item.place, (*suites, resolved(file)))

    def take(self, scenario: Scenario) -> None:
        """Add a scenario; ScenarioError if its name is taken or there are too many."""
        if scenario.name in self._names:
            got = f"the name {scenario.name!r} again, after {self._names[scenario.name]}"
            raise ScenarioError.of_file(scenario.file, "file names that tell the scenarios apart", got)
        if len(self._names) >= MOST_SCENARIOS:
            expected = f"at most {MOST_SCENARIOS:,} scenarios"
            raise ScenarioError(place=Place(file=scenario.file), expected=expected, got="more")
        self._names[scenario.name] = scenario.file or Path(scenario.name)
        self.scenarios.append(scenario)


def read_all_scenarios(path: str | Path) -> tuple[Scenario, ...]:
    """Every scenario of a file, a folder or a suite; the first mistake is raised, an InputError."""
    gathered = gather([as_path(path, "read_all_scenarios(path)")])
    if gathered.errors:
        raise gathered.errors[0]
    return tuple(gathered.scenarios)


def gather(paths: Iterable[Path], *, spaces: bool = False) -> Gathered:
    """As ``read_all_scenarios`` for several paths, with all mistakes and not only the first.

    A file counts once, however often it is named; of a matrix only the first scenario that has mistakes is
    told of.
    Scenario spaces are refused unless ``spaces`` asks for them.
    """
    found, paths = Gathered(_spaces_too=spaces), list(paths)
    for path in paths:
        found.add(path)
    if not (found.scenarios or found.spaces or found.errors):
        place = Place(file=paths[0] if paths else None)
        found.errors.append(ScenarioError(place=place, expected="at least one scenario", got="none"))
    return found


def mistakes_of(variant: Variant, file: Path, first: InputError, mended: list[Scenario]) -> list[InputError]:
    """The first mistake below each top key of a scenario, read with examples in place of the wrong ones.

    The scenario that these examples make of it is added to ``mended``.
    """
    found, tree, wrong, error = [first], variant.tree, set[str](), first
    while isinstance(tree, Mapping) and (name := _top_key(tree, error)) and name not in wrong:
        if wrong and wrong.isdisjoint(READ_WITH.get(name, ())):
            there = any(key.text == name for key, _ in tree.entries)
            missing = ScenarioError(place=error.place, expected=error.expected, got="none")
            found.append(error if there else missing)  # whose words would be of examples
        wrong.add(name)
        example = next((key.lines for key in TOP.keys if key.name == name and key.required), "{}")
        tree = merged(without_keys(tree, {name}), parse_tree(example, None))
        try:
            mended.append(scenario_of_variant(replace(variant, tree=tree), file))
            break
        except InputError as another:
            error = another
    return found


def _top_key(tree: Mapping, error: InputError) -> str | None:
    """The top key at whose value, or for want of which, it came to an error."""
    field = error.place.field or ""
    names = (*TOP.names, *(key.text for key, _ in tree.entries))
    return next((name for name in names if re.match(rf"{re.escape(name)}($|[.\[])", field)), None)
