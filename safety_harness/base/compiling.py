"""Print the progress of compilation.

This module loads quickly, so it is imported before numba.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TextIO

PATIENCE_S, EVERY_S = 1.0, 10.0  # seconds before the first line, and between two lines in a file


@dataclass(frozen=True)
class Compilation:
    """The progress of compilation in one process.

    Args:
        ready: The number of functions with machine code.
        seconds: The time [s] spent on compiling.
        going_on: Whether the outermost function is still being compiled.
        unwritable: The reason why the process cannot store machine code, or an empty text if it can.

    """

    ready: int
    seconds: float
    going_on: bool
    unwritable: str = ""


watchers: list[Callable[[Compilation], None]] = []  # those of this process; its workers have none


class Compiled:
    """The number of functions, ``count``, that this process has compiled."""

    count = 0


@dataclass
class Pace:
    """The rate at which a job finishes items.

    Each compilation in this process restarts the measurement, so that estimates do not include the time of
    compiling.  The first finished item only starts the measurement, because its time may include loading or
    compiling code in some process.
    """

    now_s: Callable[[], float] = time.monotonic
    begun_s: float = field(init=False)
    _since: tuple[float, float] | None = None
    _compiled: int = 0

    def __post_init__(self) -> None:
        self.begun_s = self.now_s()

    def rate(self, done: float) -> float | None:
        """Return the number of finished items per second, or None while it is unknown."""
        now_s = self.now_s()
        if self._since is None or self._compiled != Compiled.count:
            self._compiled, self._since = Compiled.count, (now_s, done) if done > 0.0 else None
            return None
        since_s, since_count = self._since
        return (done - since_count) / (now_s - since_s) if done > since_count and now_s > since_s else None


@dataclass
class CompilationLine:
    """A line about a long compilation, which is printed on ``stream``.

    On a terminal the line is updated, and disappears at the end.  If ``stream`` is a file, a new line appears
    every ten seconds.  While ``finished_part`` is unknown, the line has no percentage.

    Args:
        stream: The stream on which the line is printed.
        finished_part: A function that returns two numbers: the functions already in the cache, and all
            functions that a run needs.  The result None means that the numbers are unknown.
        clock: A function that returns a time in seconds.

    """

    stream: TextIO
    finished_part: Callable[[], tuple[int, int] | None] = lambda: None
    clock: Callable[[], float] = time.monotonic
    _said_s: float | None = None
    _warned: bool = field(default=False)

    def __call__(self, now: Compilation) -> None:
        """Print the progress ``now``.

        This method is registered in ``watchers``.
        """
        if now.unwritable and not self._warned:
            self._warned = True
            self._write(f"warning: {now.unwritable}\n")
        if now.seconds < PATIENCE_S:
            return
        line = f"compiling the control stack for this machine, once: {self._part(now)}, {now.seconds:.0f} s"
        if self.stream.isatty():
            self._write(f"\r\x1b[K{line}" if now.going_on else "\r\x1b[K")
        elif self._said_s is None or self.clock() - self._said_s >= EVERY_S:
            self._said_s = self.clock()
            self._write(line + "\n")

    def _part(self, now: Compilation) -> str:
        """Return a text that states how much of the compilation is finished."""
        part = self.finished_part()
        if part is None:
            return f"functions compiled so far: {now.ready}"
        ready, needed = part
        return f"{100 * ready // needed} % of {needed} functions"

    def _write(self, text: str) -> None:
        """Write a text to the stream at once."""
        self.stream.write(text)
        self.stream.flush()
