"""A scenario's tree with gaps: fixed nodes, and places that a space's parameters fill.

A value is written into the tree as an exact quantity in its SI unit, so that the ordinary reader reads it
and the language stays one.
"""

from __future__ import annotations

from collections.abc import Sequence as Values
from dataclasses import dataclass
from functools import cached_property
from math import isfinite
from typing import Any, TypeAlias

from safety_harness.exceptions import Place
from safety_harness.scenario.nodes import Mapping, Node, Scalar, Sequence
from safety_harness.space.distributions import Distribution


@dataclass(frozen=True)
class Given:
    """A parameter's value: a quantity, or a list of three."""

    parameter: int
    line: int


@dataclass(frozen=True)
class Alternatives:
    """One of several subtrees, by the number that a parameter has."""

    parameter: int
    options: tuple[Template, ...]
    line: int


@dataclass(frozen=True)
class Repeated:
    """Members of a list, ``least`` times and as often again as a parameter says.

    ``copies`` are all of them, the most that there can be; each has parameters of its own.
    """

    parameter: int
    least: int
    copies: tuple[tuple[Template, ...], ...]
    line: int


@dataclass(frozen=True)
class Listing:
    """A list with gaps in it."""

    items: tuple[Template, ...]
    line: int


@dataclass(frozen=True)
class Keyed:
    """A mapping with gaps in it."""

    entries: tuple[tuple[Scalar, Template], ...]
    line: int


Template: TypeAlias = Node | Given | Alternatives | Repeated | Listing | Keyed


@dataclass(frozen=True)
class Condition:
    """That a parameter's number is from ``least`` to ``most``."""

    parameter: int
    least: int
    most: int


@dataclass(frozen=True)
class Parameter:
    """One thing that varies.

    ``name`` is its path in the file, for people; ``column`` its first one in the cube.  It is used
    when all the conditions of one of ``when`` hold: its alternative is taken, its repetition happens.
    """

    name: str
    distribution: Distribution
    column: int
    when: tuple[tuple[Condition, ...], ...]
    place: Place

    @cached_property
    def columns(self) -> slice:
        """Its coordinates in the cube, and in an array of values."""
        return slice(self.column, self.column + self.distribution.columns)


def filled(
    template: Template,
    parameters: Values[Parameter],
    values: Values[float],
    known: Values[Any] | None = None,
) -> Node:
    """The tree that ``values`` (one for each coordinate) give; ``known`` are the numbers read from it."""
    if isinstance(template, Node):
        return template
    if isinstance(template, Keyed):
        entries = ((key, filled(child, parameters, values, known)) for key, child in template.entries)
        return Mapping(tuple(entries), template.line)
    if isinstance(template, Listing):
        items: list[Node] = []
        for item in template.items:
            if isinstance(item, Repeated):
                times = item.least + int(values[parameters[item.parameter].column])
                for copy in item.copies[:times]:
                    items += [filled(child, parameters, values, known) for child in copy]
            else:
                items.append(filled(item, parameters, values, known))
        return Sequence(tuple(items), template.line)
    assert not isinstance(template, Repeated)  # stands in lists only
    parameter = parameters[template.parameter]
    if isinstance(template, Alternatives):
        return filled(template.options[int(values[parameter.column])], parameters, values, known)
    unit, line, columns = parameter.distribution.unit, template.line, parameter.columns
    measures = tuple(
        Scalar(written(value, unit), line, drawn=(number, unit) if isfinite(value) else None)
        for value, number in zip(values[columns], (known or values)[columns], strict=True)
    )
    return measures[0] if len(measures) == 1 else Sequence(measures, line)


def written(value: float, unit: str) -> str:
    """A quantity from which the reader gives the same float again."""
    return f"{float(value)!r} {unit}".rstrip()
