"""Simplify a scenario that violates a claim, so that the simple scenario still violates the claim.

A scenario is simpler if it lacks a part, if its motions are slower or shorter, or if its numbers are rounder
or nearer to their defaults. Shrinking first halves the run as often as possible, because shorter runs are
quicker. Then shrinking removes parts and simplifies numbers. Shrinking repeats these steps until a whole
round makes no change. Therefore, shrinking the result again returns the same scenario. Shrinking uses no
random numbers, and ``budget`` limits its runs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any, TypeVar

from safety_harness.base.exceptions import InputError
from safety_harness.base.settings import DEFAULTS
from safety_harness.scenario.codec import Tree
from safety_harness.scenario.model import (
    REACHING_MPS2,
    MovingHand,
    OffsetStart,
    PoseStart,
    RecordedHand,
    Scenario,
)
from safety_harness.scenario.moves import REACHING_MPS, ReachForObject, ReachForTcp
from safety_harness.scenario.read import scenario_of
from safety_harness.scenario.write import node_of, text_of, tree_of, write_scenario
from safety_harness.space.tracing import Path, leaves, path_text, value_at, with_value

FINER = 3  # levels of round numbers, each ten times finer; a finer number stays unchanged
LEAST_S, LEAST_MPS = 0.1, 0.1  # one step of the grid below: a smaller target would be no round number

_NOWHERE = (0.0, 0.0, 0.0)
_DEGREE = math.radians(1.0)
# The step between round numbers [SI], by the suffix of a number's unit.
_STEPS = {"_mps2": 1.0, "_mps": 0.1, "_rad": _DEGREE, "_s": 0.1, "_m": 0.01, "_factor": 0.1}
_UNCHANGED = {"shift_in_base_m": _NOWHERE, "delay_s": 0.0}
_SPEEDS = {"max_speed_mps": REACHING_MPS, "max_acceleration_mps2": REACHING_MPS2}
# The optional parts of a scenario, each with the value that means "absent".
_PLAIN: Mapping[type[Any], Mapping[str, object]] = {
    MovingHand: {**_UNCHANGED, "tremor": None, **_SPEEDS},
    RecordedHand: {**_UNCHANGED, "turn_rad": 0.0, "speed_factor": 1.0, "max_speed_mps": None},
    ReachForTcp: {"hesitation": None},
    ReachForObject: {"hesitation": None},
    OffsetStart: {"offset_in_base_m": _NOWHERE, "tilt_in_tcp_rad": _NOWHERE},
    PoseStart: {"tilt_in_tcp_rad": _NOWHERE},
}
T = TypeVar("T")


def simpler(scenario: Scenario) -> Iterator[tuple[str, Scenario]]:
    """Yield a pair for each removable part: its description, and ``scenario`` without the part.

    Large parts come first.
    """
    for k in range(len(scenario.faults)):
        yield f"without fault {k + 1}", replace(scenario, faults=_without(scenario.faults, k))
    if len(scenario.hands) > 0:
        yield "without any hand", replace(scenario, hands=())
    for hand in scenario.hands:
        name = hand.name
        kept = tuple(o for o in scenario.hands if o is not hand and getattr(o, "joined_to", "") != name)
        yield f"without the {name}", replace(scenario, hands=kept)
    yield from _of_settings(scenario)
    for k, hand in enumerate(scenario.hands):
        if isinstance(hand, MovingHand):
            yield from _fewer_moves(scenario, k, hand)
    for at in (*_hands_and_moves(scenario), ("start",)):
        part = value_at(scenario, at)
        for name, plain in _PLAIN.get(type(part), {}).items():
            if getattr(part, name) != plain:
                path = (*at, name)
                yield f"without {_part_name(scenario, path)}", with_value(scenario, path, plain)
    if scenario.seed != 0:
        yield "with seed 0", replace(scenario, seed=0)


def _fewer_moves(scenario: Scenario, k: int, hand: MovingHand) -> Iterator[tuple[str, Scenario]]:
    """Yield the scenario with fewer moves.

    The first scenario lacks the second half of the moves. Each further scenario lacks a single move.
    """
    path, count = ("hands", k, "moves"), len(hand.moves)
    if count > 2:
        half = hand.moves[: count // 2]
        yield f"the {hand.name} without its later moves", with_value(scenario, path, half)
    for j in reversed(range(count)):
        moves = _without(hand.moves, j)
        yield f"the {hand.name} without its move {j + 1}", with_value(scenario, path, moves)


def _of_settings(scenario: Scenario) -> Iterator[tuple[str, Scenario]]:
    """Yield the scenario with default settings.

    The first scenario has all settings at their defaults. In each further scenario, only one group or one
    setting has its default.
    """
    if scenario.settings == DEFAULTS:
        return
    yield "with default settings", replace(scenario, settings=DEFAULTS)
    for group in fields(DEFAULTS):
        default, own = getattr(DEFAULTS, group.name), getattr(scenario.settings, group.name)
        if own == default:
            continue
        path = ("settings", group.name)
        name = group.name.replace("_", " ")
        yield f"with the default {name}", with_value(scenario, path, default)
        for setting in fields(default):
            value = getattr(default, setting.name)
            if getattr(own, setting.name) != value:
                without = with_value(scenario, (*path, setting.name), value)
                yield f"with the default {name}, {setting.name}", without


def _hands_and_moves(scenario: Scenario) -> Iterator[Path]:
    """Yield the paths of all hands and their moves."""
    for k, hand in enumerate(scenario.hands):
        yield "hands", k
        yield from (("hands", k, "moves", j) for j in range(len(getattr(hand, "moves", ()))))


def _part_name(scenario: Scenario, path: Path) -> str:
    """Describe in words the part of the scenario at ``path``."""
    part = str(path[-1]).rsplit("_in_", 1)[0]
    for suffix in ("_mps2", "_mps", "_rad", "_s", "_m"):
        part = part.removesuffix(suffix)
    place = path[1] if path[0] == "hands" else None
    owner = f"the {scenario.hands[place].name}'s " if isinstance(place, int) else ""
    return owner + ("the start's " if path[0] == "start" else "") + part.replace("_", " ")


def _without(members: tuple[T, ...], k: int) -> tuple[T, ...]:
    """Return ``members`` without the member at index ``k``."""
    return members[:k] + members[k + 1 :]


@dataclass(frozen=True)
class ShrinkTarget:
    """One number of a scenario that shrinking simplifies.

    The object has the path of the number, its simplest value ``target``, and the ``step`` between round
    numbers. If ``target`` is None, the number is only rounded.
    """

    path: Path
    target: float | None
    step: float

    def on(self, level: int) -> Callable[[int], float]:
        """Return a function that maps the integer k to the k-th round number of ``level``.

        Each further level divides the step by ten.
        """
        parts = 10**level
        if self.step == _DEGREE:
            return lambda k: math.radians(k / parts)
        whole = round(1.0 / self.step) * parts
        return lambda k: k / whole

    def place_of(self, value: float, level: int) -> float:
        """Return the index k of ``value`` in the list of the round numbers of ``level``.

        Between two round numbers, k is a fraction.
        """
        return value / self.step * int(10**level)

    def level_of(self, value: float) -> int:
        """Return the coarsest level on which ``value`` is a round number.

        The result FINER means that the number is not round on any level.
        """
        for level in range(FINER):
            if self.on(level)(round(self.place_of(value, level))) == value:
                return level
        return FINER


def shrink_targets(scenario: Scenario) -> Iterator[ShrinkTarget]:
    """Yield every number that shrinking may simplify.

    Numbers that shorten the run come first.
    """
    cell, avoidance = scenario.settings.cell, scenario.settings.avoidance
    yield from _below(scenario, (), {"duration_s": LEAST_S})
    start = {
        "offset_in_base_m": _NOWHERE,
        "position_in_base_m": cell.desired_tcp_position_in_base_m,
        "tilt_in_tcp_rad": _NOWHERE,
    }
    yield from _below(scenario, ("start",), start)
    move = {
        "position_in_base_m": avoidance.nominal_hand_position_in_base_m,
        "speed_mps": LEAST_MPS,
        "until_distance_m": None,
        "at_most_s": LEAST_S,
        "hesitation": None,
        "distance_m": None,
        "from_in_base_m": None,
        "to_in_base_m": None,
        "duration_s": LEAST_S,
    }
    for k, hand in enumerate(scenario.hands):
        if isinstance(hand, MovingHand | RecordedHand):
            at = ("hands", k)
            yield from _below(scenario, at, {"delay_s": 0.0, "speed_factor": 1.0, "turn_rad": 0.0})
            for j in range(len(getattr(hand, "moves", ()))):
                yield from _below(scenario, (*at, "moves", j), move)
            yield from _below(scenario, at, {"starts_at_in_base_m": None})
    for k in range(len(scenario.faults)):
        times = {"from_s": 0.0, "for_s": None, "until_s": None, "delay_s": 0.0}
        yield from _below(scenario, ("faults", k), times)


def _below(scenario: Scenario, at: Path, targets: Mapping[str, Any]) -> Iterator[ShrinkTarget]:
    """Yield a ``ShrinkTarget`` for every number of ``targets`` that exists below the path ``at``."""
    for name, target in targets.items():
        for path, value in leaves(getattr(value_at(scenario, at), name, None), (*at, name)):
            if isinstance(value, float):
                axis = path[-1]
                own = target[axis] if isinstance(target, tuple) and isinstance(axis, int) else target
                last = next(step for step in reversed(path) if isinstance(step, str))
                yield ShrinkTarget(path, own, next(_STEPS[end] for end in _STEPS if last.endswith(end)))


Violates = Callable[[Scenario], bool]


@dataclass(frozen=True)
class Shrunk:
    """A shrunk scenario that violates the claim.

    ``steps`` describes the accepted simplifications, and ``used`` is the number of runs. ``settled`` states
    that no simpler candidate violates the claim. ``settled`` is False if the budget or Ctrl-C ended the
    shrinking.
    """

    scenario: Scenario
    steps: tuple[str, ...]
    used: int
    settled: bool
    interrupted: bool = False

    @property
    def done(self) -> bool:
        """Whether the scenario became simpler, or whether it cannot become simpler."""
        return self.settled or bool(self.steps)

    @property
    def summary(self) -> str:
        """A phrase that states whether the scenario was shrunk, and in how many runs."""
        shrunk = f"shrunk in {self.used} runs" + ("" if self.settled else ", not to the end")
        return shrunk if self.done else "not shrunk"


class SpentError(Exception):
    """The error that ends shrinking when the budget is used up.

    The function ``violates`` may also raise this error.
    """


def shrink(scenario: Scenario, violates: Violates, *, budget: int) -> Shrunk:
    """Shrink a violating scenario until no simpler candidate violates the claim.

    The budget or Ctrl-C may end the shrinking earlier. A candidate that cannot be written to a file and read
    back is never run.

    Args:
        scenario: A scenario that violates the claim.
        violates: The function that runs a candidate and returns whether it violates the claim.
        budget: The greatest number of runs.

    Returns:
        The simplest violating scenario found.

    """
    at_work = _Shrinking(scenario, violates, budget)
    settled = interrupted = False
    try:
        while at_work.one_round():
            pass
        settled = True
    except SpentError:
        pass
    except KeyboardInterrupt:
        interrupted = True
    return Shrunk(at_work.scenario, tuple(at_work.steps), at_work.used, settled, interrupted)


@dataclass(eq=False)
class _Shrinking:
    """The state of one shrinking: the simplest scenario so far, and the verdict of each tried file text."""

    scenario: Scenario
    violates: Violates
    budget: int
    used: int = 0
    steps: list[str] = field(default_factory=list)
    _known: dict[str, bool] = field(default_factory=dict)

    def one_round(self) -> bool:
        """Run one round, and return whether the scenario became simpler."""
        count_before, number = len(self.steps), 0
        # A shorter run makes all later candidates cheaper, so the duration comes first.
        self._halve()
        # After a simplification, the candidates are listed anew, and the same index stands for the next part.
        while number < len(candidates := list(simpler(self.scenario))):
            if not self._accept(*candidates[number]):
                number += 1
        for knob in list(shrink_targets(self.scenario)):
            self._turn(knob)
        return len(self.steps) > count_before

    def _halve(self) -> None:
        """Halve the run's duration, in whole steps, as long as the scenario violates the claim."""
        (knob,) = _below(self.scenario, (), {"duration_s": LEAST_S})
        while True:
            half = knob.on(0)(math.ceil(knob.place_of(self.scenario.duration_s, 0) / 2.0))
            if not LEAST_S <= half < self.scenario.duration_s or not self._set(knob, half):
                return

    def _turn(self, knob: ShrinkTarget) -> None:
        """Set ``knob`` to its target, or to the nearest round number that still violates the claim."""
        value = float(value_at(self.scenario, knob.path))
        if knob.target is not None and (value == knob.target or self._set(knob, knob.target)):
            return
        level = self._round(knob, value)
        if level < FINER and knob.target is not None:
            self._approach(knob, level)

    def _round(self, knob: ShrinkTarget, value: float) -> int:
        """Round ``knob`` to the coarsest level that still violates the claim, and return that level."""
        own = knob.level_of(value)
        falls = knob.target is not None and knob.target < value
        for level in range(own):
            place = knob.place_of(value, level)
            # Round towards the target first.
            sides = (math.floor(place), math.ceil(place)) if falls else (math.ceil(place), math.floor(place))
            if any(self._set(knob, knob.on(level)(side)) for side in sides):
                return level
        return own

    def _approach(self, knob: ShrinkTarget, level: int) -> None:
        """Find by bisection a violating number that is close to the target.

        The target does not violate the claim, and the present number does.
        """
        assert knob.target is not None
        number = knob.on(level)
        safe = round(knob.place_of(knob.target, level))
        violating = round(knob.place_of(float(value_at(self.scenario, knob.path)), level))
        while abs(violating - safe) > 1:
            middle = (violating + safe) // 2
            if self._set(knob, number(middle)):
                violating = middle
            else:
                safe = middle

    def _set(self, knob: ShrinkTarget, value: float) -> bool:
        """Try ``value`` for ``knob``, and return whether the scenario still violates the claim."""
        step = f"{path_text(knob.path)} = {value:.6g}"
        return self._accept(step, with_value(self.scenario, knob.path, value))

    def _accept(self, step: str, candidate: Scenario) -> bool:
        """Read ``candidate`` back from its file, and make it the scenario if it violates the claim."""
        if candidate == self.scenario:
            return False
        tree = tree_of(candidate)
        text = text_of(tree)
        if text == write_scenario(self.scenario):  # a file omits the stop times of a user's arm
            return False
        # A text that did not violate the claim before needs neither reading nor a run.
        read = _read_back(tree, text, candidate) if self._known.get(text, True) else None
        if text not in self._known:
            self._known[text] = read is not None and self._run(read)
        if read is not None and self._known[text]:
            self.scenario = read
            self.steps.append(step)
        return self._known[text]

    def _run(self, candidate: Scenario) -> bool:
        """Run a candidate and return whether it violates the claim.

        Raise SpentError if the budget is used up.
        """
        # Check before the run, so that a budget of n allows exactly n runs.
        if self.used >= self.budget:
            raise SpentError
        self.used += 1
        return self.violates(candidate)


def _read_back(tree: Tree, text: str, scenario: Scenario) -> Scenario | None:
    """Return the scenario in a file with ``text``, or None if this is not a valid file.

    The result is also None if writing the scenario again would give another text. For speed, the scenario is
    read from ``tree`` and not from the text, because parsing the text would take longer than the run.
    Recorded motions are read again from their own files.
    """
    try:
        read = scenario_of(node_of(tree), scenario.file, name=scenario.name)
    except InputError:
        return None
    return read if write_scenario(read) == text else None
