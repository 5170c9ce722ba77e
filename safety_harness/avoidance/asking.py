"""Asking an avoider: whatever it does, an answer or a fault in words comes back, and soon.

Simulated time stands still while an avoider thinks; a real arm would not wait.  An answer that takes
longer than the deadline is thrown away, and the decision is a fault like any other.  Time on a clock
does not repeat, so that *whether* an answer was late is recorded, and a replay takes that from the record.
"""

from __future__ import annotations

import signal
import threading
import time
import traceback
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import FrameType
from typing import NamedTuple

import numpy as np

from safety_harness.avoidance.asked import Asked
from safety_harness.avoidance.avoider import (
    Avoider,
    Proposal,
    Vector,
    checked,
    described,
    printable,
    spread_threshold_of,
)
from safety_harness.exceptions import AvoiderError

NOWHERE = Proposal(np.full(3, np.nan), np.full(3, np.nan))


@dataclass(frozen=True, eq=False)
class Answer:
    """One avoider's proposal, the largest spread that it may have, or why there is none.

    ``latency_s`` is the wall-clock time that it took; ``late`` says that it was thrown away for it.
    """

    proposal: Proposal = field(default=NOWHERE)
    spread_threshold_m: float = np.nan
    fault: str = ""
    late: bool = False
    latency_s: float = 0.0


class Question(NamedTuple):
    """One question; ``timed``: by the clock, with the deadline, else waited for."""

    hand_position_in_base_m: Vector
    tcp_position_in_base_m: Vector
    seed: int
    deadline_s: float
    timed: bool


class Elsewhere(ABC):
    """An avoider in another process, which keeps the deadlines itself."""

    takes_many: bool  # in one call

    @abstractmethod
    def answers(self, questions: Sequence[Question], *, together: bool) -> list[Answer]:
        """One for each; ``together``: in one call if the avoider takes many, and then without a deadline.

        SimulationError if there is no such process and none can be had.
        """


class _TooLate(BaseException):
    """Raised within an avoider at the deadline; not an Exception, which it might catch."""


def ask(
    avoider: Avoider,
    *,
    hand_position_in_base_m: Vector,
    tcp_position_in_base_m: Vector,
    seed: int,
    deadline_s: float,
    late: bool | None = None,
) -> Answer:
    """One avoider's answer.

    Whatever it raises becomes a fault in words; only the interpreter's own exits pass.  At
    ``deadline_s`` it is interrupted where it runs Python on the main thread; anything else is waited
    for, and then thrown away.  ``late`` is what a record says about it: True does not ask at all,
    False waits for ever, None leaves it to the clock.
    """
    if late:
        return Answer(fault=late_fault(deadline_s), late=True)
    one, hand, tcp = addressed(avoider, hand_position_in_base_m, tcp_position_in_base_m)
    if isinstance(one, Elsewhere):
        return one.answers([Question(hand, tcp, seed, deadline_s, late is None)], together=False)[0]
    begun_s = time.perf_counter()
    try:
        with _interrupted_after(np.inf if late is False else deadline_s):
            answer = _ask(avoider, hand_position_in_base_m.copy(), tcp_position_in_base_m.copy(), seed)
    except _TooLate:
        answer = Answer()
    latency_s = time.perf_counter() - begun_s
    if late is None and latency_s > deadline_s:
        return Answer(fault=late_fault(deadline_s), late=True, latency_s=latency_s)
    return Answer(answer.proposal, answer.spread_threshold_m, answer.fault, latency_s=latency_s)


def addressed(avoider: Avoider, hand: Vector, tcp: Vector) -> tuple[Avoider, Vector, Vector]:
    """Who is asked, and of which hand and TCP, where a fault has the answer to an earlier question count."""
    if isinstance(avoider, Asked):
        return avoider.avoider, avoider.hand_position_in_base_m, avoider.tcp_position_in_base_m
    return avoider, hand, tcp


def late_fault(deadline_s: float) -> str:
    """How a decision without an answer in time is recorded."""
    return f"no answer within {deadline_s * 1e3:g} ms"


def _ask(avoider: Avoider, hand_in_base_m: Vector, tcp_in_base_m: Vector, seed: int) -> Answer:
    try:
        threshold_m = spread_threshold_of(avoider)
        proposal = avoider.propose(
            hand_position_in_base_m=hand_in_base_m, tcp_position_in_base_m=tcp_in_base_m, seed=seed
        )
        return answer_of(proposal, threshold_m)
    except AvoiderError as error:
        return Answer(fault=printable(str(error)) or "AvoiderError")
    except Exception as error:  # a user's code may raise anything
        frames = traceback.extract_tb(error.__traceback__, limit=2)  # this function, then the avoider's
        return Answer(fault=described(error, frames[1].filename if len(frames) > 1 else None))


def answer_of(proposal: object, threshold_m: float | None) -> Answer:
    """What an avoider returned, looked at; a fault in words if it is no proposal."""
    try:
        return Answer(checked(proposal), np.nan if threshold_m is None else threshold_m)
    except AvoiderError as error:
        return Answer(fault=str(error))


@contextmanager
def _interrupted_after(seconds: float) -> Iterator[None]:
    """Raise _TooLate within after ``seconds``, where a timer signal can be had: there is one a process."""
    free = threading.current_thread() is threading.main_thread() and hasattr(signal, "setitimer")
    if not np.isfinite(seconds) or not free or signal.getitimer(signal.ITIMER_REAL)[0] > 0.0:
        yield
        return

    def interrupt(number: int, frame: FrameType | None) -> None:
        raise _TooLate

    before = signal.signal(signal.SIGALRM, interrupt)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
