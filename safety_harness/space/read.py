"""Scenario spaces from files and texts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from safety_harness.exceptions import Place, ScenarioError
from safety_harness.geometry.regions import Box, Region
from safety_harness.scenario.compose import MATRIX, Library, variants
from safety_harness.scenario.fields import Field
from safety_harness.scenario.nodes import Node, parse_tree
from safety_harness.scenario.only_in_spaces import SPACE_KEY
from safety_harness.space.boxes import InRegion
from safety_harness.space.probing import try_out
from safety_harness.space.reading import read_template
from safety_harness.space.regions import region_named, seen_by
from safety_harness.space.space import ScenarioSpace
from safety_harness.space.template import Parameter

_SOMEWHERE = Region(Box((0.7, -0.3, 0.2), (0.8, -0.2, 0.3)))  # while the settings are not read yet


def read_space(path: Path, library: Library | None = None) -> ScenarioSpace:
    """The scenario space in a file; InputError with its place when it cannot be used as it stands.

    ``library`` is told of every file that is read.
    """
    found = variants(path, library or Library())
    if len(found) > 1:
        got = f"a matrix of {len(found)}"
        raise ScenarioError(place=Place(file=path, field=MATRIX), expected="one scenario space", got=got)
    return space_of(found[0].tree, path, name=found[0].name)


def parse_space(
    text: str, file: Path | None = None, recordings: Mapping[str, bytes] | None = None
) -> ScenarioSpace:
    """The scenario space that ``text`` describes; ``file`` and ``recordings`` as for ``parse_scenario``.

    Every parameter is tried out: its ends, a value between them, every one of its alternatives.  What the
    scenario reader refuses of these is refused here, and so is a value that could not be read back.
    """
    return space_of(parse_tree(text, file), file, recordings)


def space_of(
    tree: Node, file: Path | None, recordings: Mapping[str, bytes] | None = None, *, name: str | None = None
) -> ScenarioSpace:
    """As ``parse_space``, for a text that is a tree already."""
    root = Field(tree, file, path="", line=1)
    template, parameters = read_template(root)
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
    try_out(space)
    return space


def _with_regions(space: ScenarioSpace) -> ScenarioSpace:
    """The space with its named regions, which are about what its avoider has seen."""
    if not any(isinstance(parameter.distribution, InRegion) for parameter in space.parameters):
        return space

    def unknown(parameter: Parameter) -> Parameter:
        if not isinstance(parameter.distribution, InRegion):
            return parameter
        return replace(parameter, distribution=InRegion(parameter.distribution.name, _SOMEWHERE))

    base = replace(space, parameters=tuple(map(unknown, space.parameters))).simplest
    folder = space.file.parent if space.file else None
    seen = seen_by(base.avoider, folder=folder, settings=base.settings)
    x, y, z = base.settings.cell.desired_tcp_position_in_base_m

    def known(parameter: Parameter) -> Parameter:
        if not isinstance(parameter.distribution, InRegion):
            return parameter
        name = parameter.distribution.name
        region = region_named(name, seen, base.settings)
        if parameter.name.startswith("tcp start") and ".offset" in parameter.name:
            region = region.shifted((-x, -y, -z))  # the start is a shift from the desired TCP
        return replace(parameter, distribution=InRegion(name, region))

    return replace(
        space,
        parameters=tuple(map(known, space.parameters)),
        notes=(f"the seen space is that of {seen.source}",),
    )
