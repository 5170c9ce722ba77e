"""Write a scenario space as text, from the tree that was read, without comments."""

from __future__ import annotations

import re

from safety_harness.base.exceptions import refuse_other_type
from safety_harness.scenario.codec import Tree, scalar_text
from safety_harness.scenario.nodes import Mapping, Node, Scalar
from safety_harness.scenario.write import text_of
from safety_harness.space.space import ScenarioSpace

_QUANTITY = re.compile(r"[+-]?[0-9.][A-Za-z0-9./%]*(?: [A-Za-z0-9./%-]+)*")


def write_space(space: ScenarioSpace) -> str:
    """Return YAML text that ``parse_space`` reads as the same space.

    Only the name and the places differ.

    Args:
        space: The space.

    """
    refuse_other_type("write_space(space)", space, ScenarioSpace)
    return text_of(_tree(space.tree))


def _tree(node: Node) -> Tree:
    """Return a node in the form that ``text_of`` expects."""
    if isinstance(node, Scalar):
        return node.text if _QUANTITY.fullmatch(node.text) else scalar_text(node.text)
    if isinstance(node, Mapping):
        return {str(_tree(key)): _tree(value) for key, value in node.entries}
    return [_tree(item) for item in node.items]
