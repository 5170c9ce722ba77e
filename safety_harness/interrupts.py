"""Ctrl-C, where what is under way is to be finished first."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType


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
