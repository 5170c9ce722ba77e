"""Asking an avoider, once or many times in one call: an answer or a fault in words comes back.

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
from typing import Any, NamedTuple, Protocol, TypeGuard

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.exceptions import AvoiderError, NoAnswerError, described, printable
from safety_harness.base.settings import DEFAULTS
from safety_harness.cell.avoidance.avoider import (
    Avoider,
    Proposal,
    Vector,
    Vectors,
    checked,
    shown_to,
    spread_threshold_of,
)
from safety_harness.seams.contract import Seen

WALL_LIMIT_S = DEFAULTS.clock.wall_limit_s
EACH_S = 1.0  # the more that each of many questions may take
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
    """One question, and how long its answer is waited for on the wall's clock.  Positions are (3,).

    ``seen`` is for an avoider that sees more; None outside of a run.
    """

    hand_position_in_base_m: Vector
    tcp_position_in_base_m: Vector
    seed: int
    limit_s: float = WALL_LIMIT_S
    seen: Seen | None = None


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


def ask(avoider: Avoider, question: Question) -> Answer:
    """One avoider's answer.

    Whatever it raises becomes a fault in words; only the interpreter's own exits pass.  NoAnswerError if
    it takes longer than the question's limit on the wall's clock: where it runs Python on the main thread it
    is interrupted then, anything else in this process is waited for.
    """
    if isinstance(avoider, OutOfProcessAvoider):
        return avoider.answers([question], together=False)[0]
    begun_s = time.perf_counter()
    with interrupted_after(question.limit_s, avoider.name):
        answer = _ask(avoider, question)
    return replace(answer, latency_s=time.perf_counter() - begun_s)


def late_fault(deadline_s: float) -> str:
    """How a decision without an answer in time is recorded."""
    return f"no answer within {deadline_s * 1e3:g} ms"


def _ask(avoider: Avoider, question: Question) -> Answer:
    try:
        threshold_m = spread_threshold_of(avoider)
        proposal = avoider.propose(
            hand_position_in_base_m=question.hand_position_in_base_m.copy(),
            tcp_position_in_base_m=question.tcp_position_in_base_m.copy(),
            seed=question.seed,
            **_more(avoider, question),
        )
        return answer_of(proposal, threshold_m)
    except NoAnswerError:  # of an avoider that it asks
        raise
    except AvoiderError as error:
        return Answer(fault=printable(str(error)) or "AvoiderError")
    except Exception as error:  # a user's code may raise anything
        frames = traceback.extract_tb(error.__traceback__, limit=2)  # this function, then the avoider's
        return Answer(fault=described(error, frames[1].filename if len(frames) > 1 else None))


def _more(avoider: Avoider, question: Question) -> dict[str, Any]:
    """The fourth keyword of an avoider that sees more."""
    sees = shown_to(avoider)
    if sees and question.seen is None:
        raise AvoiderError(f"it sees {', '.join(sees)}, and is asked outside of a run, where nothing is seen")
    return {"seen": question.seen} if sees else {}


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


class BatchAvoider(Avoider, Protocol):
    """An avoider that answers many questions in one call, each with the bits that ``propose`` gives."""

    def propose_many(
        self, hands_in_base_m: Vectors, tcps_in_base_m: Vectors, seeds: NDArray[np.uint64]
    ) -> tuple[Vectors, Vectors]:
        """Positions and spreads (n, 3) [m] for hands (n, 3), TCPs (n, 3) and seeds (n,).  ``seeds`` (n,)."""
        ...


def takes_many(avoider: Avoider) -> TypeGuard[BatchAvoider]:
    """Can the avoider be asked many questions at once?  One that sees more is asked for each."""
    return callable(getattr(avoider, "propose_many", None)) and not getattr(avoider, "sees", None)


def limit_of(questions: Sequence[Question]) -> float:
    """How long the answers to questions asked together are waited for; then they are asked in turn."""
    return max(question.limit_s for question in questions) + EACH_S * len(questions)


def answers_together(avoider: Avoider, questions: Sequence[Question]) -> list[Answer]:
    """The answers to questions asked together; none where they have to be asked in turn.

    That is where the avoider does not take many, raises, hangs, or does not return two arrays (n, 3): whose
    fault it is shows then.
    """
    if isinstance(avoider, OutOfProcessAvoider):
        return avoider.answers(questions, together=True)
    if not takes_many(avoider):
        return []
    try:
        threshold_m = spread_threshold_of(avoider)
        with interrupted_after(limit_of(questions), avoider.name):
            positions, spreads = avoider.propose_many(
                np.array([question.hand_position_in_base_m for question in questions]),
                np.array([question.tcp_position_in_base_m for question in questions]),
                np.array([question.seed for question in questions], dtype=np.uint64),
            )
        if np.shape(positions) != (len(questions), 3) or np.shape(spreads) != (len(questions), 3):
            return []
        return [
            replace(answer_of(Proposal(position, spread), threshold_m), latency_s=np.nan)
            for position, spread in zip(positions, spreads, strict=True)
        ]
    except Exception:  # a user's code may raise anything
        return []
