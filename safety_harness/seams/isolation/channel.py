"""The channel to another process: bytes in both directions, each within a time limit."""

from __future__ import annotations

import os
import select
import time
from collections.abc import Callable

from safety_harness.seams.isolation.messages import HEADER, length_of

NO_OUTPUT = -1
AT_ONCE = 65_536  # bytes that are read in one go


class GoneError(Exception):
    """The process did not answer and is treated as gone. ``hung`` is true if it exceeded the time limit."""

    def __init__(self, why: str, *, hung: bool = False) -> None:
        self.hung = hung
        super().__init__(why)


class NonsenseError(GoneError):
    """The process sent bytes that are no valid message, so that the harness has to end it."""

    def __init__(self, why: str = "its process answered nonsense") -> None:
        super().__init__(why)


class Channel:
    """Two file descriptors, one to write to and one to read from.

    While the channel waits, it passes the bytes of ``output`` to ``hear``. ``ended`` returns the error that
    describes how the process ended. Close the channel after a GoneError or any other exception from ``send``,
    ``frame`` or ``line``.
    """

    def __init__(
        self,
        sending: int,
        receiving: int,
        output: int,
        hear: Callable[[bytes], None],
        ended: Callable[[], GoneError],
    ) -> None:
        self._sending, self._receiving, self._output = sending, receiving, output
        self._hear, self._ended = hear, ended
        self._come = b""  # bytes that were read but not yet requested
        self._polls: dict[int, select.poll] = {}
        for fd in {sending, receiving, output} - {NO_OUTPUT}:
            os.set_blocking(fd, False)

    def send(self, data: bytes, limit_s: float) -> None:
        """Send ``data``; GoneError if the process has not read all of it within ``limit_s``."""
        until_s = time.monotonic() + limit_s
        view = memoryview(data)
        while view:
            try:
                view = view[os.write(self._sending, view) :]
            except BlockingIOError:
                self._wait_for(self._sending, select.POLLOUT, until_s)
            except (BrokenPipeError, ConnectionError):
                raise self._ended() from None

    def frame(self, limit_s: float, most: int) -> bytes:
        """Return the message in the next frame.

        Raises:
            GoneError: Within ``limit_s`` no bytes come, or bytes that are not a frame.

        """
        until_s = time.monotonic() + limit_s
        try:
            length = length_of(self._next(HEADER.size, until_s), most)
        except ValueError:
            raise NonsenseError from None
        return self._next(length, until_s)

    def line(self, limit_s: float, most: int) -> bytes:
        """Return the next line without its line end.

        Raises:
            GoneError: No line comes within ``limit_s``, or it is longer than ``most`` bytes.

        """
        until_s = time.monotonic() + limit_s
        searched = 0
        while (end := self._come.find(b"\n", searched)) < 0 and len(self._come) <= most:
            searched = len(self._come)
            self._read(until_s)
        if not 0 <= end <= most:
            raise NonsenseError(f"its line is longer than {most:,} bytes")
        line, self._come = self._come[:end], self._come[end + 1 :]
        return line

    @property
    def pending(self) -> bool:
        """Whether there is unread input, or the process is gone."""
        poll = select.poll()
        poll.register(self._receiving, select.POLLIN)
        return bool(self._come or poll.poll(0))

    def drain(self) -> bool:
        """Pass the waiting output to ``hear``; return False if the output has ended."""
        try:
            heard = os.read(self._output, AT_ONCE) if self._output >= 0 else b""
        except BlockingIOError:
            return True
        self._hear(heard)
        return bool(heard)

    def _next(self, count: int, until_s: float) -> bytes:
        while len(self._come) < count:
            self._read(until_s)
        data, self._come = self._come[:count], self._come[count:]
        return data

    def _read(self, until_s: float) -> None:
        """Read at least one more byte, unless the poll reported readiness by mistake."""
        self._wait_for(self._receiving, select.POLLIN, until_s)
        try:
            part = os.read(self._receiving, AT_ONCE)
        except BlockingIOError:
            return
        except ConnectionError:
            part = b""
        if not part:
            raise self._ended()
        self._come += part

    def _wait_for(self, fd: int, event: int, until_s: float) -> None:
        """Wait until ``fd`` is ready, and pass output on meanwhile.

        Otherwise the process might wait for ever for a reader of its output.
        """
        poll = self._polls.get(event)
        if poll is None:
            poll = self._polls[event] = select.poll()
            poll.register(fd, event)
            if self._output >= 0:
                poll.register(self._output, select.POLLIN)
        while True:
            left_s = until_s - time.monotonic()
            ready = dict(poll.poll(max(left_s, 0.0) * 1e3))
            if self._output in ready and not self.drain():
                for registered in self._polls.values():
                    registered.unregister(self._output)
                self._output = NO_OUTPUT
            if fd in ready:
                return
            if left_s <= 0.0:
                raise GoneError("its time was over", hung=True)
