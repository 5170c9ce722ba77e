"""The tree of a scenario with gaps, where the parameters of a space fill the gaps.

A value is inserted into the tree as a quantity in its SI unit, without rounding.  Therefore the ordinary
reader can read the tree, and no second file format is needed.  To find the values of a scenario, the written
tree of the scenario is compared with the template, gap by gap.  A match may be wrong, so the caller must
insert the values and compare the resulting scenario with the original.
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
    """A gap for the value of a parameter, which is a quantity or a list of three quantities."""

    parameter: int
    line: int


@dataclass(frozen=True)
class Alternatives:
    """A gap for one of several subtrees, which the value of a parameter selects."""

    parameter: int
    options: tuple[Template, ...]
    line: int


@dataclass(frozen=True)
class Repeated:
    """A gap in a list for repeated members.

    The number of copies is ``least`` plus the value of a parameter.  ``copies`` contains the largest possible
    number of copies, and each copy has its own parameters.
    """

    parameter: int
    least: int
    copies: tuple[tuple[Template, ...], ...]
    line: int


@dataclass(frozen=True)
class Listing:
    """A list with gaps."""

    items: tuple[Template, ...]
    line: int


@dataclass(frozen=True)
class Keyed:
    """A mapping with gaps."""

    entries: tuple[tuple[Scalar, Template], ...]
    line: int


Template: TypeAlias = Node | Given | Alternatives | Repeated | Listing | Keyed
Match: TypeAlias = dict[int, tuple[float, ...]]  # the values of each parameter so far


@dataclass(frozen=True)
class Condition:
    """The condition that the value of a parameter is an index between ``least`` and ``most``."""

    parameter: int
    least: int
    most: int


@dataclass(frozen=True)
class Parameter:
    """A value that varies between the scenarios of a space.

    Args:
        name: The path of the value in the file, for people.
        distribution: Its distribution.
        column: The first coordinate of the parameter in the unit cube.
        when: The conditions under which a scenario uses the parameter, as a tuple of tuples.  It does so if
            all conditions in at least one of the tuples are true.
        place: The place of the value in the file.

    """

    name: str
    distribution: Distribution
    column: int
    when: tuple[tuple[Condition, ...], ...]
    place: Place

    @cached_property
    def columns(self) -> slice:
        """The coordinates of the parameter in the unit cube.

        The coordinates are also the columns of the parameter in an array of values.
        """
        return slice(self.column, self.column + self.distribution.columns)


def filled(
    template: Template,
    parameters: Values[Parameter],
    values: Values[float],
    known: Values[Any] | None = None,
) -> Node:
    """Return the tree that results from inserting the given values into the template.

    Args:
        template: The template.
        parameters: The parameters of the space.
        values: The values, one for each coordinate.
        known: Numbers that replace the values in the reader.  None means that the values are not replaced.

    """
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
    """Return the text of a quantity, from which the reader returns the same float."""
    return f"{float(value)!r} {unit}".rstrip()


def matches(template: Template, written: Tree, parameters: Values[Parameter]) -> Iterator[Match]:
    """Yield every match of the tree ``written`` with the template.

    ``scenario.write.tree_of`` returns such a tree.  A match contains the values of each parameter that occurs
    in it.
    """
    yield from _Matcher(parameters).below(template, written, {}, False)


class _Matcher:
    """The comparison of a written tree with a template.

    If ``strict`` is true, fixed parts must be equal as well.  The matcher uses this mode to distinguish
    between alternatives.
    """

    def __init__(self, parameters: Values[Parameter]) -> None:
        self._parameters = parameters

    def below(self, template: Template, written: Tree, matched: Match, strict: bool) -> Iterator[Match]:
        """Yield every match of ``template`` with ``written`` that extends the match ``matched``."""
        if isinstance(template, Node):
            if not strict or _alike(template, written):
                yield matched
        elif isinstance(template, Given):
            yield from self._given(template, written, matched)
        elif isinstance(template, Alternatives):
            for number, option in enumerate(template.options):
                chosen = _with(matched, template.parameter, (float(number),))
                if chosen is not None:
                    yield from self.below(option, written, chosen, True)
        elif isinstance(template, Listing):
            listed = _listed(written)
            if listed is not None:
                exactly = strict or any(isinstance(item, Repeated) for item in template.items)
                yield from self._items(template.items, listed, matched, exactly)
        elif (
            isinstance(template, Keyed)
            and isinstance(written, abc.Mapping)
            and (not strict or _same_keys(template.entries, written))
        ):
            yield from self._entries(template.entries, written, matched, strict)

    def _given(self, template: Given, written: Tree, matched: Match) -> Iterator[Match]:
        """Yield ``matched`` extended by a parameter's value, if the written tree has a possible value."""
        distribution = self._parameters[template.parameter].distribution
        texts = _listed(written) if distribution.columns > 1 else [written]
        if texts is None or len(texts) != distribution.columns:
            return
        values = tuple(value for text in texts if (value := _number(text, distribution.unit)) is not None)
        chosen = _with(matched, template.parameter, values) if len(values) == len(texts) else None
        if chosen is not None and distribution.log_density(np.array([values]))[0] > -np.inf:
            yield chosen

    def _items(
        self, items: Values[Template], written: Values[Tree], matched: Match, strict: bool
    ) -> Iterator[Match]:
        """Yield every way to extend ``matched`` by the members of a list."""
        if not items:
            if not written:
                yield matched
            return
        first, rest = items[0], items[1:]
        if isinstance(first, Repeated):
            for times in range(first.least, len(first.copies) + 1):
                chosen = _with(matched, first.parameter, (float(times - first.least),))
                if chosen is not None:
                    expanded = [item for copy in first.copies[:times] for item in copy]
                    yield from self._items([*expanded, *rest], written, chosen, strict)
        elif written:
            for match in self.below(first, written[0], matched, strict):
                yield from self._items(rest, written[1:], match, strict)

    def _entries(
        self,
        entries: Values[tuple[Scalar, Template]],
        written: abc.Mapping[str, Tree],
        matched: Match,
        strict: bool,
    ) -> Iterator[Match]:
        """Yield every way to extend ``matched`` by the entries of a mapping."""
        if not entries:
            yield matched
            return
        (key, template), rest = entries[0], entries[1:]
        text = scalar_text(key.text)
        if text in written:
            for match in self.below(template, written[text], matched, strict):
                yield from self._entries(rest, written, match, strict)
        elif isinstance(template, Node):
            yield from self._entries(rest, written, matched, strict)


def _with(matched: Match, parameter: int, values: tuple[float, ...]) -> Match | None:
    """Return ``matched`` extended by one parameter.

    Return None if it already contains different values of the parameter.
    """
    if parameter in matched:
        return matched if matched[parameter] == values else None
    return {**matched, parameter: values}


def _alike(node: Node, written: Tree) -> bool:
    """Return whether a fixed part and the written tree are equal, judged by their texts."""
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
    """Return whether the written mapping has all keys of a template.

    Further keys are allowed, because they may be defaults.
    """
    return all(scalar_text(key.text) in written for key, _ in entries)


def _listed(written: Tree) -> Values[Tree] | None:
    """Return the members of a written list, or None if ``written`` is not a list."""
    return None if isinstance(written, str | abc.Mapping) else written


def _number(written: Tree, unit: str) -> float | None:
    """Return the number of a written quantity.

    Return None if the text is not a quantity with the unit ``unit``.
    """
    if not isinstance(written, str):
        return None
    number, _, its_unit = written.partition(" ")
    if its_unit != unit:
        return None
    try:
        return float(number)
    except ValueError:
        return None
