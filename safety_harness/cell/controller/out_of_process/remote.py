"""A controller elsewhere, as the loop sees it: what goes wrong there costs one episode, with a reason.

Its state is its own.  One that ended, hung, or said what is no message is begun anew at the next ``reset``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.exceptions import ControllerError, printable
from safety_harness.base.settings import DEFAULTS, Settings
from safety_harness.cell.controller.answers import LaneAnswers
from safety_harness.cell.controller.out_of_process.lines import FileLine, Line, RefusedControllerError
from safety_harness.cell.controller.out_of_process.messages import (
    Failed,
    MadeController,
    Ready,
    Reset,
    Said,
    SaidMove,
    SaidRows,
    SaidStop,
    Welcome,
    action_of,
)
from safety_harness.seams.contract import Action, DrivenArm, Seen, Start
from safety_harness.seams.isolation.channel import GoneError, NonsenseError


class RemoteController:
    """The controller at the other end of a line."""

    def __init__(self, line: Line) -> None:
        """Begin the line; GoneError, RefusedControllerError."""
        self._line = line
        try:
            self._said = line.begin()
        except BaseException:
            line.end()
            raise
        self.name = printable(self._said.name)
        self.sees, self.reports = self._said.sees, self._said.reports
        self._tick, self._lane, self._lanes = 0, 0, [0]
        self._limit_s = DEFAULTS.clock.wall_limit_s

    @property
    def another(self) -> Callable[[], RemoteController] | None:
        """What makes one more in the same process, for an episode beside; None if there can be none."""
        return self._another if isinstance(self._said, MadeController) and self._said.many else None

    @property
    def together(self) -> bool:
        """Does one call of its process answer for many episodes?"""
        return isinstance(self._said, MadeController) and self._said.together

    def _another(self) -> RemoteController:
        other = copy(self)
        other._lane = len(self._lanes)
        self._lanes.append(other._lane)
        return other

    def reset(self, *, settings: Settings, arm: DrivenArm, start: Start, seed: int) -> None:
        """Begin an episode, in a new process if the last one is gone."""
        self._limit_s, self._tick = settings.clock.wall_limit_s, 0
        told = Reset(settings, arm, start, str(seed), self._lane)
        try:
            if not self._line.alive:
                self._line.end()
                self._again(self._line.begin())
            self._line.reset(told, self._limit_s)
            said = self._line.hear(self._limit_s)
            if not isinstance(said, Ready | Failed):
                raise NonsenseError(f'after a reset it has to say "ready"; it said {_shown(said)}')
        except BaseException as error:
            raise self._over("reset", error) from error
        if isinstance(said, Failed):
            raise ControllerError(f"reset failed: {printable(said.why)}")

    def act(self, seen: Seen) -> Action:
        """What it says; ControllerError for nothing within the wall limit, or what is no action."""
        tick, self._tick = self._tick, self._tick + 1
        try:
            self._line.act(tick, seen, self.sees, self._lane, self._limit_s)
            said = self._line.hear(self._limit_s)
            if isinstance(said, SaidMove | SaidStop):
                if said.tick != tick:
                    raise NonsenseError(f"it answered tick {said.tick} when it was asked for tick {tick}")
                return action_of(said)
            if not isinstance(said, Failed):
                raise NonsenseError(f"it has to say how to move; it said {_shown(said)}")
        except BaseException as error:
            raise self._over("act", error) from error
        raise ControllerError(_begun(f"{printable(said.why)}", "act"))

    def act_together(
        self,
        others: Sequence[RemoteController],
        lanes: list[int],
        tick: int,
        hand_slots: int,
        rows: NDArray[np.float64],
        answers: LaneAnswers,
    ) -> dict[int, str]:
        """As ``ask_together``, in one turn to the process of all of ``others`` (n,), this one among them.

        ``rows`` (n, wanted) are what they see.
        """
        there, line = [one._lane for one in others], self._line
        assert isinstance(line, FileLine)
        limit_s = sum(one._limit_s for one in others)
        try:
            line.act_together(there, tick, hand_slots, rows.tobytes(), limit_s)
            said = line.hear(limit_s)
            if isinstance(said, SaidRows) and said.tick == tick and said.why.keys() <= {*there}:
                answers.take_sent(lanes, said.columns)
                here = dict(zip(there, lanes, strict=True))
                return {here[lane]: printable(why) for lane, why in said.why.items()}
            if not isinstance(said, Failed):
                raise NonsenseError(f"it has to say how to move at tick {tick}; it said {_shown(said)}")
        except BaseException as error:
            raise self._over("act", error) from error
        raise ControllerError(_begun(f"{printable(said.why)}", "act"))

    def _again(self, said: Welcome) -> None:
        if said != self._said:
            raise NonsenseError("begun once more it says other things of itself than at first")

    def _over(self, what: str, error: BaseException) -> BaseException:
        """The line is ended: who knows what would be said next; what the episode costs, in words."""
        self._line.end()
        if isinstance(error, GoneError) and error.hung:
            return ControllerError(f"{what}: it gave no answer within {self._limit_s:g} s of wall time")
        if isinstance(error, GoneError | RefusedControllerError | ValueError | TypeError):
            return ControllerError(f"{what}: {printable(str(error))}")
        return error  # Ctrl-C, or a mistake of ours


def _begun(words: str, what: str) -> str:
    return words if words.startswith(what) else f"{what} failed: {words}"


def _shown(said: Said) -> str:
    return printable(str(said.__struct_config__.tag))
