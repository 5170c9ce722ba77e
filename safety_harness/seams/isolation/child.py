"""What every process of a user's file has: our two ends, its limits, and an end with us.

It must start quickly: nothing imported here waits for a compiler.
"""

from __future__ import annotations

import os
import resource
import select
import signal
import sys
import threading
from contextlib import suppress

from safety_harness.seams.isolation.frames import HEADER, MEMORY_BYTES, framed, length_of


class Ends:
    """Where it reads what we say and writes what it says, in frames."""

    def __init__(self, question_fd: int, answer_fd: int) -> None:
        """The process keeps the limits from here on, and ends when we do."""
        for fd in (question_fd, answer_fd):
            os.set_inheritable(fd, False)
        os.register_at_fork(after_in_child=lambda: _close(question_fd, answer_fd))
        _limit(resource.RLIMIT_DATA, MEMORY_BYTES)
        _limit(resource.RLIMIT_CORE, 0)
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

    def write(self, message: bytes) -> None:
        """Say it, after what the user's file has printed."""
        if os.getpid() != self._process:
            os._exit(0)  # a fork of the user's that came back from it
        for stream in (sys.stdout, sys.stderr):  # it may have closed its output
            with suppress(Exception):
                stream.flush()
        self._answered.write(framed(message))
        self._answered.flush()


def _close(*fds: int) -> None:
    """In a process that the user's file forks, which has nothing to say to us."""
    for fd in fds:
        os.closerange(fd, fd + 1)  # which minds no error


def _limit(kind: int, most: int) -> None:
    _, hard = resource.getrlimit(kind)
    least = most if hard == resource.RLIM_INFINITY else min(most, hard)
    resource.setrlimit(kind, (least, least))


def _end_with(question_fd: int) -> None:
    """End, with all that was forked, when the other side is gone, even in the midst of an answer."""
    gone = select.poll()
    gone.register(question_fd, 0)  # a hang-up is told unasked
    gone.poll()
    os.killpg(0, signal.SIGKILL)
