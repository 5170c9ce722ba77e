"""Write scenarios as text in SI units, with exact numbers, so that the reader returns the same scenario."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from safety_harness.base.exceptions import refuse_other_type
from safety_harness.base.settings import DEFAULTS, Settings
from safety_harness.scenario.codec import Tree, in_a_line, plain_text
from safety_harness.scenario.faults import write_fault
from safety_harness.scenario.model import HAND, HandTrajectory, RecordedHand, Scenario
from safety_harness.scenario.nodes import Mapping as MappingNode
from safety_harness.scenario.nodes import Node, Scalar
from safety_harness.scenario.nodes import Sequence as SequenceNode
from safety_harness.scenario.reference_tables import CLAIMS, TOP
from safety_harness.scenario.robots import OwnRobot
from safety_harness.scenario.settings_keys import SETTINGS_KEYS, TOP_GROUPS, setting_keys

# The keys of a recorded hand that come last.
_LAST = ("speed at most", "from", "to", "elbow track", "elbow towards")


def write_scenario(scenario: Scenario, *, all_settings: bool = False) -> str:
    """Return a YAML text of the scenario.

    ``parse_scenario`` converts the text back to the same scenario, except for its name and its places.

    Args:
        scenario: The scenario.
        all_settings: Whether to write every setting, so that a later change of the defaults does not affect
            the text. If this is false, only settings that differ from the defaults are written.

    """
    refuse_other_type("write_scenario(scenario)", scenario, Scenario)
    return text_of(tree_of(scenario, all_settings=all_settings))


def tree_of(scenario: Scenario, *, all_settings: bool = False) -> dict[str, Tree]:
    """Return the data that ``write_scenario`` writes, by key.

    The values are texts, mappings and lists of mappings.
    """
    tree = TOP.write(scenario)
    for key in ("about", "obstacles", "avoider", "extensions"):
        if not getattr(scenario, key):
            del tree[key]
    if not scenario.driven:
        del tree["controller"]
    for key, reference in (("safety filter", scenario.safety_filter), ("predictor", scenario.predictor)):
        if not reference:
            del tree[key]
    if scenario.hands:
        tree["hands"] = [_hand(hand) for hand in scenario.hands]
    if scenario.faults:
        tree["faults"] = [write_fault(fault) for fault in scenario.faults]
    settings = _settings(scenario.settings, None if all_settings else DEFAULTS)
    if isinstance(scenario.robot, OwnRobot):  # the arm states its stop times itself
        settings = _without_braking(settings)
    tree.update(settings)
    tree["claims"] = CLAIMS.write({claim.sentence: claim for claim in scenario.claims})
    return tree


def text_of(tree: Tree) -> str:
    """Return the YAML text of a tree from ``tree_of``."""
    return "\n".join(_lines(tree)) + "\n"


def node_of(tree: Tree) -> Node:
    """Return the tree that ``parse_tree`` reads from ``text_of(tree)``.

    All parts of the tree have line 1 and no file.
    """
    if isinstance(tree, str):
        return Scalar(plain_text(tree), 1)
    if isinstance(tree, Mapping):
        pairs = ((Scalar(plain_text(key), 1), node_of(value)) for key, value in tree.items())
        return MappingNode(tuple(pairs), 1)
    return SequenceNode(tuple(map(node_of, tree)), 1)


def _hand(hand: HandTrajectory) -> dict[str, Tree]:
    """Return the tree of a hand.

    For a recorded hand, some keys move to the end.
    """
    tree = HAND.write(hand)
    if isinstance(hand, RecordedHand):
        tree |= {key: tree.pop(key) for key in _LAST if key in tree}
    return tree


def _settings(settings: Settings, default: Settings | None) -> dict[str, Tree]:
    """Return the changed settings.

    Some groups are at the top of the file, and the other groups are below ``settings``.
    """

    def changed(groups: Mapping[str, str]) -> dict[str, Tree]:
        pairs = ((key, getattr(settings, name), getattr(default, name, None)) for key, name in groups.items())
        return {key: values for key, own, base in pairs if (values := _group(own, base))}

    below = changed(SETTINGS_KEYS)
    return changed(TOP_GROUPS) | ({"settings": below} if below else {})


def _group(group: object, default: object) -> dict[str, Tree]:
    """Return the values of ``group`` that differ from ``default``, as exact numbers in SI.

    If ``default`` is None, return all values.
    """
    written: dict[str, Any] = {}
    for key in setting_keys(type(group)):
        value = getattr(group, key.attribute)
        # repr distinguishes a negative zero from a positive one, although both are equal.
        if default is None or repr(getattr(default, key.attribute)) != repr(value):
            inner = written.setdefault(key.within[0], {}) if key.within else written
            inner[key.name] = key.value.write(value)
    return written


def _without_braking(settings: dict[str, Tree]) -> dict[str, Tree]:
    """Return the tree of the settings without the braking data."""
    below = settings.get("settings")
    kept = (
        {key: group for key, group in below.items() if key != "braking"} if isinstance(below, Mapping) else {}
    )
    return {key: value for key, value in (settings | {"settings": kept}).items() if value}


def _lines(tree: Tree) -> Iterator[str]:
    """Yield the lines of YAML text for a tree."""
    line = in_a_line(tree)
    if line is not None:
        yield line
    elif isinstance(tree, Mapping):
        for key, value in tree.items():
            line = in_a_line(value)
            yield f"{key}:" if line is None else f"{key}: {line}"
            if line is None:
                yield from (f"  {inner}" for inner in _lines(value))
    else:
        for item in tree:
            first, *rest = _lines(item)
            yield f"- {first}"
            yield from (f"  {inner_line}" for inner_line in rest)
