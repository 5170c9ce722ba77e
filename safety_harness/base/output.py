"""The output of a job while it works.

A command prints this output, and a program may ignore it.
"""

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
    """Yield a function that ignores the progress that is passed to it.

    ``total`` and ``unit`` have no effect.
    """
    yield lambda done, message="", at="": None


@dataclass(frozen=True, kw_only=True)
class Output:
    """A set of functions that receive the output of a job.

    The defaults ignore all output.

    Args:
        say: Receives zero or more lines of remarks.
        result: Receives lines of results.
        detail: Receives lines about the parts of the work, which a command prints only with --verbose.
        explain: Receives an InputError about an input that was skipped.
        block: Returns a context that yields a function.  The job calls this function with lines on its
            current step.
        counting: Takes a total and its unit, and returns a context that yields a function.  The job calls
            this function with the number of finished items, a text on the next item, and the number of the
            part (``at``).

    """

    say: Callable[..., None] = _ignore
    result: Callable[..., None] = _ignore
    detail: Callable[..., None] = _ignore
    explain: Callable[[Exception], None] = lambda error: None
    block: Callable[[], AbstractContextManager[Callable[[list[str]], None]]] = _no_block
    counting: Callable[[int, str], AbstractContextManager[Callable[..., None]]] = _no_count

    @classmethod
    def to(cls, each_line: Callable[[str], object]) -> Output:
        """Return an output that passes every line to the same function, such as ``print``.

        Args:
            each_line: A function that receives one line of remarks or results.

        """

        def hear(*lines: str) -> None:
            for line in lines:
                each_line(line)

        return cls(say=hear, result=hear, detail=hear)

    @contextmanager
    def messages(self) -> Iterator[Callable[[str], None]]:
        """Yield a function that receives a text about the next step, for work of unknown length."""
        with self.block() as show:
            yield lambda step: show([step])

    words = messages  # deprecated: the old name, for one release

    @contextmanager
    def steps(self) -> Iterator[Callable[[str, float], None]]:
        """Yield a function that receives a text about the next step, and the finished fraction."""
        pace = Pace()
        with self.block() as show:
            yield lambda step, share: show([step + where(share, 1.0, pace)])


QUIET = Output()


def where(done: float, total: float, pace: Pace) -> str:
    """Return progress as text, such as ``, 30 %, 25 s left``.

    The text is empty at the start, and states the total time at the end.

    Args:
        done: The finished amount, in the unit of ``total``.
        total: The total amount.
        pace: An object that computes the rate of progress, which gives the remaining time.

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
    """Return a text on the remaining time."""
    return f"{time_words(seconds)} left"


def time_words(seconds: float) -> str:
    """Return a duration as text: whole seconds, whole minutes, or hours with one decimal."""
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h"
