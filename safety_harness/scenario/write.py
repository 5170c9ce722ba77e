"""Scenarios as text: SI units and exact numbers, so that reading gives the same scenario again."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import TypeAlias

from safety_harness.scenario.fault_phrases import write_fault
from safety_harness.scenario.model import (
    HandTrajectory,
    JoinedHand,
    JointStart,
    MovingHand,
    PoseStart,
    RecordedHand,
    Scenario,
    TcpStart,
)
from safety_harness.scenario.moves import (
    FollowTcp,
    HandMove,
    MoveTo,
    Reach,
    ReachForTcp,
    Sweep,
    Wait,
    Wander,
    Withdraw,
)
from safety_harness.scenario.read import SETTINGS_KEYS, TOP_GROUPS
from safety_harness.scenario.settings_keys import Written, write_group, write_vector
from safety_harness.scenario.units import (
    ACCELERATION,
    ANGLE,
    LENGTH,
    NUMBER,
    RATE,
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
    tilt = write_vector(start.tilt_in_tcp_rad, ANGLE)
    if isinstance(start, PoseStart):
        return {"position": write_vector(start.position_in_base_m, LENGTH), "tilt": tilt}
    return {"offset": write_vector(start.offset_in_base_m, LENGTH), "tilt": tilt}


def _hand(hand: HandTrajectory) -> dict[str, Tree]:
    if isinstance(hand, JoinedHand):
        return {
            "hand": scalar_text(hand.name),
            "together with": scalar_text(hand.joined_to),
            "apart": write_vector(hand.apart_in_base_m, LENGTH),
            "elbow towards": write_vector(hand.elbow_towards_in_base_m, LENGTH),
        }
    return _moving_hand(hand) if isinstance(hand, MovingHand) else _recorded_hand(hand)


def _moving_hand(hand: MovingHand) -> dict[str, Tree]:
    tree: dict[str, Tree] = {
        "hand": scalar_text(hand.name),
        "starts at": write_vector(hand.starts_at_in_base_m, LENGTH),
        "elbow towards": write_vector(hand.elbow_towards_in_base_m, LENGTH),
        "shifted by": write_vector(hand.shift_in_base_m, LENGTH),
        "delayed by": format_quantity(hand.delay_s, TIME),
        "speed at most": format_quantity(hand.max_speed_mps, SPEED),
        "acceleration at most": format_quantity(hand.max_acceleration_mps2, ACCELERATION),
    }
    if hand.tremor is not None:
        tree["tremor"] = {
            "amplitude": format_quantity(hand.tremor.amplitude_m, LENGTH),
            "rate": format_quantity(hand.tremor.rate_hz, RATE),
        }
    tree["moves"] = [_move(move) for move in hand.moves]
    return tree


def _move(move: HandMove) -> dict[str, Tree]:
    if isinstance(move, Wait):
        return {"wait": format_quantity(move.duration_s, TIME)}
    speed = format_quantity(move.speed_mps, SPEED)
    if isinstance(move, MoveTo):
        return {"move to": write_vector(move.position_in_base_m, LENGTH), "speed": speed}
    if isinstance(move, FollowTcp):
        return {
            "follow tcp": speed,
            "keeping": format_quantity(move.distance_m, LENGTH),
            "for": format_quantity(move.duration_s, TIME),
        }
    if isinstance(move, Wander):
        corners = ", ".join(write_vector(corner, LENGTH) for corner in move.corners_in_base_m)
        return {"wander": speed, "within": f"[{corners}]", "for": format_quantity(move.duration_s, TIME)}
    if isinstance(move, Sweep):
        return {
            "sweep": speed,
            "from": write_vector(move.from_in_base_m, LENGTH),
            "to": write_vector(move.to_in_base_m, LENGTH),
            "times": str(move.times),
        }
    if isinstance(move, Withdraw):
        return {"withdraw": speed}
    return _reach(move, speed)


def _reach(reach: Reach, speed: str) -> dict[str, Tree]:
    written: dict[str, Tree] = {
        "reach for tcp" if isinstance(reach, ReachForTcp) else "reach for object": speed,
        "until": format_quantity(reach.until_distance_m, LENGTH),
        "at most": format_quantity(reach.at_most_s, TIME),
    }
    if reach.hesitation is not None:
        written["hesitating at"] = format_quantity(reach.hesitation.distance_m, LENGTH)
        written["for"] = format_quantity(reach.hesitation.duration_s, TIME)
    return written


def _recorded_hand(hand: RecordedHand) -> dict[str, Tree]:
    tree: dict[str, Tree] = {
        "recording": scalar_text(hand.recording.as_posix()),
        "sha256": f'"{hand.motion.sha256}"',
        "hand": scalar_text(hand.name),
        "track": scalar_text(hand.track),
        "starts at": write_vector(hand.starts_at_in_base_m, LENGTH),
        "turned": format_quantity(hand.turn_rad, ANGLE),
        "shifted by": write_vector(hand.shift_in_base_m, LENGTH),
        "delayed by": format_quantity(hand.delay_s, TIME),
        "speed factor": format_quantity(hand.speed_factor, NUMBER),
        "longest gap": format_quantity(hand.longest_gap_s, TIME),
        "fastest jump": format_quantity(hand.fastest_jump_mps, SPEED),
    }
    if hand.max_speed_mps is not None:
        tree["speed at most"] = format_quantity(hand.max_speed_mps, SPEED)
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
