"""From a scenario back to values: its written tree is laid over the template, gap by gap.

What is found here is a guess that the template allows; the caller fills it in and compares.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TypeAlias

import numpy as np

from safety_harness.exceptions import ScenarioError
from safety_harness.scenario.codec import Tree, scalar_text
from safety_harness.scenario.fields import Field
from safety_harness.scenario.nodes import Mapping as MappingNode
from safety_harness.scenario.nodes import Node, Scalar
from safety_harness.scenario.nodes import Sequence as SequenceNode
from safety_harness.space.sentences import fixed_quantity
from safety_harness.space.template import Alternatives, Given, Keyed, Listing, Parameter, Repeated, Template

Found: TypeAlias = dict[int, tuple[float, ...]]  # the values of each parameter that was met


def matches(template: Template, written: Tree, parameters: Sequence[Parameter]) -> Iterator[Found]:
    """Every way to read ``written`` (by ``scenario.write.tree_of``) as something the template gives."""
    yield from _Matcher(parameters).below(template, written, {}, False)


class _Matcher:
    """``strict`` is whether fixed parts must be alike, which tells alternatives apart."""

    def __init__(self, parameters: Sequence[Parameter]) -> None:
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
            and isinstance(written, Mapping)
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
        self, items: Sequence[Template], written: Sequence[Tree], found: Found, strict: bool
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
        entries: Sequence[tuple[Scalar, Template]],
        written: Mapping[str, Tree],
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
    if isinstance(node, MappingNode):
        if not isinstance(written, Mapping) or not _same_keys(node.entries, written):
            return False
        return all(_alike(child, written[scalar_text(key.text)]) for key, child in node.entries)
    if isinstance(node, SequenceNode):
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


def _same_keys(entries: Sequence[tuple[Scalar, object]], written: Mapping[str, Tree]) -> bool:
    """Whether every key was written; the reader's defaults may have added others."""
    return all(scalar_text(key.text) in written for key, _ in entries)


def _listed(written: Tree) -> Sequence[Tree] | None:
    """The members of a list, also of one in a line: ``[0.1 m, 0.2 m, 0.3 m]``."""
    if not isinstance(written, str):
        return None if isinstance(written, Mapping) else written
    if not (written.startswith("[") and written.endswith("]")):
        return None
    members, depth, start = [], 0, 1
    for place, character in enumerate(written):
        depth += (character == "[") - (character == "]")
        if (character == "," and depth == 1) or place == len(written) - 1:
            members.append(written[start:place].strip())
            start = place + 1
    return [member for member in members if member]


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
