"""Run an avoider of a user's file in its own process, so that the harness survives the avoider's failures.

An avoider with a memory keeps this memory as long as its process lives. If the avoider does not answer within
the wall-clock limit, the harness kills its process with all its forks, and the run ends. If the process ends
by itself, the harness records a fault of the decision. The next question then goes to a new process, which
creates the avoider again from the same text.
"""

from __future__ import annotations

import logging
import time
import weakref
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path

import numpy as np

from safety_harness.base.exceptions import (
    AvoiderError,
    InadmissibleError,
    ModelError,
    NoAnswerError,
    Place,
    SimulationError,
    printable,
)
from safety_harness.base.extras import ONNX
from safety_harness.base.settings import Settings
from safety_harness.cell.avoidance.asking import (
    WALL_LIMIT_S,
    Answer,
    OutOfProcessAvoider,
    Question,
    answer_of,
    limit_of,
)
from safety_harness.cell.avoidance.avoider import Proposal, Vector
from safety_harness.cell.avoidance.isolation.apart import CONTEXTS
from safety_harness.cell.avoidance.isolation.messages import (
    MOST_ANSWER_BYTES,
    Answered,
    Ask,
    Made,
    from_the_child,
)
from safety_harness.cell.avoidance.model_file import onnx_bytes
from safety_harness.scenario.fields import is_sentence
from safety_harness.seams.contract import Seen
from safety_harness.seams.isolation.channel import GoneError, NonsenseError
from safety_harness.seams.isolation.connection import (
    Connection,
    RefusedError,
    binary_wire,
    process_of,
    refusing,
)
from safety_harness.seams.isolation.messages import Make
from safety_harness.seams.isolation.process import Process
from safety_harness.seams.isolation.python_file import source_of

# A choice: a process that does not read its pipe for so long counts as gone.
SEND_S = 10.0
KEPT = 2  # processes that stay ready while they serve no avoider
LOGGER = logging.getLogger("safety_harness.avoider")
CHILD = "safety_harness.cell.avoidance.isolation.child"
ATTEMPTS = 3  # attempts to make an avoider anew, one after another
PROGRAM_S = 300.0  # for the import and the first answer of a Python file
ONNX_S = 60.0  # to load an ONNX file and answer twice: the runtime computes constant parts on loading


class IsolatedAvoider(OutOfProcessAvoider):
    """An avoider that runs in the process of its file."""

    def __init__(self, connection: Connection, make: Callable[[int], Make], within_s: float) -> None:
        """Create the avoider in its process.

        Raise ``RefusedError`` if the process refuses the avoider, or ``GoneError`` if the process dies first.
        """
        self._number = next(connection.numbers)
        with connection.lock:
            made = connection.introduce(make(self._number), Made, within_s)
            self._generation = connection.generation
        if not is_sentence(made.name):
            raise NonsenseError
        self.name = made.name
        self.spread_threshold_m = made.spread_threshold_m
        self.decision_time_s = made.decision_time_s
        self.takes_many = made.takes_many
        self.sees = made.sees
        self._connection, self._make, self._within_s = connection, make, within_s
        self._asked = False
        self._rehearsal: Question | None = None  # its first question, if its process survived that question
        weakref.finalize(self, connection.forget, self._number).atexit = False

    def propose(
        self,
        *,
        hand_position_in_base_m: Vector,
        tcp_position_in_base_m: Vector,
        seed: int,
        seen: Seen | None = None,
    ) -> Proposal:
        """Return the avoider's proposal.

        Raise ``AvoiderError`` with the text of the fault if there is no proposal.
        """
        question = Question(hand_position_in_base_m, tcp_position_in_base_m, seed, WALL_LIMIT_S, seen)
        answer = self.answers([question], together=False)[0]
        if answer.fault:
            raise AvoiderError(answer.fault)
        return answer.proposal

    def answers(self, questions: Sequence[Question], *, together: bool) -> list[Answer]:
        """Return an answer to each question, as ``OutOfProcessAvoider`` describes.

        If a batched call does not return all answers, the method sends the remaining questions one by one.
        """
        received: list[Answer] = []
        with self._connection.lock:
            together = together and self.takes_many
            survived = True
            while len(received) < len(questions):
                rest = list(questions[len(received) :])
                begun_s = time.perf_counter()
                try:
                    self._be_there()
                    for answer in self._answered(rest, together=together):
                        received.append(_looked_at(answer))
                        begun_s = time.perf_counter()
                except GoneError as gone:
                    self._connection.end()
                    survived = False
                    if not together and gone.hung:
                        raise NoAnswerError(self.name, rest[0].limit_s) from None
                    if not together:
                        received.append(Answer(fault=str(gone), latency_s=time.perf_counter() - begun_s))
                    together = False
                except BaseException:  # Ctrl-C: a late answer would pass for that of the next question
                    self._connection.end()
                    raise
            if not self._asked:
                self._asked = True
                self._rehearsal = questions[0] if survived else None
        return received

    def _answered(self, questions: list[Question], *, together: bool) -> Iterator[Answer]:
        """Yield the unchecked answers as they arrive.

        Raise ``GoneError`` if an answer does not arrive.
        """
        self._connection.say(Ask.from_questions(self._number, questions, together), SEND_S)
        for k, question in enumerate(questions):
            message = self._connection.hear(limit_of(questions) if together else question.limit_s)
            if not isinstance(message, Answered) or message.number != k:
                raise NonsenseError
            yield message.answer

    def _be_there(self) -> None:
        """Create the avoider again if its process has ended, and then repeat its first question.

        So the start of a process is not part of a decision's time.
        """
        if self._connection.alive and self._generation == self._connection.generation:
            return
        why = ""
        for _ in range(ATTEMPTS):
            try:
                self._connection.introduce(self._make(self._number), Made, self._within_s)
                self._generation = self._connection.generation
                if self._rehearsal is not None:
                    again = self._rehearsal._replace(limit_s=self._within_s)
                    list(self._answered([again], together=False))
                return
            except RefusedError as error:
                why = str(error)
                break
            except GoneError as error:
                why, self._rehearsal = str(error), None
                self._connection.end()
        raise SimulationError(f"the avoider {self.name!r} could not start again: {why}")


def _looked_at(answer: Answer) -> Answer:
    """Check an answer from the other process as strictly as an answer from this process."""
    latency_s = answer.latency_s if answer.latency_s >= 0.0 else np.nan
    if answer.fault:
        return Answer(fault=printable(answer.fault), latency_s=latency_s)
    threshold_m = answer.spread_threshold_m
    if not (np.isnan(threshold_m) or 0.0 <= threshold_m < np.inf):
        return Answer(fault=f"spread_threshold_m must be a length; got {threshold_m}", latency_s=latency_s)
    return replace(answer_of(answer.proposal, threshold_m), latency_s=latency_s)


def _connected(path: Path, source: bytes, *, silent: bool = False) -> Connection:
    """Return a connection to a new process for a file."""
    start = process_of(path, source, LOGGER, partial(Process.python, CHILD), silent=silent)
    return Connection(start, binary_wire(from_the_child.decode, MOST_ANSWER_BYTES))


# The key is the file and its text.  A cache holds KEPT connections; the process of any other connection ends
# with its last avoider.
_connection = lru_cache(KEPT)(_connected)


def _connection_to(path: Path, source: bytes) -> Connection:
    """Return a connection to the process of a file, which a context of ``processes_apart`` does not share."""
    if not CONTEXTS:
        return _connection(path, source)
    silent = CONTEXTS[-1].setdefault("connection", lru_cache(KEPT)(partial(_connected, silent=True)))
    connection: Connection = silent(path, source)
    return connection


def isolated_avoider(path: Path, name: str, place: Place) -> IsolatedAvoider:
    """Return an avoider of a Python file, which runs in another process.

    Args:
        path: The file.
        name: The avoider's name in the file.
        place: The place that an error states.

    Raises:
        InadmissibleError: There is no such avoider, or the process dies before it replies.

    """
    source, expected = source_of(path, place), f"{path.name} to give an avoider {name}"
    make = partial(Make.from_file, path, source, name)
    with refusing(InadmissibleError, expected, PROGRAM_S, place):
        return IsolatedAvoider(_connection_to(path, source), make, PROGRAM_S)


def isolated_onnx(path: Path, settings: Settings, layout: str = "") -> IsolatedAvoider:
    """Return the avoider of an ONNX file, which runs in another process.

    The file may loop or fill the memory.

    Args:
        path: The file.
        settings: The settings. Their desired TCP and their nominal hand are the data of a first question to
            the avoider.
        layout: The layout, which states the quantities in each input or output that does not have a name of
            the harness (``onnx_names``).

    Raises:
        ModelError: The file cannot be used.
        MissingPackageError: onnxruntime is not installed.

    """
    ONNX.require(f"the avoider {path.name}")
    source, expected = onnx_bytes(path), "an ONNX file that can be loaded and answers twice"
    hand = settings.avoidance.nominal_hand_position_in_base_m
    tcp = settings.cell.desired_tcp_position_in_base_m
    make = partial(Make.from_file, path, source, layout, onnx=True, hand=hand, tcp=tcp)
    with refusing(ModelError, expected, ONNX_S, None, path):
        return IsolatedAvoider(_connection_to(path, source), make, ONNX_S)
