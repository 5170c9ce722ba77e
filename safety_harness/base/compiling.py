"""What a command is told while functions are compiled: light, so that it asks before numba is loaded."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TextIO

PATIENCE_S, EVERY_S = 1.0, 10.0  # of compiling until anything is said; between two lines where they stay


@dataclass(frozen=True)
class Compilation:
    """How far a process has come: ``ready`` of the ``known`` functions were compiled or loaded.

    ``seconds`` went into compiling; ``going_on`` until the outermost function is done.  ``unwritable`` says
    why no machine code can be kept; empty where it can.
    """

    ready: int
    known: int
    seconds: float
    going_on: bool
    unwritable: str = ""


watchers: list[Callable[[Compilation], None]] = []  # those of this process; its workers have none


@dataclass
class CompilationLine:
    """A line about compilation on ``stream``, if it takes long.

    On a terminal it changes and goes away, elsewhere one comes every ten seconds.
    """

    stream: TextIO
    clock: Callable[[], float] = time.monotonic
    _said_s: float | None = None
    _warned: bool = field(default=False)

    def __call__(self, now: Compilation) -> None:
        """To be one of the ``watchers``."""
        if now.unwritable and not self._warned:
            self._warned = True
            self._write(f"warning: {now.unwritable}\n")
        if now.seconds < PATIENCE_S:
            return
        words = f"compiling the control stack for this machine, once: {now.ready} of at most {now.known} "
        words += f"functions, {now.seconds:.0f} s"
        if self.stream.isatty():
            self._write(f"\r\x1b[K{words}" if now.going_on else "\r\x1b[K")
        elif self._said_s is None or self.clock() - self._said_s >= EVERY_S:
            self._said_s = self.clock()
            self._write(words + "\n")

    def _write(self, text: str) -> None:
        self.stream.write(text)
        self.stream.flush()
