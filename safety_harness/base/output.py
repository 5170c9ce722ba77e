"""Where a job's words go while it works: a command prints them, a program need not hear them."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass

AS_EXPECTED, DIFFERS, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130  # exit codes


def _ignore(*lines: str) -> None:
    """Say nothing."""


@contextmanager
def _no_block() -> Iterator[Callable[[list[str]], None]]:
    yield lambda lines: None


@contextmanager
def _no_count(total: int, unit: str) -> Iterator[Callable[..., None]]:
    yield lambda done, words="", at="": None


@dataclass(frozen=True, kw_only=True)
class Output:
    """The functions that hear of a job's progress; those that are left out hear nothing.

    Args:
        say: Takes lines of remarks, also none.
        result: Takes lines of results.
        detail: Takes lines on each part of the work, which a command prints with --verbose.
        explain: Takes an InputError about an input that is left out.
        block: Opens a context; its value takes the lines that say where the job is.
        counting: Opens a context for a total and its unit; its value takes how many are done, in words what
            comes next, and before these the number of the part (``at``).

    """

    say: Callable[..., None] = _ignore
    result: Callable[..., None] = _ignore
    detail: Callable[..., None] = _ignore
    explain: Callable[[Exception], None] = lambda error: None
    block: Callable[[], AbstractContextManager[Callable[[list[str]], None]]] = _no_block
    counting: Callable[[int, str], AbstractContextManager[Callable[..., None]]] = _no_count

    @classmethod
    def to(cls, each_line: Callable[[str], object]) -> Output:
        """Return the output that hands each line to one function, such as ``print``."""

        def hear(*lines: str) -> None:
            for line in lines:
                each_line(line)

        return cls(say=hear, result=hear, detail=hear)

    @contextmanager
    def words(self) -> Iterator[Callable[[str], None]]:
        """Yield what takes in words what comes next, where nobody knows how much that is."""
        with self.block() as show:
            yield lambda words: show([words])

    @contextmanager
    def steps(self) -> Iterator[Callable[[str, float], None]]:
        """Yield what takes which step comes next, and what share of all is done."""
        begun_s = time.monotonic()
        with self.block() as show:
            yield lambda words, share: show([words + where(share, 1.0, begun_s)])


QUIET = Output()


def where(done: float, total: float, begun_s: float) -> str:
    """``, 30 %, 25 s left``; nothing at the start, and at the end how long it took."""
    spent_s = time.monotonic() - begun_s
    if done <= 0 or total <= 0:
        return ""
    if done >= total:
        return f", 100 %, {time_words(spent_s)}"
    return f", {int(100 * done / total)} %, {time_left(spent_s * (total / done - 1.0))}"


def time_left(seconds: float) -> str:
    """Return words for the time that is left."""
    return f"{time_words(seconds)} left" if math.isfinite(seconds) else "time left unknown"


def time_words(seconds: float) -> str:
    """Whole seconds, minutes, or hours with a tenth."""
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h"
