"""Read scenario spaces from files and texts, and try some of the values that a space allows.

The trial uses both ends of every parameter, a value between them, and every alternative.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.exceptions import ScenarioError, refuse_other_type
from safety_harness.base.geometry.regions import Box, Region
from safety_harness.scenario.compose import SPACE_KEY, Library, only_variant
from safety_harness.scenario.fields import Field
from safety_harness.scenario.files import as_path
from safety_harness.scenario.kinds import FileKind, refuse_other_kind
from safety_harness.scenario.model import Scenario
from safety_harness.scenario.nodes import Node, parse_tree
from safety_harness.space.distributions import Choice, InRegion
from safety_harness.space.reading import TemplateReader
from safety_harness.space.regions import region_named, seen_by
from safety_harness.space.space import ScenarioSpace
from safety_harness.space.template import Parameter

Vector = NDArray[np.float64]

_INNER = 0.381966  # a cube coordinate; no round number, so that whole numbers differ from fractions
_SOMEWHERE = Region(Box((0.7, -0.3, 0.2), (0.8, -0.2, 0.3)))  # before the settings are read


def read_space(path: str | Path, library: Library | None = None) -> ScenarioSpace:
    """Return the scenario space in a file.

    Args:
        path: The file, or ``shipped:NAME``.  For a text, use ``parse_space``.
        library: An object that records every file that is read.  None means that no files are recorded.

    Raises:
        InputError: The file is unusable.  The error states the place.

    """
    path = as_path(path, "read_space(path)", of_text="parse_space")
    refuse_other_kind(path, FileKind.SPACE)
    variant = only_variant(path, library or Library(), "one scenario space")
    return space_of(variant.tree, path, name=variant.name)


def parse_space(
    text: str, file: Path | None = None, recordings: Mapping[str, bytes] | None = None
) -> ScenarioSpace:
    """Return the scenario space that ``text`` describes.

    The reader tries every parameter at its ends and at a value between them, or at each of its alternatives.
    The reader refuses the space if the scenario reader refuses such a value, or if the value cannot be
    recovered from the scenario.

    Args:
        text: The text.
        file: A path whose folder contains the recordings.  None means the working directory.
        recordings: Contents of recordings by their SHA-256, as for ``parse_scenario``.

    Raises:
        InputError: The text is unusable.  The error states the place.

    """
    refuse_other_type("parse_space(text)", text, str, expected="a text", hint="read_space(path) reads a file")
    return space_of(parse_tree(text, file), file, recordings)


def space_of(
    tree: Node, file: Path | None, recordings: Mapping[str, bytes] | None = None, *, name: str | None = None
) -> ScenarioSpace:
    """Return the scenario space that ``tree`` describes.

    ``name`` is the name of the space, and the remaining arguments have the same meaning as in
    ``parse_space``.
    """
    root = Field(tree, file, path="", line=1)
    template, parameters = TemplateReader().whole(root)
    space = ScenarioSpace(
        name=name or (file.stem if file else "unnamed"),
        title=dict(root.entries("a mapping"))[SPACE_KEY].prose("a title on one line"),
        file=file,
        tree=tree,
        template=template,
        parameters=parameters,
        recordings=recordings,
    )
    space = _with_regions(space)
    _try_out(space)
    return space


def _with_regions(space: ScenarioSpace) -> ScenarioSpace:
    """Return the space with its named regions resolved by means of its avoider's training data."""
    if not any(isinstance(item.distribution, InRegion) for item in space.parameters):
        return space

    def with_regions(region_of: Callable[[str, str], Region], *notes: str) -> ScenarioSpace:
        parameters = (
            replace(parameter, distribution=InRegion(at.name, region_of(at.name, parameter.name)))
            if isinstance(at := parameter.distribution, InRegion)
            else parameter
            for parameter in space.parameters
        )
        return replace(space, parameters=tuple(parameters), notes=notes)

    def region(name: str, path: str) -> Region:
        named = region_named(name, seen, base.settings)
        a_shift = path.startswith("tcp start") and ".offset" in path  # from the desired TCP
        return named.shifted((-x, -y, -z)) if a_shift else named

    base = with_regions(lambda name, path: _SOMEWHERE).simplest
    folder = space.file.parent if space.file else None
    seen = seen_by(base.under_test, folder=folder, settings=base.settings)
    x, y, z = base.settings.cell.desired_tcp_position_in_base_m
    return with_regions(region, f"the seen space is that of {seen.source}")


def _try_out(space: ScenarioSpace) -> None:
    """Raise ScenarioError for the first value that the reader refuses or that cannot be recovered."""
    for claim in space.simplest.claims:
        if claim.most is not None:
            expected = "holds, violated or inconclusive, without a bound, in a space"
            raise ScenarioError(place=claim.place, expected=expected, got=claim.expectation)
    anchors = _anchors(space.scenario(space.simplest_values))
    for parameter in space.parameters:
        for values, read_back in _trials(space, parameter):
            scenario = space.scenario(values)
            if space.notes and _anchors(scenario) != anchors:
                raise ScenarioError(
                    place=parameter.place,
                    expected="the same avoider, desired TCP, nominal hand and table throughout",
                    got="one that varies",
                    hint='what "seen" and "unseen" mean depends on them',
                )
            if read_back and scenario not in space:
                raise ScenarioError(
                    place=parameter.place,
                    expected="a value that the scenario shows again",
                    got="one that is lost in reading",
                    hint="of two keys that say the same, vary the one that a written scenario has",
                )


def _trials(space: ScenarioSpace, parameter: Parameter) -> Iterator[tuple[Vector, bool]]:
    """Yield values (d,) for trials of ``parameter``.

    A scenario with these values uses the parameter.  A flag comes with the values, and is True if the values
    must be recoverable from the scenario.
    """
    raw = np.concatenate([each.distribution.simplest for each in space.parameters])
    for condition in parameter.when[0] if parameter.when else ():
        raw[space.parameters[condition.parameter].column] = condition.least
    distribution = parameter.distribution
    if isinstance(distribution, Choice):
        trials = [((float(number),), True) for number in range(len(distribution.labels))]
    else:
        u = np.array([0.0, 1.0, _INNER])[:, None].repeat(distribution.columns, axis=1)
        ends_and_between = distribution.values_at(u)
        trials = [(tuple(row), number == 2) for number, row in enumerate(ends_and_between)]
    for value, read_back in trials:
        values = raw.copy()
        values[parameter.columns] = value
        yield space.without_unused(values[None])[0], read_back


def _anchors(scenario: Scenario) -> tuple[object, ...]:
    """Return the settings on which the named regions depend."""
    cell, avoidance = scenario.settings.cell, scenario.settings.avoidance
    return (
        scenario.under_test,
        cell.desired_tcp_position_in_base_m,
        cell.table_height_m,
        avoidance.nominal_hand_position_in_base_m,
    )
