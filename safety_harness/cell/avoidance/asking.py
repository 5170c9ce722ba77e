"""Questions to an avoider, one or many in a call: the result is an answer, or a fault in words.

The cost of a decision in simulated time is a declaration (``decision_times``). The harness also measures the
time of an answer on the wall's clock. It has no effect, unless the answer never comes: that ends the run.
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
EACH_S = 1.0  # the additional time for each of many questions
NAN_PROPOSAL = Proposal(np.full(3, np.nan), np.full(3, np.nan))


@dataclass(frozen=True, eq=False)
class Answer:
    """An avoider's proposal with the largest allowed spread, or the reason for its absence.

    ``latency_s`` is its wall-clock time. ``late``: it comes after the decision deadline in simulated time, so
    the harness does not call the avoider.
    """

    proposal: Proposal = field(default=NAN_PROPOSAL)
    spread_threshold_m: float = np.nan
    fault: str = ""
    late: bool = False
    latency_s: float = 0.0


class Question(NamedTuple):
    """A question, with the wall-clock limit of its answer. Positions are (3,).

    ``seen`` is for an avoider that sees more; None outside of a run.
    """

    hand_position_in_base_m: Vector
    tcp_position_in_base_m: Vector
    seed: int
    limit_s: float = WALL_LIMIT_S
    seen: Seen | None = None


class OutOfProcessAvoider(ABC):
    """An avoider in another process, which applies the wall limit itself."""

    takes_many: bool  # in one call

    @abstractmethod
    def answers(self, questions: Sequence[Question], *, together: bool) -> list[Answer]:
        """Return an answer for each question, in one call if ``together`` and the avoider takes many.

        ``NoAnswerError``; ``SimulationError`` if the process is lost and a new one does not start.
        """


class _Hangs(BaseException):
    """An interruption of an avoider at the wall limit; not an Exception, which the avoider might catch."""


def ask(avoider: Avoider, question: Question) -> Answer:
    """Return an avoider's answer; anything that it raises becomes a fault in words.

    Only the interpreter's own exits pass. ``NoAnswerError`` if the answer takes longer than the question's
    limit on the wall's clock. The harness interrupts Python on the main thread at the limit. It waits for
    anything else in this process.
    """
    if isinstance(avoider, OutOfProcessAvoider):
        return avoider.answers([question], together=False)[0]
    begun_s = time.perf_counter()
    with interrupted_after(question.limit_s, avoider.name):
        answer = _ask(avoider, question)
    return replace(answer, latency_s=time.perf_counter() - begun_s)


def late_fault(deadline_s: float) -> str:
    """Return the recorded text of a decision without an answer in time."""
    return f"no answer within {deadline_s * 1e3:g} ms"


def _ask(avoider: Avoider, question: Question) -> Answer:
    """Call the avoider, and return its answer or its fault."""
    try:
        threshold_m = spread_threshold_of(avoider)
        proposal = avoider.propose(
            hand_position_in_base_m=question.hand_position_in_base_m.copy(),
            tcp_position_in_base_m=question.tcp_position_in_base_m.copy(),
            seed=question.seed,
            **_more(avoider, question),
        )
        return answer_of(proposal, threshold_m)
    except NoAnswerError:  # of another avoider that it calls
        raise
    except AvoiderError as error:
        return Answer(fault=printable(str(error)) or "AvoiderError")
    except Exception as error:  # a user's code may raise anything
        frames = traceback.extract_tb(error.__traceback__, limit=2)  # this function, then the avoider's
        return Answer(fault=described(error, frames[1].filename if len(frames) > 1 else None))


def _more(avoider: Avoider, question: Question) -> dict[str, Any]:
    """Return the fourth keyword of an avoider that sees more."""
    sees = shown_to(avoider)
    if sees and question.seen is None:
        raise AvoiderError(f"it sees {', '.join(sees)}, which no question outside of a run has")
    return {"seen": question.seen} if sees else {}


def answer_of(proposal: object, threshold_m: float | None) -> Answer:
    """Check an avoider's result; return a fault in words if it is no proposal."""
    try:
        return Answer(checked(proposal), np.nan if threshold_m is None else threshold_m)
    except AvoiderError as error:
        return Answer(fault=str(error))


@contextmanager
def interrupted_after(limit_s: float, name: str) -> Iterator[None]:
    """Raise ``NoAnswerError`` if the block takes longer than ``limit_s``.

    This happens at once if a timer signal is free, otherwise after the block.
    """
    begun_s = time.perf_counter()
    free = threading.current_thread() is threading.main_thread() and hasattr(signal, "setitimer")
    timed = free and np.isfinite(limit_s) and signal.getitimer(signal.ITIMER_REAL)[0] == 0.0

    def interrupt(number: int, frame: FrameType | None) -> None:
        raise _Hangs

    handler = signal.signal(signal.SIGALRM, interrupt) if timed else None
    try:
        if timed:
            signal.setitimer(signal.ITIMER_REAL, limit_s)
        yield
    except _Hangs:
        raise NoAnswerError(name, limit_s) from None
    finally:
        if timed:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            signal.signal(signal.SIGALRM, handler)
    if time.perf_counter() - begun_s > limit_s:
        raise NoAnswerError(name, limit_s)


class BatchAvoider(Avoider, Protocol):
    """An avoider that answers many questions in one call, each with the bits of ``propose``."""

    def propose_many(
        self, hands_in_base_m: Vectors, tcps_in_base_m: Vectors, seeds: NDArray[np.uint64]
    ) -> tuple[Vectors, Vectors]:
        """Return positions and spreads (n, 3) [m] for n questions.

        Args:
            hands_in_base_m: The hands (n, 3).
            tcps_in_base_m: The TCPs (n, 3).
            seeds: The seeds (n,).

        """
        ...


def takes_many(avoider: Avoider) -> TypeGuard[BatchAvoider]:
    """Return whether the avoider takes many questions in a call; an avoider that sees more does not."""
    return callable(getattr(avoider, "propose_many", None)) and not getattr(avoider, "sees", None)


def limit_of(questions: Sequence[Question]) -> float:
    """Return the wall-clock limit of a joint call; after it the questions go out in turn."""
    return max(question.limit_s for question in questions) + EACH_S * len(questions)


def answers_together(avoider: Avoider, questions: Sequence[Question]) -> list[Answer]:
    """Return the answers of a joint call; an empty list if the questions must go out in turn.

    They must if the avoider does not take many, raises, hangs, or does not return two arrays (n, 3). The
    calls in turn then show which question is at fault.
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
