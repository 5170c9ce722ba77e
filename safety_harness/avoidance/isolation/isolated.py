"""An avoider of a user's file, asked in a process of its own: whatever it does there, we go on.

It keeps its memory, if it has one, as long as its process lives.  What does not answer within the grace
after its deadline is killed with all that it forked; that decision is a fault which says so, and the next
question goes to a new process, in which the avoider is made anew from the same text.
"""

from __future__ import annotations

import signal
import threading
import time
import weakref
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from safety_harness.avoidance.asking import Answer, Elsewhere, Question, answer_of, late_fault
from safety_harness.avoidance.avoider import Proposal, Vector
from safety_harness.avoidance.isolation.host import (
    GRACE_S,
    UNTIMED_S,
    Host,
    Made,
    RefusedError,
    Wanted,
)
from safety_harness.avoidance.isolation.process import GoneError
from safety_harness.exceptions import AvoiderError, SimulationError

ATTEMPTS = 3  # to make it anew, one after another


class IsolatedAvoider(Elsewhere):
    """One avoider in the process of its file."""

    @classmethod
    def of(cls, host: Host, wanted: Wanted) -> IsolatedAvoider:
        """Make it there; RefusedError, or GoneError if the process does not live to say so."""
        number = host.number()
        with host.lock:
            return cls(host, number, wanted, _first_made(host, number, wanted))

    def __init__(self, host: Host, number: int, wanted: Wanted, made: Made) -> None:
        self.name = made.name
        self.spread_threshold_m = made.spread_threshold_m
        self.takes_many = made.takes_many
        self.seen = made.seen
        self._host = host
        self._number = number
        self._wanted = wanted
        self._generation = host.generation
        self._asked = False
        self._rehearsal: Question | None = None  # its first question, if it survived that
        weakref.finalize(self, host.drop, number).atexit = False

    def propose(
        self, *, hand_position_in_base_m: Vector, tcp_position_in_base_m: Vector, seed: int
    ) -> Proposal:
        """As any avoider; AvoiderError says what was wrong there.

        Within another's deadline (a wrapper of this one is asked) that deadline holds.
        """
        with _others_deadline() as deadline_s:
            question = Question(hand_position_in_base_m, tcp_position_in_base_m, seed, deadline_s, True)
            answer = self.answers([question], together=False)[0]
        if answer.fault:
            raise AvoiderError(answer.fault)
        return answer.proposal

    def answers(self, questions: Sequence[Question], *, together: bool) -> list[Answer]:
        """As ``Elsewhere`` has it.  What is asked together and not answered is asked in turn."""
        found: list[Answer] = []
        with self._host.lock:
            together = together and self.takes_many
            survived = True
            while len(found) < len(questions):
                rest = list(questions[len(found) :])
                begun_s = time.perf_counter()
                try:
                    self._be_there()
                    for answer in self._host.ask(self._number, rest, together=together):
                        found.append(_looked_at(answer))
                        begun_s = time.perf_counter()
                except GoneError as gone:
                    self._host.end()
                    survived = False
                    if not together:
                        answer = _gone(questions[len(found)], gone)
                        found.append(replace(answer, latency_s=time.perf_counter() - begun_s))
                    together = False
                except BaseException:  # Ctrl-C: its answer would be taken for that to the next question
                    self._host.end()
                    raise
            if not self._asked:
                self._asked = True
                self._rehearsal = questions[0] if survived else None
        return found

    def _be_there(self) -> None:
        """Made anew if need be, and asked its first question again, so that no decision pays for that."""
        if self._host.has(self._generation):
            return
        why = ""
        for _ in range(ATTEMPTS):
            try:
                self._host.make(self._number, self._wanted)
                self._generation = self._host.generation
                if self._rehearsal is not None:
                    again = self._rehearsal._replace(deadline_s=self._wanted.within_s, timed=True)
                    list(self._host.ask(self._number, [again], together=False))
                return
            except RefusedError as error:
                why = str(error)
                break
            except GoneError as error:
                why, self._rehearsal = str(error), None
                self._host.end()
        raise SimulationError(f"the avoider {self.name!r} could not be made once more: {why}")


def _first_made(host: Host, number: int, wanted: Wanted) -> Made:
    """Once more in a new process if that of earlier avoiders is gone."""
    for new in (not host.alive, True):
        try:
            return host.make(number, wanted)
        except RefusedError:
            raise
        except GoneError:
            host.end()
            if new:
                raise
        except BaseException:  # Ctrl-C: who knows what it will say next
            host.end()
            raise
    raise AssertionError


def _looked_at(answer: Answer) -> Answer:
    """What came from there, believed no more than what an avoider returns here."""
    latency_s = answer.latency_s if answer.latency_s >= 0.0 else np.nan
    if answer.late or answer.fault:
        return Answer(fault=answer.fault or "late", late=answer.late, latency_s=latency_s)
    threshold_m = answer.spread_threshold_m
    if not (np.isnan(threshold_m) or 0.0 <= threshold_m < np.inf):
        return Answer(fault=f"spread_threshold_m must be a length; got {threshold_m}", latency_s=latency_s)
    return replace(answer_of(answer.proposal, threshold_m), latency_s=latency_s)


def _gone(question: Question, gone: GoneError) -> Answer:
    """The fault of a question that the process did not survive."""
    if gone.hung and question.timed:
        late = late_fault(question.deadline_s)
        return Answer(fault=f"{late}, nor {GRACE_S:g} s later: its process was ended", late=True)
    never = f"no answer within {UNTIMED_S:g} s: its process was ended"
    return Answer(fault=never if gone.hung else str(gone))


@contextmanager
def _others_deadline() -> Iterator[float]:
    """Hold the timer of the one who asks, and yield what is left of it [s]."""
    timer = hasattr(signal, "setitimer") and threading.current_thread() is threading.main_thread()
    left_s = signal.setitimer(signal.ITIMER_REAL, 0.0)[0] if timer else 0.0
    begun_s = time.perf_counter()
    try:
        yield left_s or UNTIMED_S
    finally:
        if left_s:
            signal.setitimer(signal.ITIMER_REAL, max(left_s - (time.perf_counter() - begun_s), 1e-6))
