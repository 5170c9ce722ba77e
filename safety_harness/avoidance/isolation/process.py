"""The process of a user's avoider from our side: start it, talk to it within a time, end it for good."""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import time
import weakref
from collections.abc import Callable

from msgspec import Struct

from safety_harness.avoidance.isolation.frames import (
    HEADER,
    MOST_ANSWER_BYTES,
    Said,
    from_the_child,
    length_of,
    packed,
)

BOOT = (
    "import sys, json; sys.path[:] = json.loads(sys.argv[3]); "
    "from safety_harness.avoidance.isolation.child import main; main(int(sys.argv[1]), int(sys.argv[2]))"
)


class GoneError(Exception):
    """The process did not answer and is no more; ``hung``: because its time was over."""

    def __init__(self, why: str, *, hung: bool = False) -> None:
        self.hung = hung
        super().__init__(why)


class NonsenseError(GoneError):
    """What came is nothing that the process has to say, and it has to be ended."""

    def __init__(self) -> None:
        super().__init__("its process answered nonsense")


class Process:
    """One process; ``hear`` is told what it writes to its standard output and error.

    After a GoneError, or anything else that is raised while it is spoken to, it has to be ended.
    """

    def __init__(self, hear: Callable[[bytes], None]) -> None:
        self._hear = hear
        self.owner = os.getpid()
        question_in, self._question = os.pipe()
        self._answer, answer_out = os.pipe()
        arguments = [str(question_in), str(answer_out), json.dumps(sys.path)]
        try:
            self._child = subprocess.Popen(
                [sys.executable, "-P", "-u", "-c", BOOT, *arguments],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                pass_fds=(question_in, answer_out),
                start_new_session=True,  # Ctrl-C is ours, and all that it forks is in its group
            )
        except OSError:
            os.close(self._question)
            os.close(self._answer)
            raise
        finally:
            os.close(question_in)
            os.close(answer_out)
        assert self._child.stdout is not None
        self._output = self._child.stdout.fileno()
        for fd in (self._question, self._answer, self._output):
            os.set_blocking(fd, False)
        fds = (self._question, self._answer)
        self._finish = weakref.finalize(self, _finish, self.owner, self._child, fds)

    def end(self) -> None:
        """Kill it and what it forked; hear its last words."""
        if self._finish.alive and self._drain():
            self._hear(b"")
        self._finish()

    def send(self, message: Struct, limit_s: float) -> None:
        """GoneError if it has not taken the whole of the message within the limit."""
        until_s = time.monotonic() + limit_s
        view = memoryview(packed(message))
        while view:
            try:
                view = view[os.write(self._question, view) :]
            except BlockingIOError:
                self._wait_for(self._question, select.POLLOUT, until_s)
            except BrokenPipeError:
                raise self._ended() from None

    def receive(self, limit_s: float) -> Said:
        """What it says next; GoneError if that is nothing within the limit, or another kind of thing."""
        until_s = time.monotonic() + limit_s
        try:
            length = length_of(self._read(HEADER.size, until_s), MOST_ANSWER_BYTES)
            said = from_the_child.decode(self._read(length, until_s))
        except (ValueError, RecursionError):
            raise NonsenseError from None
        self._drain()
        return said

    def _read(self, count: int, until_s: float) -> bytes:
        parts = []
        while count:
            self._wait_for(self._answer, select.POLLIN, until_s)
            try:
                part = os.read(self._answer, count)
            except BlockingIOError:
                continue
            if not part:
                raise self._ended()
            parts.append(part)
            count -= len(part)
        return b"".join(parts)

    def _wait_for(self, fd: int, event: int, until_s: float) -> None:
        """Until ``fd`` is ready; meanwhile take what it writes, so that it never waits for a reader."""
        poll = select.poll()
        poll.register(fd, event)
        if self._output >= 0:
            poll.register(self._output, select.POLLIN)
        while True:
            left_s = until_s - time.monotonic()
            ready = dict(poll.poll(max(left_s, 0.0) * 1e3))
            if fd in ready:
                return
            if self._output in ready and not self._drain():
                poll.unregister(self._output)
                self._output = -1
            if left_s <= 0.0:
                raise GoneError("its time was over", hung=True)

    def _drain(self) -> bool:
        """Hear what it has written; False at the end of its output."""
        try:
            heard = os.read(self._output, 65_536) if self._output >= 0 else b""
        except BlockingIOError:
            return True
        self._hear(heard)
        return bool(heard)

    def _ended(self) -> GoneError:
        """How; it is left unreaped, so that its group keeps its number until that is killed."""
        until_s = time.monotonic() + 1.0
        while time.monotonic() < until_s:
            found = os.waitid(os.P_PID, self._child.pid, os.WEXITED | os.WNOWAIT | os.WNOHANG)
            if found is None:
                time.sleep(0.001)
            elif found.si_code == os.CLD_EXITED:
                return GoneError(f"its process ended with exit status {found.si_status}")
            else:
                return GoneError(f"its process was ended by {signal.Signals(found.si_status).name}")
        return GoneError("its process closed the line to us")


def _finish(owner: int, child: subprocess.Popen[bytes], fds: tuple[int, ...]) -> None:
    """Kill the process and its group, once; a fork of ours that inherited it only lets go of it."""
    if os.getpid() == owner:
        for kill in (os.killpg, os.kill):  # it may have left its group
            with contextlib.suppress(ProcessLookupError, PermissionError):
                kill(child.pid, signal.SIGKILL)
        with contextlib.suppress(subprocess.TimeoutExpired):
            child.wait(timeout=5.0)
    else:
        child.returncode = 0  # not ours to wait for
    for fd in fds:
        os.close(fd)
    if child.stdout is not None:
        child.stdout.close()
