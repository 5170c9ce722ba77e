"""Output of a job during its work, which a command prints and a program may ignore."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass

from safety_harness.base.compiling import Pace

AS_EXPECTED, DIFFERS, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130  # exit codes


def _ignore(*lines: str) -> None:
    """Ignore all lines."""


@contextmanager
def _no_block() -> Iterator[Callable[[list[str]], None]]:
    """Yield a function that ignores the lines passed to it."""
    yield lambda lines: None


@contextmanager
def _no_count(total: int, unit: str) -> Iterator[Callable[..., None]]:
    """Yield a function that ignores the progress; ``total`` and ``unit`` have no effect."""
    yield lambda done, message="", at="": None


@dataclass(frozen=True, kw_only=True)
class Output:
    """The functions that receive a job's progress; the defaults ignore it.

    Args:
        say: Receives lines of remarks, or no line.
        result: Receives lines of results.
        detail: Receives lines on each part of the work, which a command prints with --verbose.
        explain: Receives an InputError about a skipped input.
        block: Returns a context that yields a function.  This function receives the lines with the job's
            current step.
        counting: Returns a context, for a total and its unit, that yields a function.  This function receives
            the number of finished items, the next item in words, and the number of the part (``at``).

    """

    say: Callable[..., None] = _ignore
    result: Callable[..., None] = _ignore
    detail: Callable[..., None] = _ignore
    explain: Callable[[Exception], None] = lambda error: None
    block: Callable[[], AbstractContextManager[Callable[[list[str]], None]]] = _no_block
    counting: Callable[[int, str], AbstractContextManager[Callable[..., None]]] = _no_count

    @classmethod
    def to(cls, each_line: Callable[[str], object]) -> Output:
        """Return the output that passes each line to one function, such as ``print``.

        Args:
            each_line: Receives one line of remarks or results.

        """

        def hear(*lines: str) -> None:
            for line in lines:
                each_line(line)

        return cls(say=hear, result=hear, detail=hear)

    @contextmanager
    def messages(self) -> Iterator[Callable[[str], None]]:
        """Yield a function that receives the next step in words, for work of unknown length."""
        with self.block() as show:
            yield lambda step: show([step])

    words = messages  # deprecated: the old name, for one release

    @contextmanager
    def steps(self) -> Iterator[Callable[[str, float], None]]:
        """Yield a function that receives the next step in words and the finished share (0 to 1)."""
        pace = Pace()
        with self.block() as show:
            yield lambda step, share: show([step + where(share, 1.0, pace)])


QUIET = Output()


def where(done: float, total: float, pace: Pace) -> str:
    """Return progress as text, such as ``, 30 %, 25 s left``.

    The text is empty at the start, and states the total time at the end.

    Args:
        done: The finished amount, in the unit of ``total``.
        total: The whole amount.
        pace: Computes the rate, from which the remaining time follows.

    """
    rate = pace.rate(done)
    if done <= 0 or total <= 0:
        return ""
    if done >= total:
        return f", 100 %, {time_words(pace.now_s() - pace.begun_s)}"
    return f", {int(100 * done / total)} %" + (
        "" if rate is None else f", {time_left((total - done) / rate)}"
    )


def time_left(seconds: float) -> str:
    """Return the remaining time in words."""
    return f"{time_words(seconds)} left"


def time_words(seconds: float) -> str:
    """Return a duration in words: whole seconds, whole minutes, or hours with one decimal."""
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h"
