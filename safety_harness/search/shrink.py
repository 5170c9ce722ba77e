"""From a scenario that violates a claim to a simple one that still does.

Things are taken away first, then numbers made simpler, and round again until a whole round changes
nothing: shrinking what came out gives it again.  Nothing is random, and ``budget`` bounds the runs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from math import ceil, floor

from safety_harness.exceptions import InputError
from safety_harness.scenario.model import Scenario
from safety_harness.scenario.read import parse_scenario
from safety_harness.scenario.write import write_scenario
from safety_harness.search.simpler import FINER, ShrinkTarget, shrink_targets, simpler
from safety_harness.space.tracing import value_at, with_value, words

Violates = Callable[[Scenario], bool]


@dataclass(frozen=True)
class Shrunk:
    """``scenario`` violates the claim; ``steps`` say what was made simpler, ``used`` how many runs it took.

    ``settled``: nothing simpler that was thought of violates it.  It is false where the budget or Ctrl-C
    came first.
    """

    scenario: Scenario
    steps: tuple[str, ...]
    used: int
    settled: bool
    interrupted: bool = False


class _SpentError(Exception):
    """The budget is."""


def shrink(scenario: Scenario, violates: Violates, *, budget: int) -> Shrunk:
    """Shrink ``scenario``, which violates; ``violates`` runs another one and says whether it does.

    What cannot be written and read back is never run.  Ctrl-C ends it early.
    """
    at_work = _Shrinking(scenario, violates, budget)
    settled = interrupted = False
    try:
        while at_work.one_round():
            pass
        settled = True
    except _SpentError:
        pass
    except KeyboardInterrupt:
        interrupted = True
    return Shrunk(at_work.scenario, tuple(at_work.steps), at_work.used, settled, interrupted)


@dataclass(eq=False)
class _Shrinking:
    scenario: Scenario
    violates: Violates
    budget: int
    used: int = 0
    steps: list[str] = field(default_factory=list)
    _known: dict[str, bool] = field(default_factory=dict)

    def one_round(self) -> bool:
        """Whether anything became simpler."""
        before, number = len(self.steps), 0
        while number < len(candidates := list(simpler(self.scenario))):
            if not self._accept(*candidates[number]):
                number += 1
        for knob in list(shrink_targets(self.scenario)):
            self._turn(knob)
        return len(self.steps) > before

    def _turn(self, knob: ShrinkTarget) -> None:
        """To the target if it can be; else to a round number, and as near to the target as violates."""
        value = float(value_at(self.scenario, knob.path))
        if knob.target is not None and (value == knob.target or self._set(knob, knob.target)):
            return
        level = self._round(knob, value)
        if level < FINER and knob.target is not None:
            self._approach(knob, level)

    def _round(self, knob: ShrinkTarget, value: float) -> int:
        """The level of the number then: the coarsest one that violates next to it, or its own."""
        own = knob.level_of(value)
        falls = knob.target is not None and knob.target < value
        for level in range(own):
            place = knob.place_of(value, level)
            sides = (floor(place), ceil(place)) if falls else (ceil(place), floor(place))
            if any(self._set(knob, knob.on(level)(side)) for side in sides):
                return level
        return own

    def _approach(self, knob: ShrinkTarget, level: int) -> None:
        """Bisect between the target, which does not violate, and the number, which does."""
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
        step = f"{words(knob.path)} = {value:.6g}"
        return self._accept(step, with_value(self.scenario, knob.path, value))

    def _accept(self, step: str, candidate: Scenario) -> bool:
        """Take the candidate, as it is read back from its file, if it violates."""
        if candidate == self.scenario:
            return False
        text = write_scenario(candidate)
        read = _read_back(text, candidate) if self._known.get(text, True) else None
        if text not in self._known:
            self._known[text] = read is not None and self._run(read)
        if read is not None and self._known[text]:
            self.scenario = read
            self.steps.append(step)
        return self._known[text]

    def _run(self, candidate: Scenario) -> bool:
        if self.used >= self.budget:
            raise _SpentError
        self.used += 1
        return self.violates(candidate)


def _read_back(text: str, scenario: Scenario) -> Scenario | None:
    """What a file with this text says, as a recorded motion is anew from it; None if it cannot be one."""
    try:
        read = parse_scenario(text, scenario.file, name=scenario.name)
    except InputError:
        return None
    return read if write_scenario(read) == text else None
