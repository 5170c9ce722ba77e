"""Serve objects of a user's file in a separate process, which answers calls to them one after another.

The process limits its own memory, and ends when the harness ends. The process must start quickly, so this
module imports no compiler.
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

MOST_TOLD = 1 << 30  # the largest message to the process, in bytes


class ServedKind(ABC):
    """One kind of objects that a user's file provides, with the calls that they answer.

    ``made`` contains the objects by number.
    """

    what: str  # "an avoider"
    told: msgspec.msgpack.Decoder[Any]  # Make, Drop and the calls

    def __init__(self) -> None:
        self.made: dict[int, Any] = {}

    @abstractmethod
    def make(self, message: Make, path: Path, wanted: dict[str, Any]) -> ProcessMessage:
        """Create an object, and return its description.

        Any exception means that the file is refused.
        """

    @abstractmethod
    def answers(self, message: Any) -> Iterator[ProcessMessage]:
        """Yield the answers to a call.

        Any exception is reported as a failed call.
        """


def serve(kind: ServedKind, question_fd: int, answer_fd: int) -> None:
    """Answer calls until the harness has ended."""
    ends, file = _Ends(question_fd, answer_fd), ""
    while True:
        message = kind.told.decode(ends.read(MOST_TOLD))
        try:
            if isinstance(message, Make):
                wanted = json.loads(message.wanted)
                file = wanted["path"]
                ends.write(_made(kind, message, Path(file), wanted))
            elif isinstance(message, Drop):
                kind.made.pop(message.number, None)
            else:
                for answer in kind.answers(message):
                    ends.write(answer)
        except BaseException as error:  # SystemExit, or the user's own exception: continue
            own = isinstance(error, ControllerError)
            text = str(error) if own else described(error, file)
            text = text if own and text.startswith(message.call) else f"{message.call} raised: {text}"
            ends.write(Failed(printable(text)[:MOST_WORDS]))


def _made(kind: ServedKind, message: Make, path: Path, wanted: dict[str, Any]) -> ProcessMessage:
    sys.path[:] = wanted["sys_path"]
    try:
        os.chdir(wanted["folder"])
        return kind.make(message, path, wanted)
    except InputError as error:
        field = error.place.field if error.place.file is not None else None  # otherwise the reference's own
        reason = error.expected, error.got, error.hint, field or ""
    except BaseException as error:  # a user's code may raise anything
        reason = f"{wanted['name'] or path.name} to be {kind.what}", described(error, str(path)), "", ""
    return Refused(*map(printable, reason))


class _Ends:
    """The two descriptors through which the process reads our messages and writes its answers, in frames."""

    def __init__(self, question_fd: int, answer_fd: int) -> None:
        """Limit the memory of this process, and make it end when the harness ends."""
        limit()
        for fd in (question_fd, answer_fd):
            os.set_inheritable(fd, False)
        os.register_at_fork(after_in_child=lambda: _close(question_fd, answer_fd))
        threading.Thread(target=_end_with, args=(question_fd,), daemon=True).start()
        self._questions = open(question_fd, "rb", closefd=False)  # noqa: SIM115
        self._answered = open(answer_fd, "wb", closefd=False)  # noqa: SIM115
        self._process = os.getpid()

    def read(self, most: int) -> bytes:
        """Return the next message.

        End the process if no more messages can arrive.
        """
        header = self._questions.read(HEADER.size)
        if not header:
            os._exit(0)  # the other side is gone
        return self._questions.read(length_of(header, most))

    def write(self, message: ProcessMessage) -> None:
        """Send a message, but first flush all output that the user's file has printed so far."""
        if os.getpid() != self._process:
            os._exit(0)  # a fork by the user's file that returned to our code
        for stream in (sys.stdout, sys.stderr):  # it may have closed its output
            with suppress(Exception):
                stream.flush()
        self._answered.write(framed(packed(message)))
        self._answered.flush()


def limit(process: int = 0) -> None:
    """Limit the data of a process to MEMORY_BYTES, and forbid core files.

    ``process`` is the number of the process. The number 0 means this process.
    """
    # RLIMIT_DATA instead of RLIMIT_AS, because libraries reserve more addresses than they use.
    for kind, most in ((resource.RLIMIT_DATA, MEMORY_BYTES), (resource.RLIMIT_CORE, 0)):
        _, hard = resource.prlimit(process, kind)
        least = most if hard == resource.RLIM_INFINITY else min(most, hard)
        resource.prlimit(process, kind, (least, least))


def _close(*fds: int) -> None:
    """Close our descriptors in a fork of this process.

    A fork that the user's file creates must not send us messages.
    """
    for fd in fds:
        os.closerange(fd, fd + 1)  # closerange ignores errors


def _end_with(question_fd: int) -> None:
    """Kill this process and its forks as soon as the harness has ended, even during a computation."""
    gone = select.poll()
    gone.register(question_fd, 0)  # poll always reports a hang-up
    gone.poll()
    os.killpg(0, signal.SIGKILL)
