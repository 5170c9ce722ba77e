"""Ctrl-C while some work has to finish first, or while another process answers it."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker
from types import FrameType


@contextmanager
def deaf_children() -> Iterator[None]:
    """Shield processes that start in this context from Ctrl-C, from their first moment on.

    Otherwise they would end with a traceback during their imports.  A Ctrl-C for this thread takes effect
    after the context.
    """
    resource_tracker.ensure_running()  # which would let Ctrl-C in again
    earlier_mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, earlier_mask)


@contextmanager
def one_more_ctrl_c(say: Callable[[str], None], remark: str) -> Iterator[Callable[[], bool]]:
    """Answer the first Ctrl-C with ``remark``; the second raises.  Yields a function: was there a Ctrl-C?"""
    interrupted = False

    def note(number: int, frame: FrameType | None) -> None:
        nonlocal interrupted
        if interrupted:
            raise KeyboardInterrupt
        interrupted = True
        say(remark)

    earlier = signal.signal(signal.SIGINT, note)
    try:
        yield lambda: interrupted
    finally:
        signal.signal(signal.SIGINT, earlier)
