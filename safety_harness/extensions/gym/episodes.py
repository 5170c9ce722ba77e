"""Provide the episodes of an environment.

The episodes are repetitions of one scenario, or those draws of a space that can run.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from operator import index
from pathlib import Path

from safety_harness.admission.admit import Checked, check
from safety_harness.admission.spaces import MAX_REJECTION_RATIO, why_refused
from safety_harness.base.exceptions import InadmissibleError, InputError
from safety_harness.base.seeds import Branch
from safety_harness.base.seeds import seed as leaf
from safety_harness.base.settings import DecisionTimes
from safety_harness.cell.simulation.worlds import WorldEntry
from safety_harness.scenario.model import NO_AVOIDER, Scenario
from safety_harness.scenario.read import read_scenario
from safety_harness.space.read import read_space
from safety_harness.space.space import ScenarioSpace

OUTSIDE = "gymnasium environment"  # how traces call the controller
File = str | Path


class Episodes:
    """The source of an environment's episodes: either one ``scenario``, or draws from a ``space``.

    Observations and actions must have the same size in all episodes. The hand slots, the arm, the desired
    pose, the motion limits and the clock must therefore be the same as in the ``first`` episode.
    """

    def __init__(
        self, scenario: Scenario | File | None, space: ScenarioSpace | File | None, world: WorldEntry
    ) -> None:
        if (scenario is None) == (space is None):
            got = "neither" if scenario is None else "both"
            raise InadmissibleError.of_option("make", "scenario=... or space=..., one of them", got)
        self._scenario = None if scenario is None else read_scenario(scenario)
        self._space = read_space(space) if isinstance(space, str | Path) else space
        self._world = world
        self._size: tuple[object, ...] = ()
        self.first = self.next_of(self.stream(None))

    def stream(self, seed: int | None, number: int = 0) -> EpisodeStream:
        """Return the episodes of stream ``seed``, beginning with draw ``number``."""
        return EpisodeStream(self, seed, number)

    def next_of(self, stream: EpisodeStream) -> Checked:
        """Return the next draw of ``stream`` that can run, and advance the stream past it.

        Raises:
            InadmissibleError: Too few draws of the space can run, or their sizes differ.

        """
        for _ in range(MAX_REJECTION_RATIO):
            stream.number += 1
            try:
                checked = self._checked(stream.seed, stream.number - 1)
            except InputError as error:
                if self._space is None:
                    raise
                refused = error
            else:
                self._refuse_other_size(checked.scenario)
                return checked
        expected = f"a space in which at least one draw in {MAX_REJECTION_RATIO} can run"
        raise InadmissibleError.of_option("space", expected, why_refused(refused)) from refused

    def _checked(self, seed: int | None, number: int) -> Checked:
        if self._space is not None:
            scenario = self._space.draw(seed or 0, number)
        else:
            assert self._scenario is not None
            scenario = self._scenario
            if seed is not None:
                scenario = replace(scenario, seed=leaf(seed, Branch.ENVIRONMENT, number))
        if scenario.shield is not None:
            expected = "no shield, since an agent must learn without its help"
            place = scenario.place("shield")
            raise InadmissibleError(place=place, expected=expected, got="one")
        cost = scenario.settings.avoidance.decision_time
        if isinstance(cost, DecisionTimes) and cost.most_s > 0.0:
            expected = "no decision time, since an agent's action counts in its own tick"
            place = scenario.place("settings.avoidance.decision time")
            raise InadmissibleError(place=place, expected=expected, got="one")
        checked = check(replace(scenario, controller=OUTSIDE, avoider=NO_AVOIDER))
        self._world.refuse(scenario)
        return checked

    def _refuse_other_size(self, scenario: Scenario) -> None:
        """Refuse a scenario of another size, because an environment's spaces must never change."""
        settings = scenario.settings
        size = scenario.hand_slots, scenario.robot, settings.cell, settings.motion, settings.clock
        if self._size and size != self._size:
            raise InadmissibleError(
                place=scenario.place("space"),
                expected="draws alike in arm, desired pose, motion limits, clock, room for hands (2, 4, 8)",
                got=f"{scenario.name}, which is not like those before it",
            )
        self._size = size


@dataclass(eq=False)
class EpisodeStream(Iterator[Checked]):
    """An endless stream of episodes; a copy of the stream continues in the same way as the original.

    For a space, the stream yields the draws with the stream number ``seed``, except draws that cannot run.
    For a scenario, it yields the same scenario repeatedly. If ``seed`` is given, episode k of the scenario
    gets the seed of leaf k. If it is None, a space yields stream 0, and a scenario keeps its own seed.
    ``number`` is the draw to try next. ``drawn`` is the name of the last draw, which includes the stream
    number.
    """

    episodes: Episodes
    seed: int | None
    number: int = 0
    drawn: str = ""

    def __next__(self) -> Checked:
        """Return the next episode."""
        checked = self.episodes.next_of(self)
        self.drawn = checked.scenario.name + ("" if self.seed is None else f" of seed {self.seed}")
        return checked


def stream_number(seed: object, place: str = "seed") -> int:
    """Return ``seed`` as an int; raise InadmissibleError if it is negative or not an integer."""
    try:
        number = index(seed)  # type: ignore[arg-type]  # what it refuses is refused here
    except TypeError:
        number = -1
    if number < 0 or isinstance(seed, bool):
        raise InadmissibleError.of_option(place, "a whole number, at least 0", repr(seed))
    return number
