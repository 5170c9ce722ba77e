"""Asking an avoider: whatever it does, an answer or a fault in words comes back.

What a decision costs in simulated time is declared (``decision_times``); how long an answer takes on the
wall's clock is measured and changes nothing, unless it never comes: that ends the run.
"""

from __future__ import annotations

import signal
import threading
import time
import traceback
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from types import FrameType
from typing import NamedTuple

import numpy as np

from safety_harness.avoidance.asked import DelayedQuery
from safety_harness.avoidance.avoider import (
    Avoider,
    Proposal,
    Vector,
    checked,
    described,
    printable,
    spread_threshold_of,
)
from safety_harness.exceptions import AvoiderError, NoAnswerError
from safety_harness.settings import DEFAULTS

WALL_LIMIT_S = DEFAULTS.clock.wall_limit_s
NAN_PROPOSAL = Proposal(np.full(3, np.nan), np.full(3, np.nan))


@dataclass(frozen=True, eq=False)
class Answer:
    """One avoider's proposal, the largest spread that it may have, or why there is none.

    ``latency_s`` is the wall-clock time that it took; ``late``: in simulated time it comes after the
    decision deadline, and is not asked for.
    """

    proposal: Proposal = field(default=NAN_PROPOSAL)
    spread_threshold_m: float = np.nan
    fault: str = ""
    late: bool = False
    latency_s: float = 0.0


class Question(NamedTuple):
    """One question, and how long its answer is waited for on the wall's clock."""

    hand_position_in_base_m: Vector
    tcp_position_in_base_m: Vector
    seed: int
    limit_s: float


class OutOfProcessAvoider(ABC):
    """An avoider in another process, which keeps the wall limit itself."""

    takes_many: bool  # in one call

    @abstractmethod
    def answers(self, questions: Sequence[Question], *, together: bool) -> list[Answer]:
        """One for each; ``together``: in one call if the avoider takes many.

        NoAnswerError; SimulationError if there is no such process and none can be had.
        """


class _Hangs(BaseException):
    """Raised within an avoider at the wall limit; not an Exception, which it might catch."""


def ask(
    avoider: Avoider,
    *,
    hand_position_in_base_m: Vector,  # (3,)
    tcp_position_in_base_m: Vector,  # (3,)
    seed: int,
    limit_s: float = WALL_LIMIT_S,
) -> Answer:
    """One avoider's answer.

    Whatever it raises becomes a fault in words; only the interpreter's own exits pass.  NoAnswerError if
    it takes longer than ``limit_s`` on the wall's clock: where it runs Python on the main thread it is
    interrupted then, anything else in this process is waited for.
    """
    one, hand, tcp = addressed(avoider, hand_position_in_base_m, tcp_position_in_base_m)
    if isinstance(one, OutOfProcessAvoider):
        return one.answers([Question(hand, tcp, seed, limit_s)], together=False)[0]
    begun_s = time.perf_counter()
    with interrupted_after(limit_s, avoider.name):
        answer = _ask(avoider, hand_position_in_base_m.copy(), tcp_position_in_base_m.copy(), seed)
    return replace(answer, latency_s=time.perf_counter() - begun_s)


def addressed(avoider: Avoider, hand: Vector, tcp: Vector) -> tuple[Avoider, Vector, Vector]:
    """Who is asked, and of which hand and TCP, where a fault has the answer to an earlier question count.

    ``hand`` and ``tcp`` (3,).
    """
    if isinstance(avoider, DelayedQuery):
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
    except NoAnswerError:  # of an avoider that it asks
        raise
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
def interrupted_after(limit_s: float, name: str) -> Iterator[None]:
    """NoAnswerError if what is within takes longer: at once where a timer signal can be had, or after it."""
    begun_s = time.perf_counter()
    free = threading.current_thread() is threading.main_thread() and hasattr(signal, "setitimer")
    timed = free and np.isfinite(limit_s) and signal.getitimer(signal.ITIMER_REAL)[0] == 0.0

    def interrupt(number: int, frame: FrameType | None) -> None:
        raise _Hangs

    before = signal.signal(signal.SIGALRM, interrupt) if timed else None
    try:
        if timed:
            signal.setitimer(signal.ITIMER_REAL, limit_s)
        yield
    except _Hangs:
        raise NoAnswerError(name, limit_s) from None
    finally:
        if timed:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            signal.signal(signal.SIGALRM, before)
    if time.perf_counter() - begun_s > limit_s:
        raise NoAnswerError(name, limit_s)
