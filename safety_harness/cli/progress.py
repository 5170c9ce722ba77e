"""Show the progress of long commands.

On a terminal, lines change in place, and anywhere else a new line appears every ten seconds.  "Anywhere else"
means a pipe, a file, or a terminal without escape codes.  A command then prints a line at the start, further
lines at intervals of at least ten seconds, and a line at the end.  Each line states the finished percentage.
It also states the remaining time, unless code was compiled since the previous line.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

from rich.console import Console
from rich.live import Live
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
from rich.text import Text

from safety_harness.base.compiling import Pace, watchers
from safety_harness.base.output import Output, where
from safety_harness.cli.console import explain, no_escapes, result, say

EVERY_S = 10.0  # between two lines in a log; a choice


def is_live() -> bool:
    """Return whether lines on standard error may be redrawn in place."""
    return sys.stderr is not None and sys.stderr.isatty() and not no_escapes()


@dataclass
class PacedLines:
    """A printer that prints at most one line in ten seconds.

    A new line replaces an earlier line that was not yet printed, and the last line is always printed at the
    end.
    """

    now_s: Callable[[], float] = time.monotonic
    _said_s: float = -math.inf
    _waiting: str = ""

    def take(self, line: str) -> None:
        """Accept ``line``, a line on progress, and print it if the last printed line is old enough."""
        self._waiting = line
        if self.now_s() - self._said_s >= EVERY_S:
            self.end()

    def end(self) -> None:
        """Print the latest line, unless it was already printed."""
        if self._waiting:
            say(self._waiting)
        self._waiting, self._said_s = "", self.now_s()


@contextmanager
def paced_lines() -> Iterator[Callable[[str], None]]:
    """Yield a function that prints lines on progress.

    On a terminal it prints every line, and in a log only few lines.
    """
    if is_live():
        yield say
        return
    lines = PacedLines()
    try:
        yield lines.take
    finally:
        lines.end()


@contextmanager
def block() -> Iterator[Callable[[list[str]], None]]:
    """Yield a function that shows several lines.

    On a terminal, the function redraws the lines in place. In a log, it prints only the first line, at most
    once in ten seconds.
    """
    if is_live():
        live = Live(**_shown(), refresh_per_second=4)
        with live, at_compilation(lambda: live.update(Text())):
            yield lambda lines: live.update(Text("\n".join(lines)))
    else:
        with paced_lines() as print_line:
            yield lambda lines: print_line(lines[0])


def _shown() -> dict[str, Any]:
    """Return the settings of a live display on standard error.

    If results go to the same terminal, they appear above the display.
    """
    results = sys.stdout is not None and sys.stdout.isatty()
    return {"console": Console(stderr=True), "transient": True, "redirect_stdout": results}


@contextmanager
def counting(total: int, unit: str) -> Iterator[Callable[..., None]]:
    """Yield a function that shows progress.

    Its arguments are the number of finished items and a message on the next step.
    """
    pace = Pace()
    if is_live():
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TextColumn(unit))
        with Progress(*columns, TextColumn("{task.fields[share]}"), **_shown()) as bar:
            task = bar.add_task("", total=total, share="")

            def moved(done: int, message: str = "", at: str = "") -> None:
                share = where(done, total, pace).removeprefix(", ")
                bar.update(task, completed=done, description=message, share=share)

            with at_compilation(lambda: bar.update(task, share="")):
                yield moved
        return
    with paced_lines() as print_line:

        def print_step(done: int, message: str = "", at: str = "") -> None:
            print_line(f"{at}{message or f'{done:,}/{total:,} {unit}'}{where(done, total, pace)}")

        yield print_step


@contextmanager
def at_compilation(clear: Callable[[], None]) -> Iterator[None]:
    """Call ``clear`` after each compilation, which makes the displayed remaining time wrong."""
    watchers.append(watcher := lambda now: clear())
    try:
        yield
    finally:
        watchers.remove(watcher)


TERMINAL = Output(say=say, result=result, explain=explain, block=block, counting=counting)
VERBOSE = replace(TERMINAL, detail=result)


def terminal(verbose: bool) -> Output:
    """Return the output of a command in a terminal.

    If ``verbose`` is true, this output also prints details.
    """
    return VERBOSE if verbose else TERMINAL
