"""The ways to a controller elsewhere: a process of ours with its file, a program that we start, a socket."""

from __future__ import annotations

import json
import logging
import os
import shlex
import socket
import sys
import weakref
from abc import ABC, abstractmethod
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec

from safety_harness.base.exceptions import ControllerError, printable
from safety_harness.cell.controller.out_of_process.messages import (
    MOST_BYTES,
    PROTOCOL,
    Act,
    ActOnRow,
    ActOnRows,
    Hello,
    MakeController,
    NoController,
    Reset,
    Said,
    Welcome,
    as_binary,
    as_json,
    binary_said,
    fields_of,
    json_said,
)
from safety_harness.seams.contract import Seen
from safety_harness.seams.isolation.channel import NO_OUTPUT, Channel, GoneError, NonsenseError
from safety_harness.seams.isolation.frames import framed
from safety_harness.seams.isolation.process import Process
from safety_harness.seams.isolation.telling import Heard, say_it_is_executed

LOGGER = logging.getLogger("safety_harness.controller")
PYTHON_S = 300.0  # to be imported
BEGIN_S = 60.0  # to start, or to take the connection, and to say hello
CHILD = "safety_harness.cell.controller.out_of_process.child"


class RefusedControllerError(Exception):
    """There is no controller: what was expected, what came, where to read on."""

    def __init__(self, expected: str, got: str, hint: str = "") -> None:
        self.expected, self.got, self.hint = map(printable, (expected, got, hint))
        super().__init__(f"expected {self.expected}; got {self.got}")


class Line(ABC):
    """A line to one controller, which is begun, and may be begun anew when it is gone."""

    begin_s = BEGIN_S  # how long the first answer may take

    def __init__(self) -> None:
        self._channel: Channel | None = None

    @property
    def alive(self) -> bool:
        """Is somebody there who has answered all that was asked, and no more?"""
        return self._channel is not None and not self._channel.pending

    def begin(self) -> Welcome:
        """Open it; GoneError, or RefusedControllerError if it leads to no controller of this version."""
        self._channel = self._open()
        self._channel.send(self._encoded(self._first()), self.begin_s)
        said = self.hear(self.begin_s)
        if isinstance(said, NoController):
            raise RefusedControllerError(said.expected, said.got, said.hint)
        if not isinstance(said, Welcome):
            raise RefusedControllerError('a first message that says "hello"', repr(said))
        if said.protocol != PROTOCOL:
            raise RefusedControllerError(
                f"the protocol {PROTOCOL!r}", repr(said.protocol), "safety-harness docs controller-protocol"
            )
        return said

    def reset(self, told: Reset, limit_s: float) -> None:
        """Begin an episode."""
        self._send(self._encoded(told), limit_s)

    @abstractmethod
    def act(self, tick: int, seen: Seen, sees: tuple[str, ...], lane: int, limit_s: float) -> None:
        """Tell it what is seen at that tick."""

    def hear(self, limit_s: float) -> Said:
        """What it says next; GoneError if that is nothing within the limit, or another kind of thing."""
        assert self._channel is not None
        try:
            return self._decoded(self._channel, limit_s)
        except (ValueError, RecursionError, msgspec.MsgspecError) as error:
            raise NonsenseError(f"what it said is no message: {printable(str(error))}") from None

    def end(self) -> None:
        """Close it, and kill what we started."""
        self._channel = None
        self._close()

    def _send(self, data: bytes, limit_s: float) -> None:
        assert self._channel is not None
        self._channel.send(data, limit_s)

    @abstractmethod
    def _open(self) -> Channel:
        """GoneError if it cannot be."""

    @abstractmethod
    def _close(self) -> None:
        """Nothing of it is left."""

    @abstractmethod
    def _first(self) -> Any:
        """What is said first."""

    @abstractmethod
    def _encoded(self, message: Any) -> bytes:
        """A message as it is sent."""

    @abstractmethod
    def _decoded(self, channel: Channel, limit_s: float) -> Said:
        """The next message that comes."""


class FileLine(Line):
    """To a process of ours that executes a Python file, or an ONNX policy.

    ``attribute``: the name in the one, the layout of the other.
    """

    begin_s = PYTHON_S

    def __init__(self, path: Path, source: bytes, attribute: str) -> None:
        super().__init__()
        self._path, self._source, self._attribute = path, source, attribute
        self._process: Process | None = None
        self._heard = Heard(path.name, LOGGER)

    @property
    def alive(self) -> bool:
        """And is its process ours, not that of the process that we were forked from?"""
        return super().alive and self._process is not None and self._process.owner == os.getpid()

    def act(self, tick: int, seen: Seen, sees: tuple[str, ...], lane: int, limit_s: float) -> None:
        """The row of numbers that the harness made ``seen`` of."""
        own = seen.__dict__
        if "_row" not in own:
            raise ControllerError("what is seen was not made by the harness, and cannot be sent")
        image = own.get("image")
        told = None
        if image is not None:
            pixels = image.pixels.tobytes() if image.new or tick == 0 else b""
            told = (image.time_s, image.new, image.pixels.shape[1], pixels)
        rows, hand_slots = own["_row"].tobytes(), own["_makers"].hand_slots
        self._send(self._encoded(ActOnRow(tick, hand_slots, rows, lane, told)), limit_s)

    def act_together(self, lanes: list[int], tick: int, hand_slots: int, rows: bytes, limit_s: float) -> None:
        """The rows that the controllers of those lanes see."""
        self._send(self._encoded(ActOnRows(tick, lanes, hand_slots, rows)), limit_s)

    def _open(self) -> Channel:
        say_it_is_executed(self._path, self._source, LOGGER)
        try:
            self._process = Process.python(CHILD, self._heard.hear)
        except OSError as error:
            raise GoneError(f"no process could be started: {error}") from error
        return self._process.channel

    def _close(self) -> None:
        if self._process is not None:
            self._process.end()
            self._process = None

    def _first(self) -> MakeController:
        asked = {"path": str(self._path), "folder": os.getcwd(), "sys_path": sys.path}
        return MakeController(json.dumps(asked | {"attribute": self._attribute}), self._source)

    def _encoded(self, message: Any) -> bytes:
        return framed(as_binary(message))

    def _decoded(self, channel: Channel, limit_s: float) -> Said:
        return binary_said.decode(channel.frame(limit_s, MOST_BYTES))


class _JsonLine(Line):
    """A JSON object a line."""

    def act(self, tick: int, seen: Seen, sees: tuple[str, ...], lane: int, limit_s: float) -> None:
        """The fields of what is seen."""
        self._send(self._encoded(Act(tick, fields_of(seen, sees))), limit_s)

    def _first(self) -> Hello:
        return Hello()

    def _encoded(self, message: Any) -> bytes:
        return as_json(message) + b"\n"

    def _decoded(self, channel: Channel, limit_s: float) -> Said:
        return json_said.decode(channel.line(limit_s, MOST_BYTES))


class ProgramLine(_JsonLine):
    """To a program that we start, by its standard input and output."""

    def __init__(self, command: Sequence[str], executable: Path, source: bytes) -> None:
        super().__init__()
        self._command, self._executable, self._source = command, executable, source
        self._process: Process | None = None
        self._heard = Heard(executable.name, LOGGER)

    @property
    def alive(self) -> bool:
        """And is its process ours?"""
        return super().alive and self._process is not None and self._process.owner == os.getpid()

    def _open(self) -> Channel:
        say_it_is_executed(self._executable, self._source, LOGGER)
        try:
            self._process = Process.program(self._command, self._heard.hear)
        except OSError as error:
            words = error.strerror or str(error)
            raise GoneError(f"{shlex.join(self._command)} could not be started: {words}") from error
        return self._process.channel

    def _close(self) -> None:
        if self._process is not None:
            self._process.end()
            self._process = None


class SocketLine(_JsonLine):
    """To a program that listens on this machine at ``address``, (host, port) or the path of a Unix socket."""

    def __init__(self, address: tuple[str, int] | str) -> None:
        super().__init__()
        self._address = address
        self._socket: socket.socket | None = None
        self._owner = os.getpid()

    @property
    def alive(self) -> bool:
        """And is the connection ours?"""
        return super().alive and self._owner == os.getpid()

    def _open(self) -> Channel:
        family = socket.AF_UNIX if isinstance(self._address, str) else socket.AF_INET
        self._owner = os.getpid()
        self._socket = socket.socket(family, socket.SOCK_STREAM)
        weakref.finalize(self, self._socket.close)
        try:
            self._socket.settimeout(self.begin_s)
            self._socket.connect(self._address)
            if family == socket.AF_INET:
                self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        except OSError as error:
            raise GoneError(f"nobody answers there: {error.strerror or error}") from error
        fd = self._socket.fileno()
        return Channel(fd, fd, NO_OUTPUT, lambda heard: None, lambda: GoneError("it closed the connection"))

    def _close(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None
