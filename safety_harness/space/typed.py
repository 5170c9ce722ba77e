"""Make a scenario space in Python, from a scenario and the values that vary.

    space_from(scenario, {
        "hands[0].moves[0].speed": Uniform(0.2, 1.6),
        "tcp start.offset": InRegion("unseen tcp"),
        "avoider": OneOf(("opposite pose", "mc-dropout"), chances=(3, 1)),
    })

Numbers are in SI.  A number or a distribution without a unit gets the unit of the value that it replaces.
Within a mapping, a value is a text as in a file (``{"wait": "1 s"}``), or a distribution with a unit.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from collections.abc import Sequence as Values
from dataclasses import dataclass
from typing import TypeAlias

from safety_harness.base.exceptions import Place, ScenarioError, near_miss
from safety_harness.scenario.compose import SPACE_KEY
from safety_harness.scenario.fields import Field, walk
from safety_harness.scenario.model import Scenario
from safety_harness.scenario.nodes import Mapping as MappingNode
from safety_harness.scenario.nodes import Node, Scalar, parse_tree
from safety_harness.scenario.nodes import Sequence as SequenceNode
from safety_harness.scenario.write import write_scenario
from safety_harness.space.distributions import InBox, InRegion, InShell, TruncatedNormal, Uniform
from safety_harness.space.read import space_of
from safety_harness.space.reading import CHOICES
from safety_harness.space.space import ScenarioSpace
from safety_harness.space.template import written

_STEP = re.compile(r"\[(\d+)\]|([^.\[\]]+)")


@dataclass(frozen=True)
class OneOf:
    """A choice among values.

    Args:
        options: The values.
        chances: The relative probabilities of the values.  None means that all are equally likely.

    """

    options: tuple[Value, ...]
    chances: tuple[float, ...] | None = None


@dataclass(frozen=True)
class Switch:
    """A value that depends on the result of a named choice.

    Args:
        name: The name of the choice, whose options must be words.
        options: The value for each word.

    """

    name: str
    options: Mapping[str, Value]


@dataclass(frozen=True)
class Ref:
    """A reference to the value of a named choice.

    Args:
        name: The name of the choice.

    """

    name: str


@dataclass(frozen=True)
class Repeat:
    """Members of a list, repeated several times.

    Args:
        least: The smallest number of repetitions.
        most: The largest number of repetitions.
        moves: The members.

    """

    least: int
    most: int
    moves: tuple[Value, ...]


Value: TypeAlias = (
    float
    | str
    | Uniform
    | TruncatedNormal
    | InBox
    | InShell
    | InRegion
    | OneOf
    | Switch
    | Ref
    | Repeat
    | Values["Value"]
    | Mapping[str, "Value"]
)


def space_from(
    scenario: Scenario,
    varied: Mapping[str, Value],
    *,
    choices: Mapping[str, Value] | None = None,
) -> ScenarioSpace:
    """Return the space of scenarios that equal ``scenario`` except for the values that vary.

    Args:
        scenario: The scenario.
        varied: The new values.  The keys are paths, such as ``hands[0].moves[1].speed``.
        choices: Named values, to which ``Ref`` and ``Switch`` refer.  None means that there are no such
            values.

    Raises:
        ScenarioError: The scenario lacks a path, or ``parse_space`` would refuse the space.

    """
    tree = parse_tree(write_scenario(scenario), scenario.file)
    full = Field(parse_tree(write_scenario(scenario, all_settings=True), None), None, path="", line=1)
    nodes = {field.path: field.node for field in walk(full) if field.path}
    for path, value in varied.items():
        steps = [int(index) if index else key for index, key in _STEP.findall(path)]
        if path not in nodes:
            expected = "the path of a value of the scenario"
            hint = near_miss(path, nodes)
            place = Place(file=scenario.file, field=path)
            raise ScenarioError(place=place, expected=expected, got=path, hint=hint)
        tree = _replaced(tree, steps, _node(value, _unit(nodes[path])))
    assert isinstance(tree, MappingNode)
    entries = [
        (Scalar(SPACE_KEY, 1) if key.text == "scenario" else key, value) for key, value in tree.entries
    ]
    if choices:
        entries.insert(1, (Scalar(CHOICES, 1), _node(choices, "")))
    return space_of(MappingNode(tuple(entries), 1), scenario.file, name=scenario.name)


def _replaced(node: Node, steps: Values[int | str], new: Node) -> Node:
    """Return the tree with ``new`` at the path ``steps``.

    Missing mappings along the path are created.
    """
    if not steps:
        return new
    step, rest = steps[0], steps[1:]
    if isinstance(step, int):
        assert isinstance(node, SequenceNode)
        items = list(node.items)
        items[step] = _replaced(items[step], rest, new)
        return SequenceNode(tuple(items), node.line)
    assert isinstance(node, MappingNode)
    entries = dict(node.entries)
    by_text = {key.text: key for key in entries}
    key = by_text.get(step, Scalar(step, node.line))
    entries[key] = _replaced(entries.get(key, MappingNode((), node.line)), rest, new)
    return MappingNode(tuple(entries.items()), node.line)


def _unit(node: Node) -> str:
    """Return the SI unit of a written quantity, or of the first member of a list.

    The unit is empty if there is no unit.
    """
    while isinstance(node, SequenceNode) and node.items:
        node = node.items[0]
    if not isinstance(node, Scalar):
        return ""
    number, _, unit = node.text.partition(" ")
    try:
        float(number)
    except ValueError:
        return ""
    return unit


def _node(value: Value, unit: str) -> Node:
    """Return ``value`` as the node that a file would contain for it."""

    def text(number: float) -> str:
        return written(number, getattr(value, "unit", "") or unit)

    match value:
        case str():
            return Scalar(value, 1)
        case int():
            return Scalar(f"{value} {unit}".rstrip(), 1)
        case float():
            return Scalar(written(value, unit), 1)
        case Uniform():
            return Scalar(f"from {text(value.low)} to {text(value.high)}", 1)
        case TruncatedNormal():
            ends = f"from {text(value.low)} to {text(value.high)}"
            return Scalar(f"normal {text(value.mean)} +- {text(value.std)} {ends}", 1)
        case InRegion():
            return _keyed({"in": value.name}, "")
        case InBox():
            return _keyed({"box": (value.low, value.high)}, value.unit)
        case InShell():
            return _keyed({"shell": value.centre, "from": value.inner, "to": value.outer}, value.unit)
        case Ref():
            return Scalar(f"the {value.name}", 1)
        case OneOf():
            chances = {} if value.chances is None else {"chances": tuple(map(str, value.chances))}
            return _keyed({"one of": value.options, **chances}, unit)
        case Switch():
            return _keyed({"by": value.name, **value.options}, unit)
        case Repeat():
            return _keyed({"repeat": f"from {value.least} to {value.most} times", "moves": value.moves}, "")
        case Mapping():
            return _keyed(value, "")
    return SequenceNode(tuple(_node(item, unit) for item in value), 1)


def _keyed(entries: Mapping[str, Value], unit: str) -> MappingNode:
    """Return a mapping as the node that a file would contain."""
    return MappingNode(tuple((Scalar(key, 1), _node(value, unit)) for key, value in entries.items()), 1)
