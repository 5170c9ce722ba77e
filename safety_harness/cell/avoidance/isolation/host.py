"""One file of a user's and the process in which its avoiders are made; begun anew when it is gone."""

from __future__ import annotations

import hashlib
import json
import logging
import os
import sys
import threading
from collections import OrderedDict, deque
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import count
from pathlib import Path

from msgspec import Struct

from safety_harness.base.exceptions import printable
from safety_harness.cell.avoidance.asking import Answer, Question, limit_of
from safety_harness.cell.avoidance.isolation.frames import (
    MOST_ANSWER_BYTES,
    Answered,
    Ask,
    Drop,
    Made,
    Make,
    Refused,
    Said,
    from_the_child,
    packed,
)
from safety_harness.scenario.fields import is_sentence
from safety_harness.seams.isolation.channel import Channel, GoneError, NonsenseError
from safety_harness.seams.isolation.frames import framed
from safety_harness.seams.isolation.process import Process
from safety_harness.seams.isolation.telling import Heard, say_it_is_executed

SEND_S = 10.0
KEPT = 2  # processes that are kept though no avoider lives in them
LOGGER = logging.getLogger("safety_harness.avoider")


@dataclass(frozen=True)
class Wanted:
    """Which avoider of a file, in the words that its process takes, and how long that may take."""

    words: Mapping[str, object]
    within_s: float


class RefusedError(Exception):
    """The file gives no avoider: what was expected, what came, where to read on, and in which field."""

    def __init__(self, said: Refused) -> None:
        words = (said.expected, said.got, said.hint, said.field)
        self.expected, self.got, self.hint, self.field = map(printable, words)
        super().__init__(f"expected {self.expected}; got {self.got}")


class Host:
    """``generation`` counts the processes; what was made in an earlier one is no more.

    Of a ``silent`` one nobody hears what the file writes.
    """

    def __init__(self, path: Path, source: bytes, *, silent: bool = False) -> None:
        self.path = path
        self.lock = threading.RLock()
        self.numbers = count(1)  # of avoiders
        self.generation = 0
        self._source = source
        self._process: Process | None = None
        self._dropped: deque[int] = deque()
        self._heard = Heard(path.name, LOGGER, silent=silent)

    @property
    def alive(self) -> bool:
        """Is there a process, and is it ours?"""
        if self._process is not None and self._process.owner != os.getpid():
            self._process = None  # of the process that we were forked from: it talks to it alone
        return self._process is not None

    def make(self, number: int, wanted: Wanted) -> Made:
        """An avoider of the file; RefusedError, GoneError."""
        if not self.alive:
            say_it_is_executed(self.path, self._source, LOGGER)
            try:
                self._process = Process.python("safety_harness.cell.avoidance.isolation.child", self._hear)
            except OSError as error:
                raise GoneError(f"no process could be started: {error}") from error
            self.generation += 1
        asked = {"path": str(self.path), "folder": os.getcwd(), "sys_path": sys.path, **wanted.words}
        channel = self._told(Make(number, json.dumps(asked).encode(), self._source))
        said = _received(channel, wanted.within_s)
        if isinstance(said, Refused):
            raise RefusedError(said)
        if not isinstance(said, Made) or not is_sentence(said.name):
            raise NonsenseError
        return said

    def ask(self, number: int, questions: list[Question], *, together: bool) -> Iterator[Answer]:
        """The answers as they come, as they were sent; GoneError at the one that does not."""
        channel = self._told(Ask.of(number, questions, together))
        for k, question in enumerate(questions):
            said = _received(channel, limit_of(questions) if together else question.limit_s)
            if not isinstance(said, Answered) or said.number != k:
                raise NonsenseError
            yield said.answer

    def drop(self, number: int) -> None:
        """Forget an avoider, before the next thing is asked: this may be called amid another message."""
        self._dropped.append(number)

    def end(self) -> None:
        """End the process, and all that was made in it."""
        if self._process is not None:
            self._process.end()
            self._process = None

    def _told(self, message: Struct) -> Channel:
        assert self._process is not None
        channel = self._process.channel
        while self._dropped:
            channel.send(framed(packed(Drop(self._dropped.popleft()))), SEND_S)
        channel.send(framed(packed(message)), SEND_S)
        return channel

    def _hear(self, written: bytes) -> None:
        """Not again what a new process repeats."""
        if self.generation <= 1:
            self._heard.hear(written)


def _received(channel: Channel, limit_s: float) -> Said:
    """What is said next; GoneError if that is nothing within the limit, or another kind of thing."""
    try:
        return from_the_child.decode(channel.frame(limit_s, MOST_ANSWER_BYTES))
    except (ValueError, RecursionError):
        raise NonsenseError from None


_Hosts = OrderedDict[tuple[Path, str], Host]
_shared: _Hosts = OrderedDict()
_hosts: list[_Hosts] = [_shared]  # the last are those in use


@contextmanager
def processes_apart() -> Iterator[None]:
    """Avoiders made within share no process, and no memory, with those made before; nobody hears them."""
    _hosts.append(OrderedDict())
    try:
        yield
    finally:
        _hosts.pop()


def host_of(path: Path, source: bytes) -> Host:
    """The one for this text of this file; a few stay ready though nobody uses them at the moment."""
    key, hosts = (path, hashlib.sha256(source).hexdigest()), _hosts[-1]
    if key not in hosts:
        hosts[key] = Host(path, source, silent=hosts is not _shared)
    hosts.move_to_end(key)
    while len(hosts) > KEPT:
        hosts.popitem(last=False)  # its process ends when its last avoider is gone
    return hosts[key]
