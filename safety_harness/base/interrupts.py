"""Ctrl-C, where what is under way is to be finished first, or where it is another process that answers."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker
from types import FrameType


@contextmanager
def deaf_children() -> Iterator[None]:
    """Processes that are started meanwhile hear no Ctrl-C, from their first moment on.

    They would end with a traceback while they import.  One for this thread is heard afterwards.
    """
    resource_tracker.ensure_running()  # which would let Ctrl-C in again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def one_more_ctrl_c(say: Callable[[str], None], remark: str) -> Iterator[Callable[[], bool]]:
    """Ctrl-C is answered with ``remark``, only the second one raises; yields whether there was one."""
    asked = False

    def note(number: int, frame: FrameType | None) -> None:
        nonlocal asked
        if asked:
            raise KeyboardInterrupt
        asked = True
        say(remark)

    before = signal.signal(signal.SIGINT, note)
    try:
        yield lambda: asked
    finally:
        signal.signal(signal.SIGINT, before)
