"""Replace the words of earlier releases in a file, and leave the rest of its text unchanged."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

from ruamel.yaml import YAML
from ruamel.yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode

from safety_harness.scenario.codec import scalar_text
from safety_harness.scenario.nodes import parse_tree
from safety_harness.scenario.reference_tables import TOP

# For each key that identifies a kind of mapping: its present keys by its former keys.
FORMER = {table.told_by: table.former for table in (TOP, *TOP.below()) if table.former}


def modernised(text: str, in_words_of_today: Callable[[str], str], file: Path | None = None) -> str:
    """Return a file's text with the present keys and sentences.

    Args:
        text: The text of a scenario, space, suite or plan.
        in_words_of_today: A function that returns the present wording of a sentence of an earlier release. It
            returns any other sentence unchanged.
        file: The file, for errors.

    Raises:
        ScenarioError: The text is no tree of keys and values.

    """
    parse_tree(text, file)
    root = YAML(typ="rt", pure=True).compose(text)
    edits = sorted(_edits(root, in_words_of_today)) if root else []
    for begin, end, new in reversed(edits):
        text = text[:begin] + scalar_text(new) + text[end:]
    return text


def _edits(node: Node, in_words_of_today: Callable[[str], str]) -> Iterator[tuple[int, int, str]]:
    """Yield (begin, end, new text) for each scalar below ``node`` that has the wording of an old release."""
    if isinstance(node, ScalarNode):
        if (new := in_words_of_today(node.value)) != node.value:
            yield node.start_mark.index, node.end_mark.index, new
    elif isinstance(node, SequenceNode):
        for item in node.value:
            yield from _edits(item, in_words_of_today)
    elif isinstance(node, MappingNode):
        names = {key.value for key, _ in node.value}
        former = next((FORMER[name] for name in FORMER if name in names), {})
        for key, value in node.value:
            present = former.get(key.value)
            if present is not None and present not in names:
                yield key.start_mark.index, key.end_mark.index, present
            else:
                yield from _edits(key, in_words_of_today)
            yield from _edits(value, in_words_of_today)
