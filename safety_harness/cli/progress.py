"""What long commands show: lines that change on a terminal; elsewhere a line every ten seconds.

Elsewhere is a pipe, a file, or a terminal that is to get no escape codes.  It is told where a command is at
the start, at most every ten seconds, and at the end, with the share that is done and the time that is left.
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
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.text import Text

from safety_harness.base.output import Output, where
from safety_harness.cli.console import explain, no_escapes, result, say

EVERY_S = 10.0


def is_live() -> bool:
    """May lines change on standard error?"""
    return sys.stderr is not None and sys.stderr.isatty() and not no_escapes()


@dataclass
class PacedLines:
    """Says a line when it is due; the others make room for the next, and the last is said at the end."""

    now_s: Callable[[], float] = time.monotonic
    _said_s: float = -math.inf
    _waiting: str = ""

    def tell(self, line: str) -> None:
        """A line that says where a command is."""
        self._waiting = line
        if self.now_s() - self._said_s >= EVERY_S:
            self.end()

    def end(self) -> None:
        """Say what was not said."""
        if self._waiting:
            say(self._waiting)
        self._waiting, self._said_s = "", self.now_s()


@contextmanager
def paced_lines() -> Iterator[Callable[[str], None]]:
    """Yields what is told lines that a log needs few of; a terminal gets them all."""
    if is_live():
        yield say
        return
    lines = PacedLines()
    try:
        yield lines.tell
    finally:
        lines.end()


@contextmanager
def block() -> Iterator[Callable[[list[str]], None]]:
    """Yields what shows lines on a terminal; elsewhere the first of them, where that is due."""
    if is_live():
        with Live(**_shown(), refresh_per_second=4) as live:
            yield lambda lines: live.update(Text("\n".join(lines)))
    else:
        with paced_lines() as tell:
            yield lambda lines: tell(lines[0])


def _shown() -> dict[str, Any]:
    """On standard error, and results above it; those that go to a file are left alone."""
    results = sys.stdout is not None and sys.stdout.isatty()
    return {"console": Console(stderr=True), "transient": True, "redirect_stdout": results}


@contextmanager
def counting(total: int, unit: str) -> Iterator[Callable[..., None]]:
    """Yields what is told how many of ``total`` are done, and in words what comes next: a bar, or lines."""
    if is_live():
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TextColumn(unit))
        with Progress(*columns, TimeRemainingColumn(), **_shown()) as bar:
            task = bar.add_task("", total=total)
            yield lambda done, words="", at="": bar.update(task, completed=done, description=words)
        return
    begun_s = time.monotonic()
    with paced_lines() as tell:

        def told(done: int, words: str = "", at: str = "") -> None:
            tell(f"{at}{words or f'{done:,}/{total:,} {unit}'}{where(done, total, begun_s)}")

        yield told


TERMINAL = Output(say=say, result=result, explain=explain, block=block, counting=counting)
VERBOSE = replace(TERMINAL, detail=result)


def terminal(verbose: bool) -> Output:
    """Return where a command's words go; with ``verbose`` lines on each part of the work as well."""
    return VERBOSE if verbose else TERMINAL
