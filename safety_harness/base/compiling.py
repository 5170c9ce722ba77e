"""Progress of compilation, as a command prints it; light, so that it comes before numba loads."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TextIO

PATIENCE_S, EVERY_S = 1.0, 10.0  # before the first line; between two lines of a file


@dataclass(frozen=True)
class Compilation:
    """The progress of a process: it has compiled or loaded ``ready`` of the ``known`` functions.

    Args:
        ready: Functions with machine code.
        known: Functions that the process may compile.
        seconds: Time spent on compiling.
        going_on: Whether the outermost function still compiles.
        unwritable: Why the process cannot keep machine code; empty if it can.

    """

    ready: int
    known: int
    seconds: float
    going_on: bool
    unwritable: str = ""


watchers: list[Callable[[Compilation], None]] = []  # those of this process; its workers have none


class Compiled:
    """The ``count`` of functions that this process has compiled."""

    count = 0


@dataclass
class Pace:
    """The rate of a job since it last compiled machine code, so that no estimate contains a compilation.

    The first finished item, which may have loaded or compiled code in any process, counts only as a start.
    """

    now_s: Callable[[], float] = time.monotonic
    begun_s: float = field(init=False)
    _since: tuple[float, float] | None = None
    _compiled: int = 0

    def __post_init__(self) -> None:
        self.begun_s = self.now_s()

    def rate(self, done: float) -> float | None:
        """Return the finished items a second, or None while they are unknown."""
        now_s = self.now_s()
        if self._since is None or self._compiled != Compiled.count:
            self._compiled, self._since = Compiled.count, (now_s, done) if done > 0.0 else None
            return None
        since_s, since_count = self._since
        return (done - since_count) / (now_s - since_s) if done > since_count and now_s > since_s else None


@dataclass
class CompilationLine:
    """A line about a long compilation on ``stream``.

    On a terminal the line changes and goes away; in a file there is a new line every ten seconds.
    """

    stream: TextIO
    clock: Callable[[], float] = time.monotonic
    _said_s: float | None = None
    _warned: bool = field(default=False)

    def __call__(self, now: Compilation) -> None:
        """Print the progress ``now``, as a member of the ``watchers``."""
        if now.unwritable and not self._warned:
            self._warned = True
            self._write(f"warning: {now.unwritable}\n")
        if now.seconds < PATIENCE_S:
            return
        line = f"compiling the control stack for this machine, once: {now.ready} of at most {now.known} "
        line += f"functions, {now.seconds:.0f} s"
        if self.stream.isatty():
            self._write(f"\r\x1b[K{line}" if now.going_on else "\r\x1b[K")
        elif self._said_s is None or self.clock() - self._said_s >= EVERY_S:
            self._said_s = self.clock()
            self._write(line + "\n")

    def _write(self, text: str) -> None:
        """Write a text to the stream at once."""
        self.stream.write(text)
        self.stream.flush()
