"""What is tried in one episode after another: a scenario, or draws of a space that can be tried."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from safety_harness.admission.admit import Checked, check
from safety_harness.admission.spaces import MAX_REJECTION_RATIO, why_refused
from safety_harness.base.exceptions import InadmissibleError, InputError
from safety_harness.base.seeds import Branch
from safety_harness.base.seeds import seed as leaf
from safety_harness.cell.simulation.worlds import WorldEntry
from safety_harness.scenario.model import NO_AVOIDER, Scenario
from safety_harness.scenario.read import read_scenario
from safety_harness.space.read import read_space
from safety_harness.space.space import ScenarioSpace

OUTSIDE = "gymnasium environment"  # how traces call the controller
File = str | Path


class Episodes:
    """Where episodes come from: of a ``space`` its draws, else the one ``scenario``.

    All of them need the same room in observations: hands, arm and desired pose like those of the ``first``.
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
        self._room: tuple[object, ...] = ()
        self.first = next(self.stream(None))

    def stream(self, seed: int | None) -> Iterator[Checked]:
        """Without end: the space's draws of the stream ``seed`` that can be tried, None being stream 0.

        The scenario is run as it stands, again and again, until a seed is given: then episode k of it has
        the seed of leaf k.  InadmissibleError for a space that cannot be tried, or one of various rooms.
        """
        number, refused = 0, 0
        while True:
            try:
                checked = self._checked(seed, number)
            except InputError as error:
                if self._space is None:
                    raise
                reason = why_refused(error)
                refused += 1
                if refused >= MAX_REJECTION_RATIO:
                    expected = f"a space of which at least one draw in {MAX_REJECTION_RATIO} can be tried"
                    raise InadmissibleError.of_option("space", expected, reason) from error
            else:
                refused = 0
                self._refuse_other_room(checked.scenario)
                yield checked
            number += 1

    def _checked(self, seed: int | None, number: int) -> Checked:
        if self._space is not None:
            scenario = self._space.draw(seed or 0, number)
        else:
            assert self._scenario is not None
            scenario = self._scenario
            if seed is not None:
                scenario = replace(scenario, seed=leaf(seed, Branch.ENVIRONMENT, number))
        if scenario.shield is not None:
            expected = "no shield: an agent learns what it does itself"
            place = scenario.place("shield")
            raise InadmissibleError(place=place, expected=expected, got="one")
        checked = check(replace(scenario, controller=OUTSIDE, avoider=NO_AVOIDER))
        self._world.refuse(scenario)
        return checked

    def _refuse_other_room(self, scenario: Scenario) -> None:
        """An environment's spaces of observations and actions never change."""
        settings = scenario.settings
        room = scenario.hand_slots, scenario.robot, settings.cell, settings.motion, settings.clock
        if self._room and room != self._room:
            raise InadmissibleError(
                place=scenario.place("space"),
                expected="draws alike in arm, desired pose, motion limits, clock, room for hands (2, 4, 8)",
                got=f"{scenario.name}, which is not like those before it",
            )
        self._room = room
