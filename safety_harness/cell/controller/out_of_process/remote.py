"""A controller elsewhere, as the loop sees it: what goes wrong there costs one episode, with a reason.

Its state is its own.  One that ended, hung, or said what is no message is begun anew at the next ``reset``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.exceptions import ControllerError, printable
from safety_harness.base.settings import DEFAULTS, Settings
from safety_harness.cell.controller.answers import LaneAnswers
from safety_harness.cell.controller.out_of_process.messages import (
    PROTOCOL,
    Act,
    ActOnRows,
    MadeController,
    Ready,
    Reset,
    SaidMove,
    SaidRow,
    SaidRows,
    SaidStop,
    Welcome,
    action_in,
    action_of,
    fields_of,
    seen_at,
)
from safety_harness.seams.contract import Action, DrivenArm, Seen, Start
from safety_harness.seams.isolation.channel import GoneError, NonsenseError
from safety_harness.seams.isolation.connection import Connection, RefusedError
from safety_harness.seams.isolation.messages import Failed, ProcessMessage

T = TypeVar("T")


class RemoteController:
    """The controller at the other end of a connection.

    ``first`` makes the message that it is introduced by, which it has to answer ``within_s``.
    """

    def __init__(self, connection: Connection, first: Callable[[], ProcessMessage], within_s: float) -> None:
        """Begin the connection; GoneError, RefusedError."""
        self._connection, self._first, self._within_s = connection, first, within_s
        self._said = self._begun()
        self.name = printable(self._said.name)
        self.sees, self.reports = self._said.sees, self._said.reports
        self._tick, self._lane, self._lanes = 0, 0, [0]
        self._clock = DEFAULTS.clock

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
        self._clock, self._tick = settings.clock, 0
        told = Reset(settings, arm, start, str(seed), self._lane)
        self._asked(told, self._clock.wall_limit_s, Ready, lambda said: None)

    def act(self, seen: Seen) -> Action:
        """What it says; ControllerError for nothing within the wall limit, or what is no action."""
        tick, self._tick = self._tick, self._tick + 1
        limit_s = self._clock.wall_limit_s
        if isinstance(self._said, MadeController):
            return self._asked(seen_at(tick, seen, self._lane), limit_s, SaidRow, action_in)
        return self._asked(Act(tick, fields_of(seen, self.sees)), limit_s, SaidMove | SaidStop, action_of)

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
        here = {one._lane: lane for one, lane in zip(others, lanes, strict=True)}

        def taken(said: SaidRows) -> dict[int, str]:
            if not said.why.keys() <= here.keys():
                raise NonsenseError
            answers.take_sent(lanes, said.columns)
            return {here[lane]: printable(why) for lane, why in said.why.items()}

        layout = self._clock.control_period_s, hand_slots, answers.joints.shape[1], self.sees
        told = ActOnRows(tick, [*here], (*layout, rows.tobytes()), together=True)
        return self._asked(told, sum(one._clock.wall_limit_s for one in others), SaidRows, taken)

    def _begun(self) -> Welcome:
        said = self._connection.introduce(self._first(), Welcome, self._within_s)
        if said.protocol != PROTOCOL:
            hint = "safety-harness docs controller-protocol"
            raise RefusedError(f"the protocol {PROTOCOL!r}", repr(said.protocol), hint)
        return said

    def _asked(self, told: Reset | Act | ActOnRows, limit_s: float, kind: Any, read: Callable[[Any], T]) -> T:
        """What ``read`` makes of an answer of that ``kind``; ControllerError for none, and that ends it."""
        try:
            if isinstance(told, Reset) and not self._connection.quiet:
                self._connection.end()
                if self._begun() != self._said:
                    raise NonsenseError("begun once more it says other things of itself than at first")
            self._connection.say(told, limit_s)
            said = self._connection.hear(limit_s)
            if isinstance(said, kind):
                asked, tick = getattr(told, "tick", None), getattr(said, "tick", None)
                if tick != asked:
                    raise NonsenseError(f"it answered tick {tick} when it was asked for tick {asked}")
                return read(said)
            if not isinstance(said, Failed):
                raise NonsenseError(f"{told.wants}; it said {said.__struct_config__.tag}")
        except BaseException as error:  # who knows what it would say next
            self._connection.end()
            if isinstance(error, GoneError) and error.hung:
                words = f"it gave no answer within {self._clock.wall_limit_s:g} s of wall time"
            elif isinstance(error, GoneError | RefusedError | ValueError | TypeError):
                words = printable(str(error))
            else:
                raise  # Ctrl-C, or a mistake of ours
            raise ControllerError(f"{told.call}: {words}") from error
        why = printable(said.why)
        raise ControllerError(why if why.startswith(told.call) else f"{told.call} failed: {why}")
