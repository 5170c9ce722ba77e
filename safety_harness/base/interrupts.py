"""Handling of Ctrl-C and similar signals, for work that must finish and for child processes."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker
from types import FrameType


def answer_as_ctrl_c() -> None:
    """Make SIGTERM and SIGHUP act like Ctrl-C, unless the process ignores these signals.

    In forked processes, these signals end the process at once.
    """
    own = os.getpid()

    def answer(number: int, frame: FrameType | None) -> None:
        if os.getpid() != own:
            signal.signal(number, signal.SIG_DFL)
            signal.raise_signal(number)
        handler = signal.getsignal(signal.SIGINT)
        (handler if callable(handler) else signal.default_int_handler)(number, frame)

    for number in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, answer)


@contextmanager
def deaf_children() -> Iterator[None]:
    """Protect processes that start within this context from Ctrl-C.

    A process is protected as soon as it exists.  Without this protection, Ctrl-C would end the processes with
    a traceback during their imports.  If Ctrl-C reaches the calling thread within the context, it takes
    effect at the context's end.
    """
    resource_tracker.ensure_running()  # otherwise it would allow Ctrl-C again later
    earlier_mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, earlier_mask)


@contextmanager
def one_more_ctrl_c(say: Callable[[str], None], remark: str) -> Iterator[Callable[[], bool]]:
    """Print ``remark`` at the first Ctrl-C within the context, and raise KeyboardInterrupt at the second.

    The context yields a function that returns whether Ctrl-C was pressed.
    """
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
