"""The line to another process: bytes there and back, each within a time."""

from __future__ import annotations

import os
import select
import time
from collections.abc import Callable

from safety_harness.seams.isolation.messages import HEADER, length_of

NO_OUTPUT = -1
AT_ONCE = 65_536  # bytes that are read in one go


class GoneError(Exception):
    """The process did not answer and is no more; ``hung``: because its time was over."""

    def __init__(self, why: str, *, hung: bool = False) -> None:
        self.hung = hung
        super().__init__(why)


class NonsenseError(GoneError):
    """What came is nothing that the process has to say, and it has to be ended."""

    def __init__(self, why: str = "its process answered nonsense") -> None:
        super().__init__(why)


class Channel:
    """Two ends that we write to and read from; ``hear`` is told what comes from ``output`` meanwhile.

    ``ended`` says how the other side ended.  After a GoneError, or anything else that is raised while it is
    spoken to, it has to be closed.
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
        self._come = b""  # and not yet asked for
        self._polls: dict[int, select.poll] = {}
        for fd in {sending, receiving, output} - {NO_OUTPUT}:
            os.set_blocking(fd, False)

    def send(self, data: bytes, limit_s: float) -> None:
        """GoneError if the other side has not taken all of it within the limit."""
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
        """The message of the next frame; GoneError if none comes within the limit, or no frame."""
        until_s = time.monotonic() + limit_s
        try:
            length = length_of(self._next(HEADER.size, until_s), most)
        except ValueError:
            raise NonsenseError from None
        return self._next(length, until_s)

    def line(self, limit_s: float, most: int) -> bytes:
        """The next line, without its end; GoneError if none comes within the limit, or a longer one."""
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
        """Is there something that nobody asked for, or has the other side gone?"""
        poll = select.poll()
        poll.register(self._receiving, select.POLLIN)
        return bool(self._come or poll.poll(0))

    def drain(self) -> bool:
        """Hear what has been written; False at the end of it."""
        try:
            heard = os.read(self._output, AT_ONCE) if self._output >= 0 else b""
        except BlockingIOError:
            return True
        self._hear(heard)
        return bool(heard)

    def _next(self, count: int, until_s: float) -> bytes:
        while len(self._come) < count:
            self._read(until_s)
        found, self._come = self._come[:count], self._come[count:]
        return found

    def _read(self, until_s: float) -> None:
        """Some more."""
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
        """Until ``fd`` is ready; meanwhile take what it writes, so that it never waits for a reader."""
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
                for one in self._polls.values():
                    one.unregister(self._output)
                self._output = NO_OUTPUT
            if fd in ready:
                return
            if left_s <= 0.0:
                raise GoneError("its time was over", hung=True)
