"""A connection to another process, which serves a user's file, is a program, or listens at a socket.

This module starts and ends the process, applies time limits and reports refusals, in the same way for every
kind of object. The messages for a kind of object are defined elsewhere.
"""

from __future__ import annotations

import logging
import os
import socket
import threading
import weakref
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from safety_harness.base.exceptions import InputError, Place, printable
from safety_harness.seams.isolation.channel import NO_OUTPUT, Channel, GoneError, NonsenseError
from safety_harness.seams.isolation.messages import Drop, ProcessMessage, Refused, framed, packed, plain
from safety_harness.seams.isolation.process import Process
from safety_harness.seams.isolation.telling import Heard, say_it_is_executed

M = TypeVar("M", bound=ProcessMessage)


class Socket:
    """A connection to a process that listens at ``address``: (host, port), or the path of a Unix socket."""

    def __init__(self, address: tuple[str, int] | str, limit_s: float) -> None:
        """Connect within ``limit_s``.

        Raise GoneError if no program answers at the address.
        """
        family = socket.AF_UNIX if isinstance(address, str) else socket.AF_INET
        self.owner = os.getpid()
        line = socket.socket(family, socket.SOCK_STREAM)
        self.end = weakref.finalize(self, line.close)
        try:
            line.settimeout(limit_s)
            line.connect(address)
            if family == socket.AF_INET:
                # A message must not wait for the acknowledgement of the previous one (Nagle's algorithm).
                line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        except OSError as error:
            raise GoneError(f"no program answers there: {error.strerror or error}") from error
        fd = line.fileno()
        self.channel = Channel(
            fd, fd, NO_OUTPUT, lambda heard: None, lambda: GoneError("it closed the connection")
        )


Peer = Process | Socket  # the other end of a connection


@dataclass(frozen=True)
class Wire:
    """The encoding of messages, with a function that reads the next message within a time limit."""

    sent: Callable[[ProcessMessage], bytes]
    next: Callable[[Channel, float], Any]


def binary_wire(decode: Callable[[bytes], Any], most: int) -> Wire:
    """Return the wire to a process of this package, with MessagePack in frames of at most ``most`` bytes."""
    return Wire(
        lambda message: framed(packed(message)), lambda channel, limit_s: decode(channel.frame(limit_s, most))
    )


def json_wire(decode: Callable[[bytes], Any], most: int) -> Wire:
    """Return the wire to a program, with one JSON object per line of at most ``most`` bytes."""
    encode = msgspec.json.Encoder(enc_hook=plain).encode
    return Wire(
        lambda message: encode(message) + b"\n", lambda channel, limit_s: decode(channel.line(limit_s, most))
    )


class RefusedError(Exception):
    """The other process does not provide the requested object.

    The error states the expected and the actual object, a hint on further reading, and the field.
    """

    def __init__(self, expected: str, got: str, hint: str = "", field: str = "") -> None:
        self.expected, self.got, self.hint, self.field = map(printable, (expected, got, hint, field))
        super().__init__(f"expected {self.expected}; got {self.got}")


class Connection:
    """A connection that calls ``start`` to begin, and calls it again if the peer has ended.

    ``generation`` is the number of processes so far, because objects of an earlier process are lost. Several
    users may share a connection. Each user gets a number from ``numbers`` for each object, and must own the
    ``lock`` during a question.
    """

    def __init__(self, start: Callable[[], Peer], wire: Wire) -> None:
        self._start, self._wire = start, wire
        self._peer: Peer | None = None
        self.generation, self.numbers, self.lock = 0, count(1), threading.RLock()
        self._forgotten: deque[int] = deque()

    @property
    def alive(self) -> bool:
        """Whether there is a peer that this process started.

        A peer from before a fork does not count, because it only answers the parent process.
        """
        if self._peer is not None and self._peer.owner != os.getpid():
            self._peer = None  # the peer answers only the process that started it
        return self._peer is not None

    @property
    def quiet(self) -> bool:
        """Whether there is a peer that has answered all questions and has not sent anything since then."""
        return self.alive and not self._channel.pending

    def introduce(self, first: ProcessMessage, kind: type[M], limit_s: float) -> M:
        """Return the answer to the first message about an object.

        The answer must be of type ``kind``. If there is no peer, the method starts a peer. If the peer of
        earlier objects has ended, the method starts a new peer and repeats the message once.

        Raises:
            GoneError: No answer has arrived within ``limit_s``, or the new process has ended.
            RefusedError: The peer refuses the object, or its answer has another type.

        """
        new = not self.alive
        if new:
            self._peer = self._start()
            self._channel = self._peer.channel
            self.generation += 1
        try:
            self.say(first, limit_s)
            answer = self.hear(limit_s)
        except BaseException as error:  # after Ctrl-C, its next message is unpredictable
            self.end()
            if new or not isinstance(error, GoneError):
                raise
            return self.introduce(first, kind, limit_s)
        if isinstance(answer, Refused):
            raise RefusedError(answer.expected, answer.got, answer.hint, answer.field)
        if not isinstance(answer, kind):
            raise RefusedError(f'a first message that says "{kind.__struct_config__.tag}"', repr(answer))
        return answer

    def say(self, message: ProcessMessage, limit_s: float) -> None:
        """Send a message.

        Raise GoneError if the peer does not read the message within the limit.
        """
        while self._forgotten:
            self._channel.send(self._wire.sent(Drop(self._forgotten.popleft())), limit_s)
        self._channel.send(self._wire.sent(message), limit_s)

    def forget(self, number: int) -> None:
        """Make the peer drop an object.

        The request is sent just before the next message to the peer. A caller may use this method at any
        time, even while a message is being sent.
        """
        self._forgotten.append(number)

    def hear(self, limit_s: float) -> Any:
        """Return the peer's next message.

        Raise GoneError if no valid message arrives within the limit.
        """
        try:
            return self._wire.next(self._channel, limit_s)
        except (ValueError, RecursionError, msgspec.MsgspecError) as error:
            raise NonsenseError(f"it sent no valid message: {printable(str(error))}") from None

    def end(self) -> None:
        """End the peer's process.

        All objects in it are lost.
        """
        if self._peer is not None:
            self._peer.end()
            self._peer = None


@contextmanager
def refusing(
    error: type[InputError], expected: str, within_s: float, place: Place | None, file: Path | None = None
) -> Iterator[None]:
    """Raise ``error`` if the other process refuses the object or ends while the block runs.

    Args:
        error: The class of the error.
        expected: The expected behaviour of the process, which the error states if the process has ended.
        within_s: The time limit [s] for the answer. The error states it if the process did not answer in
            time.
        place: The place of the error. If a place is given, the error's text states the field that the process
            reports. None means that this field of ``file`` is the place.
        file: The user's file.

    """
    try:
        yield
    except RefusedError as refusal:
        at = place or Place(file=file, field=refusal.field or None)
        named = f"{refusal.field}: " if refusal.field and place is not None else ""
        got = named + refusal.got
        raise error(place=at, expected=refusal.expected, got=got, hint=refusal.hint) from refusal
    except GoneError as gone:
        limit = f" within {within_s:g} s" if gone.hung else ""
        raise error(place=place or Place(file=file), expected=expected + limit, got=str(gone)) from gone


def process_of(
    path: Path,
    source: bytes,
    logger: logging.Logger,
    begin: Callable[[Callable[[bytes], None]], Process],
    *,
    silent: bool = False,
) -> Callable[[], Process]:
    """Return a function that starts the process of a user's file.

    The returned function logs a warning before the file is executed for the first time.

    Args:
        path: The user's file.
        source: The bytes of the file.
        logger: The logger of the warning and of the file's output.
        begin: A function that starts and returns a ``Process``. Its only argument is the listener for the
            process's output.
        silent: Whether to log no output of the file.

    """
    heard = Heard(path.name, logger, silent=silent)

    def start() -> Process:
        say_it_is_executed(path, source, logger)
        try:
            return begin(heard.hear)
        except OSError as error:
            raise GoneError(f"{path.name} could not be started: {error.strerror or error}") from error

    return start
