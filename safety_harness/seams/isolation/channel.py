"""A channel to another process that sends and receives bytes, with a time limit for each operation."""

from __future__ import annotations

import os
import select
import time
from collections.abc import Callable

from safety_harness.seams.isolation.messages import HEADER, length_of

NO_OUTPUT = -1  # instead of a descriptor, for a peer whose output cannot be read
AT_ONCE = 65_536  # bytes that are read in one go


class GoneError(Exception):
    """The process did not answer and is treated as ended. ``hung`` is true if it exceeded the time limit."""

    def __init__(self, why: str, *, hung: bool = False) -> None:
        self.hung = hung
        super().__init__(why)


class NonsenseError(GoneError):
    """The process sent bytes that are not a valid message, so the harness has to end the process."""

    def __init__(self, why: str = "its process answered nonsense") -> None:
        super().__init__(why)


class Channel:
    """A pair of file descriptors, one for writing and one for reading.

    While the channel waits, it reads the bytes that arrive at the descriptor ``output``, and passes them to
    ``hear``. ``ended`` is a function that returns an error about the way in which the process ended. After a
    GoneError or any other exception from ``send``, ``frame`` or ``line``, the channel must be closed.
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
        """Send ``data``.

        Raise GoneError if the process has not read all data within ``limit_s``.
        """
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
            GoneError: The time ``limit_s`` ends before a frame has arrived, or the bytes that arrive are no
                frame.

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
            GoneError: The time ``limit_s`` ends before a line has arrived, or the line is longer than
                ``most`` bytes.

        """
        until_s = time.monotonic() + limit_s
        searched = 0
        # Search only the new bytes, because a long line arrives in many parts.
        while (end := self._come.find(b"\n", searched)) < 0 and len(self._come) <= most:
            searched = len(self._come)
            self._read(until_s)
        if not 0 <= end <= most:
            raise NonsenseError(f"its line is longer than {most:,} bytes")
        line, self._come = self._come[:end], self._come[end + 1 :]
        return line

    @property
    def pending(self) -> bool:
        """Whether there is unread input, or the process has closed its side."""
        poll = select.poll()
        poll.register(self._receiving, select.POLLIN)
        return bool(self._come or poll.poll(0))

    def drain(self) -> bool:
        """Pass the output that has arrived to ``hear``.

        Return False if the output has ended.
        """
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
        """Read at least one more byte.

        If the poll reported readiness by mistake, read no byte.
        """
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
        """Wait until ``fd`` is ready.

        Meanwhile, pass the output of the process to ``hear``. If the output were not read, the process might
        wait for ever to write more.
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
