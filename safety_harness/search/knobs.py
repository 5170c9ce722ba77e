"""The numbers of a scenario that can be made simpler: slower, shorter, nearer to the seen space, rounder."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, is_dataclass

from safety_harness.scenario.model import MovingHand, OffsetStart, PoseStart, RecordedHand, Scenario
from safety_harness.search.paths import Path

_STEPS = {"_rad": math.radians(1.0), "_mps": 0.1, "_mps2": 1.0, "_s": 0.1, "_m": 0.01, "_factor": 0.1}
FINER = 3  # how many times a step is divided by ten before a number is left as it is
LEAST_S, LEAST_MPS = 0.1, 0.1


@dataclass(frozen=True)
class ShrinkTarget:
    """One number: where it is, what is simplest, and the distance of round numbers.

    Without a ``target`` the number is only rounded.
    """

    path: Path
    target: float | None
    step: float

    def on(self, level: int) -> Callable[[int], float]:
        """The round numbers of a level: k steps, each a tenth of the level's before."""
        parts = 10**level
        if self.step == _STEPS["_rad"]:
            return lambda k: math.radians(k / parts)
        whole = round(1.0 / self.step) * parts
        return lambda k: k / whole

    def place_of(self, value: float, level: int) -> float:
        """Where among the round numbers of a level ``value`` lies."""
        return value / self.step * int(10**level)

    def level_of(self, value: float) -> int:
        """The coarsest level on which ``value`` is a round number; FINER for none."""
        for level in range(FINER):
            if self.on(level)(round(self.place_of(value, level))) == value:
                return level
        return FINER


def knobs(scenario: Scenario) -> Iterator[ShrinkTarget]:
    """Every number, those that shorten a run first."""
    yield _knob(("duration_s",), LEAST_S)
    start = scenario.start
    cell = scenario.settings.cell
    if isinstance(start, OffsetStart):
        yield from (_knob(("start", "offset_in_base_m", k), 0.0, 0.01) for k in range(3))
    if isinstance(start, PoseStart):
        desired = cell.desired_tcp_position_in_base_m
        yield from (_knob(("start", "position_in_base_m", k), desired[k], 0.01) for k in range(3))
    if isinstance(start, OffsetStart | PoseStart):
        yield from (_knob(("start", "tilt_in_tcp_rad", k), 0.0, _STEPS["_rad"]) for k in range(3))
    for k, hand in enumerate(scenario.hands):
        if isinstance(hand, MovingHand):
            yield from _of_moving(scenario, k, hand)
        elif isinstance(hand, RecordedHand):
            yield _knob(("hands", k, "delay_s"), 0.0)
            yield _knob(("hands", k, "speed_factor"), 1.0)
            yield _knob(("hands", k, "turn_rad"), 0.0)
            yield from _point(("hands", k, "starts_at_in_base_m"), None)
    for k, fault in enumerate(scenario.faults):
        for own in fields(fault):
            if isinstance(getattr(fault, own.name), float):
                target = 0.0 if own.name in ("from_s", "delay_s") else None
                yield _knob(("faults", k, own.name), target)


def _of_moving(scenario: Scenario, k: int, hand: MovingHand) -> Iterator[ShrinkTarget]:
    at: Path = ("hands", k)
    yield _knob((*at, "delay_s"), 0.0)
    seen = scenario.settings.avoidance.nominal_hand_position_in_base_m
    for j, move in enumerate(hand.moves):
        for own in fields(move):
            path: Path = (*at, "moves", j, own.name)
            value = getattr(move, own.name)
            if own.name == "position_in_base_m":
                yield from _point(path, seen)
            elif own.name == "speed_mps":
                yield _knob(path, LEAST_MPS)
            elif own.name in ("duration_s", "at_most_s"):
                yield _knob(path, LEAST_S)
            elif isinstance(value, float):
                yield _knob(path, None)
            elif own.name in ("from_in_base_m", "to_in_base_m"):
                yield from _point(path, None)
            elif is_dataclass(value):
                yield from (_knob((*path, part.name), None) for part in fields(value))
    yield from _point((*at, "starts_at_in_base_m"), None)


def _point(path: Path, target: tuple[float, float, float] | None) -> Iterator[ShrinkTarget]:
    for axis in range(3):
        yield _knob((*path, axis), None if target is None else target[axis], 0.01)


def _knob(path: Path, target: float | None, step: float | None = None) -> ShrinkTarget:
    if step is None:
        name = str(path[-1])
        step = next(
            _STEPS[suffix] for suffix in sorted(_STEPS, key=len, reverse=True) if name.endswith(suffix)
        )
    return ShrinkTarget(path, target, step)
