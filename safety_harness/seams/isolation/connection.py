"""A connection to another process, and the three ways to one: a user's file, a program, a socket.

Every kind of object is begun, asked, timed, ended and refused here.  What it is asked is its own affair.
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
    """A connection to who listens at ``address``: (host, port), or the path of a Unix socket."""

    def __init__(self, address: tuple[str, int] | str, limit_s: float) -> None:
        """GoneError if nobody answers there."""
        family = socket.AF_UNIX if isinstance(address, str) else socket.AF_INET
        self.owner = os.getpid()
        line = socket.socket(family, socket.SOCK_STREAM)
        self.end = weakref.finalize(self, line.close)
        try:
            line.settimeout(limit_s)
            line.connect(address)
            if family == socket.AF_INET:
                line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        except OSError as error:
            raise GoneError(f"nobody answers there: {error.strerror or error}") from error
        fd = line.fileno()
        self.channel = Channel(
            fd, fd, NO_OUTPUT, lambda heard: None, lambda: GoneError("it closed the connection")
        )


Peer = Process | Socket  # the other end of a connection


@dataclass(frozen=True)
class Wire:
    """How messages go there, and how the next one is read within a time."""

    sent: Callable[[ProcessMessage], bytes]
    next: Callable[[Channel, float], Any]


def binary_wire(decode: Callable[[bytes], Any], most: int) -> Wire:
    """Return the wire to a process of ours: MessagePack in frames of at most ``most`` bytes."""
    return Wire(
        lambda message: framed(packed(message)), lambda channel, limit_s: decode(channel.frame(limit_s, most))
    )


def json_wire(decode: Callable[[bytes], Any], most: int) -> Wire:
    """Return the wire to a program: a JSON object a line, of at most ``most`` bytes."""
    encode = msgspec.json.Encoder(enc_hook=plain).encode
    return Wire(
        lambda message: encode(message) + b"\n", lambda channel, limit_s: decode(channel.line(limit_s, most))
    )


class RefusedError(Exception):
    """There is no such object: what was expected, what came, where to read on, and in which field."""

    def __init__(self, expected: str, got: str, hint: str = "", field: str = "") -> None:
        self.expected, self.got, self.hint, self.field = map(printable, (expected, got, hint, field))
        super().__init__(f"expected {self.expected}; got {self.got}")


class Connection:
    """A connection that is begun by ``start``, and may be begun anew when its other end is gone.

    ``generation`` counts the processes; what was made in an earlier one is no more.  Who shares it takes a
    number of ``numbers`` for each object, and holds the ``lock`` while one is asked.
    """

    def __init__(self, start: Callable[[], Peer], wire: Wire) -> None:
        self._start, self._wire = start, wire
        self._peer: Peer | None = None
        self.generation, self.numbers, self.lock = 0, count(1), threading.RLock()
        self._forgotten: deque[int] = deque()

    @property
    def alive(self) -> bool:
        """Is somebody there, and not there for the process that we were forked from?"""
        if self._peer is not None and self._peer.owner != os.getpid():
            self._peer = None  # it talks to that one alone
        return self._peer is not None

    @property
    def quiet(self) -> bool:
        """Is somebody there who has answered all that was asked, and no more?"""
        return self.alive and not self._channel.pending

    def introduce(self, first: ProcessMessage, kind: type[M], limit_s: float) -> M:
        """Return the answer to a first message, of that ``kind``; GoneError, RefusedError.

        It is said in a new process if there is none, and once more in one if that of earlier objects is gone.
        """
        new = not self.alive
        if new:
            self._peer = self._start()
            self._channel = self._peer.channel
            self.generation += 1
        try:
            self.say(first, limit_s)
            said = self.hear(limit_s)
        except BaseException as error:  # after Ctrl-C, who knows what it will say next
            self.end()
            if new or not isinstance(error, GoneError):
                raise
            return self.introduce(first, kind, limit_s)
        if isinstance(said, Refused):
            raise RefusedError(said.expected, said.got, said.hint, said.field)
        if not isinstance(said, kind):
            raise RefusedError(f'a first message that says "{kind.__struct_config__.tag}"', repr(said))
        return said

    def say(self, message: ProcessMessage, limit_s: float) -> None:
        """Send a message; GoneError if it is not taken within the limit."""
        while self._forgotten:
            self._channel.send(self._wire.sent(Drop(self._forgotten.popleft())), limit_s)
        self._channel.send(self._wire.sent(message), limit_s)

    def forget(self, number: int) -> None:
        """Drop an object before the next thing is said: this may be called amid another message."""
        self._forgotten.append(number)

    def hear(self, limit_s: float) -> Any:
        """Return what is said next; GoneError if that is nothing within the limit, or no message."""
        try:
            return self._wire.next(self._channel, limit_s)
        except (ValueError, RecursionError, msgspec.MsgspecError) as error:
            raise NonsenseError(f"what it said is no message: {printable(str(error))}") from None

    def end(self) -> None:
        """End the process, and all that was made in it."""
        if self._peer is not None:
            self._peer.end()
            self._peer = None


@contextmanager
def refusing(
    error: type[InputError], expected: str, within_s: float, place: Place | None, file: Path | None = None
) -> Iterator[None]:
    """Raise the ``error`` where the block finds no object, or a process that does not live to say so.

    It is at ``place``, or without one at the field of ``file`` that the process tells.
    """
    try:
        yield
    except RefusedError as said:
        at = place or Place(file=file, field=said.field or None)
        raise error(place=at, expected=said.expected, got=said.got, hint=said.hint) from said
    except GoneError as gone:
        within = f" within {within_s:g} s" if gone.hung else ""
        raise error(place=place or Place(file=file), expected=expected + within, got=str(gone)) from gone


def process_of(
    path: Path,
    source: bytes,
    logger: logging.Logger,
    begin: Callable[[Callable[[bytes], None]], Process],
    *,
    silent: bool = False,
) -> Callable[[], Process]:
    """Return what starts a process of a user's file, and says so: ``begin`` is a partial of ``Process``.

    Of a ``silent`` one nobody hears what the file writes.
    """
    heard = Heard(path.name, logger, silent=silent)

    def start() -> Process:
        say_it_is_executed(path, source, logger)
        try:
            return begin(heard.hear)
        except OSError as error:
            raise GoneError(f"{path.name} could not be started: {error.strerror or error}") from error

    return start
