"""One file of a user's and the process in which its avoiders are made; begun anew when it is gone."""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache, partial
from itertools import count
from pathlib import Path

from safety_harness.cell.avoidance.asking import Answer, Question, limit_of
from safety_harness.cell.avoidance.isolation.messages import (
    MOST_ANSWER_BYTES,
    Answered,
    Ask,
    from_the_child,
)
from safety_harness.seams.isolation.channel import NonsenseError
from safety_harness.seams.isolation.connection import Connection, binary_wire, process_of
from safety_harness.seams.isolation.messages import Drop, ProcessMessage
from safety_harness.seams.isolation.process import Process

SEND_S = 10.0
KEPT = 2  # processes that are kept though no avoider lives in them
LOGGER = logging.getLogger("safety_harness.avoider")
CHILD = "safety_harness.cell.avoidance.isolation.child"


class Host(Connection):
    """The connection to the process of a file.  Of a ``silent`` one nobody hears what the file writes."""

    def __init__(self, path: Path, source: bytes, *, silent: bool = False) -> None:
        start = process_of(path, source, LOGGER, partial(Process.python, CHILD), silent=silent)
        super().__init__(start, binary_wire(from_the_child.decode, MOST_ANSWER_BYTES))
        self.lock = threading.RLock()
        self.numbers = count(1)  # of avoiders
        self._dropped: deque[int] = deque()

    def ask(self, number: int, questions: list[Question], *, together: bool) -> Iterator[Answer]:
        """The answers as they come, as they were sent; GoneError at the one that does not."""
        self.say(Ask.of(number, questions, together), SEND_S)
        for k, question in enumerate(questions):
            said = self.hear(limit_of(questions) if together else question.limit_s)
            if not isinstance(said, Answered) or said.number != k:
                raise NonsenseError
            yield said.answer

    def drop(self, number: int) -> None:
        """Forget an avoider, before the next thing is said: this may be called amid another message."""
        self._dropped.append(number)

    def say(self, message: ProcessMessage, limit_s: float) -> None:
        """As of any connection, after what was dropped."""
        while self._dropped:
            super().say(Drop(self._dropped.popleft()), SEND_S)
        super().say(message, limit_s)


_hosts = [lru_cache(KEPT)(Host)]  # the last are those in use


@contextmanager
def processes_apart() -> Iterator[None]:
    """Avoiders made within share no process, and no memory, with those made before; nobody hears them."""
    _hosts.append(lru_cache(KEPT)(partial(Host, silent=True)))
    try:
        yield
    finally:
        _hosts.pop()


def host_of(path: Path, source: bytes) -> Host:
    """The one for this text of this file.

    A few stay ready though nobody uses them; the process of another ends when its last avoider is gone.
    """
    return _hosts[-1](path, source)
