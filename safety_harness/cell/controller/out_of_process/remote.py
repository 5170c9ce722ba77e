"""Call a controller in another process.

A fault of the controller then ends only one episode, with a reason. The controller keeps its state in its own
process. If the process ends, hangs, or sends an invalid message, the next ``reset`` starts it again.
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
    SaidPrediction,
    SaidRow,
    SaidRows,
    SaidStop,
    Welcome,
    action_in,
    action_of,
    fields_of,
    seen_at,
)
from safety_harness.seams.contract import Answer, DrivenArm, Seen, Start
from safety_harness.seams.isolation.channel import GoneError, NonsenseError
from safety_harness.seams.isolation.connection import Connection, RefusedError
from safety_harness.seams.isolation.messages import Failed, ProcessMessage

T = TypeVar("T")


class RemoteController:
    """A controller at the other end of a connection.

    ``first`` makes the first message to the controller. The controller must answer this message within
    ``within_s``.
    """

    def __init__(self, connection: Connection, first: Callable[[], ProcessMessage], within_s: float) -> None:
        """Begin the connection.

        Raise ``GoneError`` or ``RefusedError`` if no valid welcome arrives.
        """
        self._connection, self._first, self._within_s = connection, first, within_s
        self._said = self._begun()
        self.name = printable(self._said.name)
        self.sees, self.reports = self._said.sees, self._said.reports
        self._tick, self._lane, self._lanes = 0, 0, [0]
        self._clock = DEFAULTS.clock

    @property
    def another(self) -> Callable[[], RemoteController] | None:
        """A function that makes a controller for another lane in the same process.

        The property is None if the process cannot make another controller.
        """
        return self._another if isinstance(self._said, MadeController) and self._said.many else None

    @property
    def together(self) -> bool:
        """Whether one call of the controller's process answers for many episodes."""
        return isinstance(self._said, MadeController) and self._said.together

    @property
    def acts_per_answer(self) -> int:
        """The number of calls of ``act`` for which one answer lasts.

        The number is 1 for a program.
        """
        return self._said.acts_per_answer if isinstance(self._said, MadeController) else 1

    def _another(self) -> RemoteController:
        """Return a controller for the next lane of the same process."""
        copied = copy(self)
        copied._lane = len(self._lanes)
        self._lanes.append(copied._lane)
        return copied

    def reset(self, *, settings: Settings, arm: DrivenArm, start: Start, seed: int) -> None:
        """Begin an episode.

        If the last process has ended, the method starts a new one.
        """
        self._clock, self._tick = settings.clock, 0
        message = Reset(settings, arm, start, str(seed), self._lane)
        self._call(message, self._clock.wall_limit_s, Ready, lambda ready: None)

    def act(self, seen: Seen) -> Answer:
        """Return the controller's answer.

        Raise ``ControllerError`` if the answer is invalid or does not arrive within the wall-clock limit.
        """
        tick, self._tick = self._tick, self._tick + 1
        limit_s = self._clock.wall_limit_s
        if isinstance(self._said, MadeController):
            kinds: Any = SaidRow | SaidPrediction
            return self._call(seen_at(tick, seen, self._lane), limit_s, kinds, action_in)
        kinds = SaidMove | SaidStop | SaidPrediction
        return self._call(Act(tick, fields_of(seen, self.sees)), limit_s, kinds, action_of)

    def act_together(
        self,
        controllers: Sequence[RemoteController],
        lanes: list[int],
        tick: int,
        hand_slots: int,
        rows: NDArray[np.float64],
        answers: LaneAnswers,
    ) -> dict[int, str]:
        """Call several controllers of this process in one exchange.

        The result is the same as the result of ``ask_together``. This controller must be one of
        ``controllers`` (n,). ``rows`` (n, wanted) contains the views of these controllers.
        """
        here = {c._lane: lane for c, lane in zip(controllers, lanes, strict=True)}

        def read(answer: SaidRows) -> dict[int, str]:
            if not answer.why.keys() <= here.keys():
                raise NonsenseError
            answers.take_sent(lanes, answer.columns)
            return {here[lane]: printable(why) for lane, why in answer.why.items()}

        layout = self._clock.control_period_s, hand_slots, answers.joints.shape[1], self.sees
        message = ActOnRows(tick, [*here], (*layout, rows.tobytes()), together=True)
        return self._call(message, sum(c._clock.wall_limit_s for c in controllers), SaidRows, read)

    def _begun(self) -> Welcome:
        """Exchange the first messages.

        Raise ``RefusedError`` if the controller has another protocol.
        """
        welcome = self._connection.introduce(self._first(), Welcome, self._within_s)
        if welcome.protocol != PROTOCOL:
            hint = "safety-harness docs reference/controller-protocol"
            raise RefusedError(f"the protocol {PROTOCOL!r}", repr(welcome.protocol), hint)
        return welcome

    def _call(self, sent: Reset | Act | ActOnRows, limit_s: float, kind: Any, read: Callable[[Any], T]) -> T:
        """Send a message, and return the result of ``read`` for the answer.

        The answer must have the type ``kind``. If the answer is missing, invalid or of another type, end the
        connection and raise ``ControllerError``.
        """
        try:
            if isinstance(sent, Reset) and not self._connection.quiet:
                self._connection.end()
                if self._begun() != self._said:
                    raise NonsenseError("after a restart it describes itself differently")
            self._connection.say(sent, limit_s)
            answer = self._connection.hear(limit_s)
            if isinstance(answer, kind):
                expected, tick = getattr(sent, "tick", None), getattr(answer, "tick", None)
                if tick != expected:
                    raise NonsenseError(f"it answered tick {tick} instead of tick {expected}")
                return read(answer)
            if not isinstance(answer, Failed):
                raise NonsenseError(f"{sent.wants}; it said {answer.__struct_config__.tag}")
        except BaseException as error:  # a later message might belong to this question
            self._connection.end()
            if isinstance(error, GoneError) and error.hung:
                reason = f"it gave no answer within {self._clock.wall_limit_s:g} s of wall time"
            elif isinstance(error, GoneError | RefusedError | ValueError | TypeError):
                reason = printable(str(error))
            else:
                raise  # Ctrl-C, or a mistake of ours
            raise ControllerError(f"{sent.call}: {reason}") from error
        why = printable(answer.why)
        raise ControllerError(why if why.startswith(sent.call) else f"{sent.call} failed: {why}")
