"""The process of a user's file: it makes objects of one kind, and answers calls to them one after another.

It keeps its limits and ends when the harness does.  It must start quickly: nothing imported here waits for a
compiler.
"""

from __future__ import annotations

import json
import os
import resource
import select
import signal
import sys
import threading
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import msgspec

from safety_harness.base.exceptions import ControllerError, InputError, described, printable
from safety_harness.seams.isolation.messages import (
    HEADER,
    MEMORY_BYTES,
    MOST_WORDS,
    Drop,
    Failed,
    Make,
    ProcessMessage,
    Refused,
    framed,
    length_of,
    packed,
)

MOST_TOLD = 1 << 30  # bytes of a message to it


class ServedKind(ABC):
    """Objects of one kind that a user's file gives, by number, and the calls that they answer."""

    what: str  # "an avoider"
    told: msgspec.msgpack.Decoder[Any]  # Make, Drop and the calls

    def __init__(self) -> None:
        self.made: dict[int, Any] = {}

    @abstractmethod
    def make(self, told: Make, path: Path, wanted: dict[str, Any]) -> ProcessMessage:
        """Make an object, and return what it says of itself.  Whatever this raises refuses the file."""

    @abstractmethod
    def answers(self, told: Any) -> Iterator[ProcessMessage]:
        """Yield what is to be said to a call.  Whatever this raises is said to have failed."""


def serve(kind: ServedKind, question_fd: int, answer_fd: int) -> None:
    """Answer until the other side is gone."""
    ends, file = _Ends(question_fd, answer_fd), ""
    while True:
        told = kind.told.decode(ends.read(MOST_TOLD))
        try:
            if isinstance(told, Make):
                wanted = json.loads(told.wanted)
                file = wanted["path"]
                ends.write(_made(kind, told, Path(file), wanted))
            elif isinstance(told, Drop):
                kind.made.pop(told.number, None)
            else:
                for said in kind.answers(told):
                    ends.write(said)
        except BaseException as error:  # SystemExit, or the user's own: no reason to end
            own = isinstance(error, ControllerError)
            words = str(error) if own else described(error, file)
            words = words if own and words.startswith(told.call) else f"{told.call} raised: {words}"
            ends.write(Failed(printable(words)[:MOST_WORDS]))


def _made(kind: ServedKind, told: Make, path: Path, wanted: dict[str, Any]) -> ProcessMessage:
    sys.path[:] = wanted["sys_path"]
    try:
        os.chdir(wanted["folder"])
        return kind.make(told, path, wanted)
    except InputError as error:
        words = error.expected, error.got, error.hint, error.place.field or ""
    except BaseException as error:  # a user's code may raise anything
        words = f"{wanted['name'] or path.name} to be {kind.what}", described(error, str(path)), "", ""
    return Refused(*map(printable, words))


class _Ends:
    """Where it reads what we say and writes what it says, in frames."""

    def __init__(self, question_fd: int, answer_fd: int) -> None:
        """The process keeps the limits from here on, and ends when we do."""
        limit()
        for fd in (question_fd, answer_fd):
            os.set_inheritable(fd, False)
        os.register_at_fork(after_in_child=lambda: _close(question_fd, answer_fd))
        threading.Thread(target=_end_with, args=(question_fd,), daemon=True).start()
        self._questions = open(question_fd, "rb", closefd=False)  # noqa: SIM115
        self._answered = open(answer_fd, "wb", closefd=False)  # noqa: SIM115
        self._process = os.getpid()

    def read(self, most: int) -> bytes:
        """The next message; the process ends when there will be none."""
        header = self._questions.read(HEADER.size)
        if not header:
            os._exit(0)  # the other side is gone
        return self._questions.read(length_of(header, most))

    def write(self, message: ProcessMessage) -> None:
        """Say it, after what the user's file has printed."""
        if os.getpid() != self._process:
            os._exit(0)  # a fork of the user's that came back from it
        for stream in (sys.stdout, sys.stderr):  # it may have closed its output
            with suppress(Exception):
                stream.flush()
        self._answered.write(framed(packed(message)))
        self._answered.flush()


def limit(process: int = 0) -> None:
    """Bound the data of a process, of this one for 0, to MEMORY_BYTES; it leaves no core behind."""
    for kind, most in ((resource.RLIMIT_DATA, MEMORY_BYTES), (resource.RLIMIT_CORE, 0)):
        _, hard = resource.prlimit(process, kind)
        least = most if hard == resource.RLIM_INFINITY else min(most, hard)
        resource.prlimit(process, kind, (least, least))


def _close(*fds: int) -> None:
    """In a process that the user's file forks, which has nothing to say to us."""
    for fd in fds:
        os.closerange(fd, fd + 1)  # which minds no error


def _end_with(question_fd: int) -> None:
    """End, with all that was forked, when the other side is gone, even in the midst of an answer."""
    gone = select.poll()
    gone.register(question_fd, 0)  # a hang-up is told unasked
    gone.poll()
    os.killpg(0, signal.SIGKILL)
