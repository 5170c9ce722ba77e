"""What a scenario file must not have: distributions, which belong to scenario spaces."""

from __future__ import annotations

import re

from safety_harness.scenario.fields import Field
from safety_harness.scenario.nodes import Mapping, Node, Scalar, Sequence

SPACE_KEY = "scenario space"
_HINT = f'a file that begins with "{SPACE_KEY}:" may have distributions in place of values'
_SENTENCES = re.compile(r"from [+-]?[0-9.].* to .+|normal .+(\+-|\+/-|±).+|one of .+,.+")
_KEYS = ({"one of"}, {"one of", "chances"}, {"box"}, {"shell", "from", "to"}, {"in"}, {"repeat", "moves"})
_PROSE = ("scenario", "about", "claims")


def is_space(tree: Node) -> bool:
    """Whether a tree begins a scenario space."""
    return isinstance(tree, Mapping) and any(key.text == SPACE_KEY for key, _ in tree.entries)


def refuse_distributions(root: Field) -> None:
    """ScenarioError, with a hint, for a scenario space and for a value that a distribution stands for."""
    if not isinstance(root.node, Mapping):
        return
    for key, field in root.entries("a scenario"):
        if key == SPACE_KEY:
            raise field.error(
                "one scenario",
                got="a scenario space",
                hint="safety-harness sample draws scenarios from it",
            )
        if key not in _PROSE:
            _refuse_below(field)


def _refuse_below(field: Field) -> None:
    if isinstance(field.node, Scalar):
        if _SENTENCES.fullmatch(field.node.text.strip()):
            raise field.error("one value", hint=_HINT)
    elif isinstance(field.node, Sequence):
        for item in field.items("a list"):
            _refuse_below(item)
    else:
        entries = field.entries("a mapping")
        if {key for key, _ in entries} in _KEYS:
            raise field.error("one value", got=f"a mapping with the key {entries[0][0]}", hint=_HINT)
        for _, child in entries:
            _refuse_below(child)
