"""Scenario spaces as text: the tree as it was written, without its comments."""

from __future__ import annotations

import re
from collections.abc import Iterator

from safety_harness.scenario.codec import scalar_text
from safety_harness.scenario.nodes import Mapping, Node, Scalar, Sequence
from safety_harness.space.space import ScenarioSpace

_QUANTITY = re.compile(r"[+-]?[0-9.][A-Za-z0-9./%]*(?: [A-Za-z0-9./%-]+)*")


def write_space(space: ScenarioSpace) -> str:
    """YAML text from which ``parse_space`` gives the same space again, but for its name and places."""
    return "\n".join(_block(space.tree, "")) + "\n"


def _block(node: Node, indent: str) -> Iterator[str]:
    """The lines of a mapping or a list."""
    if isinstance(node, Mapping):
        for key, value in node.entries:
            name = f"{indent}{_scalar(key.text)}:"
            if _in_a_line(value):
                yield f"{name} {_line(value)}".rstrip()
            else:
                yield name
                yield from _block(value, indent + "  ")
    else:
        assert isinstance(node, Sequence)
        for item in node.items:
            if _in_a_line(item):
                yield f"{indent}- {_line(item)}"
            else:
                first, *others = _block(item, indent + "  ")
                yield f"{indent}- {first.strip()}"
                yield from others


def _in_a_line(node: Node) -> bool:
    if isinstance(node, Sequence):
        return all(_in_a_line(item) and not isinstance(item, Mapping) for item in node.items)
    return isinstance(node, Scalar) or not node.entries


def _line(node: Node) -> str:
    if isinstance(node, Scalar):
        return _scalar(node.text)
    if isinstance(node, Sequence):
        return "[" + ", ".join(map(_line, node.items)) + "]"
    return "{}"


def _scalar(text: str) -> str:
    return text if _QUANTITY.fullmatch(text) else scalar_text(text)
