"""Progress of compilation as a command prints it; this module is light, so it is imported before numba."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TextIO

PATIENCE_S, EVERY_S = 1.0, 10.0  # seconds before the first line, and between two lines in a file


@dataclass(frozen=True)
class Compilation:
    """The progress of a process that has compiled or loaded ``ready`` functions.

    Args:
        ready: Functions with machine code.
        seconds: Time spent on compiling.
        going_on: Whether the outermost function is still being compiled.
        unwritable: Why the process cannot keep machine code; empty if it can.

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
    """The rate of a job since the last compilation in this process, so that estimates leave compilation out.

    The first finished item only starts the measurement, because some process may have loaded or compiled code
    for it.
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
    """A line about a long compilation, printed on ``stream``.

    On a terminal the line is updated, and disappears at the end.  In a file, a new line appears every ten
    seconds.  While ``finished_part`` is unknown, the line has no percentage.

    Args:
        stream: Where the line is printed.
        finished_part: A function that returns the functions in the cache and all that a run needs.
        clock: A clock in seconds.

    """

    stream: TextIO
    finished_part: Callable[[], tuple[int, int] | None] = lambda: None
    clock: Callable[[], float] = time.monotonic
    _said_s: float | None = None
    _warned: bool = field(default=False)

    def __call__(self, now: Compilation) -> None:
        """Print the progress ``now``; this method is one of the ``watchers``."""
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
        """Return the finished part in words."""
        part = self.finished_part()
        if part is None:
            return f"functions compiled so far: {now.ready}"
        ready, needed = part
        return f"{100 * ready // needed} % of {needed} functions"

    def _write(self, text: str) -> None:
        """Write a text to the stream at once."""
        self.stream.write(text)
        self.stream.flush()
