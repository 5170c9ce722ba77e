"""Scenarios with one thing less: a fault, a hand, a move, a tremor, a setting that is not the default."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, replace
from typing import TypeVar

from safety_harness.scenario.model import (
    JoinedHand,
    MovingHand,
    OffsetStart,
    PoseStart,
    RecordedHand,
    Scenario,
)
from safety_harness.scenario.moves import REACHING_MPS, REACHING_MPS2, Reach
from safety_harness.search.paths import Path, value_at, with_value
from safety_harness.settings import DEFAULTS

NOWHERE = (0.0, 0.0, 0.0)
T = TypeVar("T")


def simpler(scenario: Scenario) -> Iterator[tuple[str, Scenario]]:
    """(what is gone, the scenario without it), the greatest simplifications first."""
    for k in range(len(scenario.faults)):
        yield f"without fault {k + 1}", replace(scenario, faults=_without(scenario.faults, k))
    if len(scenario.hands) > 0:
        yield "without any hand", replace(scenario, hands=())
    for hand in scenario.hands:
        others = tuple(o for o in scenario.hands if o is not hand and not _joined(o, hand.name))
        yield f"without the {hand.name}", replace(scenario, hands=others)
    yield from _of_settings(scenario)
    for k, hand in enumerate(scenario.hands):
        if isinstance(hand, MovingHand):
            yield from _fewer_moves(scenario, k, hand)
    for path, plain in _plain(scenario):
        if value_at(scenario, path) != plain:
            yield f"without {_words(scenario, path)}", with_value(scenario, path, plain)
    if scenario.seed != 0:
        yield "with seed 0", replace(scenario, seed=0)


def _fewer_moves(scenario: Scenario, k: int, hand: MovingHand) -> Iterator[tuple[str, Scenario]]:
    """The later half gone, then single moves from the last to the first."""
    path, count = ("hands", k, "moves"), len(hand.moves)
    if count > 2:
        half = hand.moves[: count // 2]
        yield f"the {hand.name} without its later moves", with_value(scenario, path, half)
    for j in reversed(range(count)):
        moves = _without(hand.moves, j)
        yield f"the {hand.name} without its move {j + 1}", with_value(scenario, path, moves)


def _plain(scenario: Scenario) -> Iterator[tuple[Path, object]]:
    """Paths to what a scenario need not have, and what stands there without it."""
    for k, hand in enumerate(scenario.hands):
        at: Path = ("hands", k)
        if not isinstance(hand, JoinedHand):
            yield (*at, "shift_in_base_m"), NOWHERE
            yield (*at, "delay_s"), 0.0
        if isinstance(hand, MovingHand):
            yield (*at, "tremor"), None
            yield (*at, "max_speed_mps"), REACHING_MPS
            yield (*at, "max_acceleration_mps2"), REACHING_MPS2
            for j, move in enumerate(hand.moves):
                if isinstance(move, Reach):
                    yield (*at, "moves", j, "hesitation"), None
        if isinstance(hand, RecordedHand):
            yield (*at, "turn_rad"), 0.0
            yield (*at, "speed_factor"), 1.0
            yield (*at, "max_speed_mps"), None
    if isinstance(scenario.start, OffsetStart):
        yield ("start", "offset_in_base_m"), NOWHERE
    if isinstance(scenario.start, OffsetStart | PoseStart):
        yield ("start", "tilt_in_tcp_rad"), NOWHERE


def _of_settings(scenario: Scenario) -> Iterator[tuple[str, Scenario]]:
    """All settings as by default, then group by group, then one by one."""
    if scenario.settings == DEFAULTS:
        return
    yield "with default settings", replace(scenario, settings=DEFAULTS)
    for group in fields(DEFAULTS):
        default, own = getattr(DEFAULTS, group.name), getattr(scenario.settings, group.name)
        if own == default:
            continue
        path: Path = ("settings", group.name)
        name = group.name.replace("_", " ")
        yield f"with the default {name}", with_value(scenario, path, default)
        for one in fields(default):
            value = getattr(default, one.name)
            if getattr(own, one.name) != value:
                yield (
                    f"with the default {name}, {one.name}",
                    with_value(scenario, (*path, one.name), value),
                )


def _words(scenario: Scenario, path: Path) -> str:
    what = str(path[-1]).rsplit("_in_", 1)[0]
    for suffix in ("_mps2", "_mps", "_rad", "_s", "_m"):
        what = what.removesuffix(suffix)
    whose = (
        f"the {scenario.hands[path[1]].name}'s " if path[0] == "hands" and isinstance(path[1], int) else ""
    )
    return whose + ("the start's " if path[0] == "start" else "") + what.replace("_", " ")


def _without(members: tuple[T, ...], k: int) -> tuple[T, ...]:
    return members[:k] + members[k + 1 :]


def _joined(hand: object, name: str) -> bool:
    return isinstance(hand, JoinedHand) and hand.joined_to == name
