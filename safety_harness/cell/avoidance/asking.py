"""Ask an avoider one or several questions in one call.

The result for each question is an answer or, if the avoider failed, the text of the fault. A decision costs
the simulated time that a declaration states (``decision_times``). The harness also measures the wall-clock
time of each answer. This time affects the run only if the answer never comes. The run then ends.
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
    """The answer of an avoider: a proposal, or a fault that explains why there is no proposal.

    ``spread_threshold_m`` is the largest spread at which the proposal is usable, or NaN without such a limit.
    ``latency_s`` is the wall-clock time that the answer took. ``late`` is true if the answer would come after
    the decision deadline in simulated time. The harness then does not call the avoider.
    """

    proposal: Proposal = field(default=NAN_PROPOSAL)
    spread_threshold_m: float = np.nan
    fault: str = ""
    late: bool = False
    latency_s: float = 0.0


class Question(NamedTuple):
    """A question to an avoider: the positions of hand and TCP, each (3,), and a seed.

    ``limit_s`` is the limit [s] of the wall-clock time for the answer. ``seen`` contains the additional
    quantities that the avoider's attribute ``sees`` requests. ``seen`` is None outside of a run.
    """

    hand_position_in_base_m: Vector
    tcp_position_in_base_m: Vector
    seed: int
    limit_s: float = WALL_LIMIT_S
    seen: Seen | None = None


class OutOfProcessAvoider(ABC):
    """An avoider in another process.

    The class itself enforces the wall-clock limit of each answer.
    """

    takes_many: bool  # in one call

    @abstractmethod
    def answers(self, questions: Sequence[Question], *, together: bool) -> list[Answer]:
        """Return an answer to each question.

        If ``together`` is True and the avoider can answer many questions in one call, the method uses one
        batched call. Raise ``NoAnswerError`` if no answer comes in time. Raise ``SimulationError`` if the
        process is lost and no new process starts.
        """


class _Hangs(BaseException):
    """The exception that interrupts an avoider at the wall-clock limit.

    The exception is not derived from ``Exception``, because an avoider might catch that class.
    """


def ask(avoider: Avoider, question: Question) -> Answer:
    """Return an avoider's answer, which contains the fault if the avoider raises an exception.

    The function does not catch exceptions that are not derived from ``Exception``, such as
    ``KeyboardInterrupt``. Raise ``NoAnswerError`` if the answer takes longer than the question's wall-clock
    limit. At the limit the harness interrupts Python code on the main thread. For any other code in this
    process, the harness waits until the code returns.
    """
    if isinstance(avoider, OutOfProcessAvoider):
        return avoider.answers([question], together=False)[0]
    begun_s = time.perf_counter()
    with interrupted_after(question.limit_s, avoider.name):
        answer = _ask(avoider, question)
    return replace(answer, latency_s=time.perf_counter() - begun_s)


def late_fault(deadline_s: float) -> str:
    """Return the text of the fault for an answer that does not arrive within ``deadline_s``."""
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
    """Return the additional keyword arguments of ``propose``.

    These arguments contain ``seen`` if the avoider has the attribute ``sees``. Otherwise the result is empty.
    """
    sees = shown_to(avoider)
    if sees and question.seen is None:
        raise AvoiderError(f"it sees {', '.join(sees)}, which no question outside of a run has")
    return {"seen": question.seen} if sees else {}


def answer_of(proposal: object, threshold_m: float | None) -> Answer:
    """Return an answer with the valid ``proposal``, or with a fault if the proposal is invalid."""
    try:
        return Answer(checked(proposal), np.nan if threshold_m is None else threshold_m)
    except AvoiderError as error:
        return Answer(fault=str(error))


@contextmanager
def interrupted_after(limit_s: float, name: str) -> Iterator[None]:
    """Raise ``NoAnswerError`` if the block takes longer than ``limit_s``.

    If a timer signal is available, the error interrupts the block at the limit. Otherwise the function raises
    the error after the block.
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
    """An avoider that can also answer many questions in one call.

    Each answer equals the answer of ``propose`` bit for bit.
    """

    def propose_many(
        self, hands_in_base_m: Vectors, tcps_in_base_m: Vectors, seeds: NDArray[np.uint64]
    ) -> tuple[Vectors, Vectors]:
        """Return the positions and the spreads for n questions, both (n, 3) [m].

        Args:
            hands_in_base_m: The positions of the hands (n, 3).
            tcps_in_base_m: The positions of the TCP (n, 3).
            seeds: The seeds (n,).

        """
        ...


def takes_many(avoider: Avoider) -> TypeGuard[BatchAvoider]:
    """Return whether the avoider can answer many questions in one call.

    An avoider with the attribute ``sees`` can answer only one question in a call.
    """
    return callable(getattr(avoider, "propose_many", None)) and not getattr(avoider, "sees", None)


def limit_of(questions: Sequence[Question]) -> float:
    """Return the wall-clock limit [s] of one batched call for ``questions``.

    If the call takes longer, the harness asks each question in a separate call.
    """
    return max(question.limit_s for question in questions) + EACH_S * len(questions)


def answers_together(avoider: Avoider, questions: Sequence[Question]) -> list[Answer]:
    """Return the answers to ``questions`` from one batched call, or an empty list if the call fails.

    The list is also empty if the avoider cannot answer many questions in one call. The call fails if the
    avoider raises an exception, takes too long, or does not return two arrays of shape (n, 3). Separate calls
    can then show which question causes the failure.
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
