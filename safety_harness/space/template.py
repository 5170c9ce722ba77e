"""A scenario's tree with gaps: fixed nodes, and places that a space's parameters fill.

A value is written into the tree as an exact quantity in its SI unit, so that the ordinary reader reads it
and the language stays one.  From a scenario back to values, its written tree is laid over the template, gap
by gap: what is found is a guess that the template allows; the caller fills it in and compares.
"""

from __future__ import annotations

from collections import abc
from collections.abc import Iterator
from collections.abc import Sequence as Values
from dataclasses import dataclass
from functools import cached_property
from math import isfinite
from typing import Any, TypeAlias

import numpy as np

from safety_harness.base.exceptions import Place, ScenarioError
from safety_harness.scenario.codec import Tree, scalar_text
from safety_harness.scenario.fields import Field
from safety_harness.scenario.nodes import Mapping, Node, Scalar, Sequence
from safety_harness.space.distributions import Distribution
from safety_harness.space.sentences import fixed_quantity


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
Found: TypeAlias = dict[int, tuple[float, ...]]  # the values of each parameter that was met


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


def matches(template: Template, written: Tree, parameters: Values[Parameter]) -> Iterator[Found]:
    """Every way to read ``written`` (by ``scenario.write.tree_of``) as something the template gives."""
    yield from _Matcher(parameters).below(template, written, {}, False)


class _Matcher:
    """``strict`` is whether fixed parts must be alike, which tells alternatives apart."""

    def __init__(self, parameters: Values[Parameter]) -> None:
        self._parameters = parameters

    def below(self, template: Template, written: Tree, found: Found, strict: bool) -> Iterator[Found]:
        if isinstance(template, Node):
            if not strict or _alike(template, written):
                yield found
        elif isinstance(template, Given):
            yield from self._given(template, written, found)
        elif isinstance(template, Alternatives):
            for number, option in enumerate(template.options):
                chosen = _with(found, template.parameter, (float(number),))
                if chosen is not None:
                    yield from self.below(option, written, chosen, True)
        elif isinstance(template, Listing):
            listed = _listed(written)
            if listed is not None:
                exactly = strict or any(isinstance(item, Repeated) for item in template.items)
                yield from self._items(template.items, listed, found, exactly)
        elif (
            isinstance(template, Keyed)
            and isinstance(written, abc.Mapping)
            and (not strict or _same_keys(template.entries, written))
        ):
            yield from self._entries(template.entries, written, found, strict)

    def _given(self, template: Given, written: Tree, found: Found) -> Iterator[Found]:
        distribution = self._parameters[template.parameter].distribution
        texts = _listed(written) if distribution.columns > 1 else [written]
        if texts is None or len(texts) != distribution.columns:
            return
        values = tuple(value for text in texts if (value := _number(text, distribution.unit)) is not None)
        chosen = _with(found, template.parameter, values) if len(values) == len(texts) else None
        if chosen is not None and distribution.log_density(np.array([values]))[0] > -np.inf:
            yield chosen

    def _items(
        self, items: Values[Template], written: Values[Tree], found: Found, strict: bool
    ) -> Iterator[Found]:
        if not items:
            if not written:
                yield found
            return
        first, others = items[0], items[1:]
        if isinstance(first, Repeated):
            for times in range(first.least, len(first.copies) + 1):
                chosen = _with(found, first.parameter, (float(times - first.least),))
                if chosen is not None:
                    expanded = [item for copy in first.copies[:times] for item in copy]
                    yield from self._items([*expanded, *others], written, chosen, strict)
        elif written:
            for one in self.below(first, written[0], found, strict):
                yield from self._items(others, written[1:], one, strict)

    def _entries(
        self,
        entries: Values[tuple[Scalar, Template]],
        written: abc.Mapping[str, Tree],
        found: Found,
        strict: bool,
    ) -> Iterator[Found]:
        if not entries:
            yield found
            return
        (key, template), others = entries[0], entries[1:]
        text = scalar_text(key.text)
        if text in written:
            for one in self.below(template, written[text], found, strict):
                yield from self._entries(others, written, one, strict)
        elif isinstance(template, Node):
            yield from self._entries(others, written, found, strict)


def _with(found: Found, parameter: int, values: tuple[float, ...]) -> Found | None:
    """``found`` with one more; None where the parameter was met before with other values."""
    if parameter in found:
        return found if found[parameter] == values else None
    return {**found, parameter: values}


def _alike(node: Node, written: Tree) -> bool:
    """Whether a fixed part is what was written of it, as far as can be told without reading it."""
    if isinstance(node, Mapping):
        if not isinstance(written, abc.Mapping) or not _same_keys(node.entries, written):
            return False
        return all(_alike(child, written[scalar_text(key.text)]) for key, child in node.entries)
    if isinstance(node, Sequence):
        listed = _listed(written)
        return (
            listed is not None
            and len(listed) == len(node.items)
            and all(_alike(child, item) for child, item in zip(node.items, listed, strict=True))
        )
    if not isinstance(written, str):
        return False
    if written == scalar_text(node.text) or written == scalar_text(node.text.replace(" ", "_")):
        return True
    try:
        value, unit = fixed_quantity(Field(node, None, "", node.line))
    except ScenarioError:
        return False
    return _number(written, unit) == value


def _same_keys(entries: Values[tuple[Scalar, object]], written: abc.Mapping[str, Tree]) -> bool:
    """Whether every key was written; the reader's defaults may have added others."""
    return all(scalar_text(key.text) in written for key, _ in entries)


def _listed(written: Tree) -> Values[Tree] | None:
    """The members of a list; None of anything else."""
    return None if isinstance(written, str | abc.Mapping) else written


def _number(written: Tree, unit: str) -> float | None:
    """The value of a quantity that was written in SI; None for another unit, or for no quantity."""
    if not isinstance(written, str):
        return None
    number, _, its_unit = written.partition(" ")
    if its_unit != unit:
        return None
    try:
        return float(number)
    except ValueError:
        return None
