"""Ask an avoider one or many questions in a call: each result is an answer, or the text of a fault.

A declaration states how much simulated time a decision costs (``decision_times``). The harness also measures
how long an answer takes on the wall's clock. This measured time has no effect on the run, unless the answer
never comes: then the run ends.
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
EACH_S = 1.0  # the additional wall-clock time for each question of a joint call
NAN_PROPOSAL = Proposal(np.full(3, np.nan), np.full(3, np.nan))


@dataclass(frozen=True, eq=False)
class Answer:
    """An avoider's proposal with the largest allowed spread, or the reason for its absence.

    ``latency_s`` is the wall-clock time that the answer took. ``late`` is true if the answer would come after
    the decision deadline in simulated time. The harness then does not call the avoider.
    """

    proposal: Proposal = field(default=NAN_PROPOSAL)
    spread_threshold_m: float = np.nan
    fault: str = ""
    late: bool = False
    latency_s: float = 0.0


class Question(NamedTuple):
    """A question with the wall-clock limit ``limit_s`` [s] of its answer; positions are (3,).

    ``seen`` is for an avoider whose ``sees`` asks for more quantities; it is None outside of a run.
    """

    hand_position_in_base_m: Vector
    tcp_position_in_base_m: Vector
    seed: int
    limit_s: float = WALL_LIMIT_S
    seen: Seen | None = None


class OutOfProcessAvoider(ABC):
    """An avoider in another process; this class itself limits the wall-clock time of its answers."""

    takes_many: bool  # in one call

    @abstractmethod
    def answers(self, questions: Sequence[Question], *, together: bool) -> list[Answer]:
        """Return an answer to each question; ask in one call if ``together`` and the avoider takes many.

        Raise ``NoAnswerError`` if no answer comes in time. Raise ``SimulationError`` if the process is lost
        and no new process starts.
        """


class _Hangs(BaseException):
    """The interruption of an avoider at the wall limit; no Exception, since an avoider might catch that."""


def ask(avoider: Avoider, question: Question) -> Answer:
    """Return an avoider's answer; if the avoider raises an exception, the answer states it as a fault.

    Only the interpreter's own exits pass through. Raise ``NoAnswerError`` if the answer takes longer than the
    question's limit on the wall's clock. At the limit the harness interrupts Python code on the main thread.
    For any other code in this process, the harness waits until it returns.
    """
    if isinstance(avoider, OutOfProcessAvoider):
        return avoider.answers([question], together=False)[0]
    begun_s = time.perf_counter()
    with interrupted_after(question.limit_s, avoider.name):
        answer = _ask(avoider, question)
    return replace(answer, latency_s=time.perf_counter() - begun_s)


def late_fault(deadline_s: float) -> str:
    """Return the fault's text for a decision whose answer does not come within ``deadline_s``."""
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
    """Return the keyword ``seen`` of ``propose`` for an avoider with ``sees``; otherwise no keyword."""
    sees = shown_to(avoider)
    if sees and question.seen is None:
        raise AvoiderError(f"it sees {', '.join(sees)}, which no question outside of a run has")
    return {"seen": question.seen} if sees else {}


def answer_of(proposal: object, threshold_m: float | None) -> Answer:
    """Return the answer with an avoider's ``proposal``, or with a fault if the proposal is invalid."""
    try:
        return Answer(checked(proposal), np.nan if threshold_m is None else threshold_m)
    except AvoiderError as error:
        return Answer(fault=str(error))


@contextmanager
def interrupted_after(limit_s: float, name: str) -> Iterator[None]:
    """Raise ``NoAnswerError`` if the block takes longer than ``limit_s``.

    If a timer signal is free, the error comes at the limit; otherwise it comes after the block.
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
    """An avoider that answers many questions in one call, each bit for bit as ``propose`` does."""

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
    """Return whether the avoider takes many questions in a call; an avoider with ``sees`` never does."""
    return callable(getattr(avoider, "propose_many", None)) and not getattr(avoider, "sees", None)


def limit_of(questions: Sequence[Question]) -> float:
    """Return the wall-clock limit [s] of a joint call for ``questions``; after it, each gets its own call."""
    return max(question.limit_s for question in questions) + EACH_S * len(questions)


def answers_together(avoider: Avoider, questions: Sequence[Question]) -> list[Answer]:
    """Return the answers of a joint call for ``questions``; an empty list if each needs its own call.

    The list is empty if the avoider does not take many, raises, hangs, or does not return two arrays (n, 3).
    The separate calls then show which question is at fault.
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
