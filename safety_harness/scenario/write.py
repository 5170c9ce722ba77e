"""Scenarios as text: SI units and exact numbers, so that reading gives the same scenario again."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import TypeAlias

from safety_harness.scenario.fault_phrases import write_fault
from safety_harness.scenario.model import (
    FollowTcp,
    HandMove,
    HandTrajectory,
    JointStart,
    MoveTo,
    MovingHand,
    ReachForTcp,
    RecordedHand,
    Scenario,
    TcpStart,
    Wait,
)
from safety_harness.scenario.read import SETTINGS_KEYS, TOP_GROUPS
from safety_harness.scenario.settings_keys import Written, write_group, write_vector
from safety_harness.scenario.units import (
    ANGLE,
    LENGTH,
    NUMBER,
    SPEED,
    TIME,
    format_quantity,
)
from safety_harness.settings import DEFAULTS, Settings

# What a file is made of: a value on its line, or a mapping or a list below its key.
Tree: TypeAlias = "str | Mapping[str, Tree] | Sequence[Mapping[str, Tree]]"

_PLAIN = re.compile(r"[A-Za-z][A-Za-z0-9_./()%-]*(?: [A-Za-z0-9_./()%-]+)*")
_ESCAPES = {'"': '\\"', "\\": "\\\\", "\n": "\\n"}


def write_scenario(scenario: Scenario, *, all_settings: bool = False) -> str:
    """YAML text from which ``parse_scenario`` gives ``scenario`` again, but for its name and places.

    Only settings that differ from the defaults are written; with ``all_settings`` every one, for
    a text that must outlive a change of the defaults.
    """
    return text_of(tree_of(scenario, all_settings=all_settings))


def tree_of(scenario: Scenario, *, all_settings: bool = False) -> dict[str, Tree]:
    """What ``write_scenario`` writes, key by key: texts, mappings and lists of mappings."""
    tree: dict[str, Tree] = {"scenario": scalar_text(scenario.title)}
    if scenario.about:
        tree["about"] = scalar_text(scenario.about)
    tree["duration"] = format_quantity(scenario.duration_s, TIME)
    tree["seed"] = str(scenario.seed)
    tree["robot"] = scenario.robot.value
    tree["tcp start"] = _start(scenario.start)
    tree["avoider"] = scalar_text(scenario.avoider)
    if scenario.hands:
        tree["hands"] = [_hand(hand) for hand in scenario.hands]
    if scenario.faults:
        tree["faults"] = [write_fault(fault) for fault in scenario.faults]
    tree.update(_settings(scenario.settings, None if all_settings else DEFAULTS))
    tree["claims"] = {scalar_text(claim.sentence): claim.expected.value for claim in scenario.claims}
    return tree


def text_of(tree: Mapping[str, Tree]) -> str:
    """The YAML text of such a tree."""
    return "\n".join(_lines(tree)) + "\n"


def _start(start: TcpStart) -> dict[str, Tree]:
    if isinstance(start, JointStart):
        return {"joints": write_vector(start.joint_position_rad, ANGLE)}
    return {
        "offset": write_vector(start.offset_in_base_m, LENGTH),
        "tilt": write_vector(start.tilt_in_tcp_rad, ANGLE),
    }


def _hand(hand: HandTrajectory) -> dict[str, Tree]:
    return _moving_hand(hand) if isinstance(hand, MovingHand) else _recorded_hand(hand)


def _moving_hand(hand: MovingHand) -> dict[str, Tree]:
    return {
        "hand": scalar_text(hand.name),
        "starts at": write_vector(hand.starts_at_in_base_m, LENGTH),
        "elbow towards": write_vector(hand.elbow_towards_in_base_m, LENGTH),
        "moves": [_move(move) for move in hand.moves],
    }


def _move(move: HandMove) -> dict[str, Tree]:
    if isinstance(move, MoveTo):
        return {
            "move to": write_vector(move.position_in_base_m, LENGTH),
            "speed": format_quantity(move.speed_mps, SPEED),
        }
    if isinstance(move, Wait):
        return {"wait": format_quantity(move.duration_s, TIME)}
    if isinstance(move, ReachForTcp):
        return {
            "reach for tcp": format_quantity(move.speed_mps, SPEED),
            "until": format_quantity(move.until_distance_m, LENGTH),
            "at most": format_quantity(move.at_most_s, TIME),
        }
    if isinstance(move, FollowTcp):
        return {
            "follow tcp": format_quantity(move.speed_mps, SPEED),
            "keeping": format_quantity(move.distance_m, LENGTH),
            "for": format_quantity(move.duration_s, TIME),
        }
    return {"withdraw": format_quantity(move.speed_mps, SPEED)}


def _recorded_hand(hand: RecordedHand) -> dict[str, Tree]:
    tree: dict[str, Tree] = {
        "recording": scalar_text(hand.recording.as_posix()),
        "sha256": f'"{hand.motion.sha256}"',
        "hand": scalar_text(hand.name),
        "track": scalar_text(hand.track),
        "starts at": write_vector(hand.starts_at_in_base_m, LENGTH),
        "turned": format_quantity(hand.turn_rad, ANGLE),
        "speed factor": format_quantity(hand.speed_factor, NUMBER),
        "longest gap": format_quantity(hand.longest_gap_s, TIME),
        "fastest jump": format_quantity(hand.fastest_jump_mps, SPEED),
    }
    if hand.from_s is not None:
        tree["from"] = format_quantity(hand.from_s, TIME)
    if hand.to_s is not None:
        tree["to"] = format_quantity(hand.to_s, TIME)
    if hand.elbow_track is not None:
        tree["elbow track"] = scalar_text(hand.elbow_track)
    if hand.elbow_towards_in_base_m is not None:
        tree["elbow towards"] = write_vector(hand.elbow_towards_in_base_m, LENGTH)
    return tree


def _settings(settings: Settings, default: Settings | None) -> dict[str, Tree]:
    """The groups at the top of the file, then the others below ``settings``."""
    tree: dict[str, Tree] = {}
    for key, name in TOP_GROUPS.items():
        values = _group(settings, default, name)
        if values:
            tree[key] = values
    groups = {key: _group(settings, default, name) for key, name in SETTINGS_KEYS.items()}
    changed = {key: values for key, values in groups.items() if values}
    if changed:
        tree["settings"] = changed
    return tree


def _group(settings: Settings, default: Settings | None, name: str) -> dict[str, Written]:
    return write_group(getattr(settings, name), getattr(default, name) if default is not None else None)


def scalar_text(text: str) -> str:
    """``text`` as a YAML scalar: bare where nothing in it could be taken for notation."""
    if _PLAIN.fullmatch(text):
        return text
    return '"' + "".join(_ESCAPES.get(c, c if c.isprintable() else f"\\U{ord(c):08x}") for c in text) + '"'


def _lines(tree: Mapping[str, Tree], indent: str = "") -> Iterator[str]:
    for key, value in tree.items():
        if isinstance(value, str):
            yield f"{indent}{key}: {value}"
        elif not value:
            yield f"{indent}{key}: {'{}' if isinstance(value, Mapping) else '[]'}"
        elif isinstance(value, Mapping):
            yield f"{indent}{key}:"
            yield from _lines(value, indent + "  ")
        else:
            yield f"{indent}{key}:"
            for item in value:
                first, *others = _lines(item)
                yield f"{indent}  - {first}"
                yield from (f"{indent}    {other}" for other in others)
