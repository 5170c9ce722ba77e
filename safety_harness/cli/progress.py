"""What long commands show: lines that change on a terminal; elsewhere a line every ten seconds.

Elsewhere is a pipe, a file, or a terminal that is to get no escape codes.  It is told where a command is at
the start, at most every ten seconds, and at the end, with the share that is done and the time that is left.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.live import Live
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.text import Text

from safety_harness.cli.console import no_escapes, say
from safety_harness.scenario.model import Scenario

if TYPE_CHECKING:  # searches take a second to import
    from safety_harness.search.findings import Findings

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


@contextmanager
def one_line() -> Iterator[Callable[[str], None]]:
    """Yields what shows one line that changes."""
    with block() as show:
        yield lambda line: show([line])


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
            yield lambda done, words="": bar.update(task, completed=done, description=words)
        return
    begun_s = time.monotonic()
    with paced_lines() as tell:

        def told(done: int, words: str = "") -> None:
            tell(f"{words or f'{done:,}/{total:,} {unit}'}{where(done, total, begun_s)}")

        yield told


def where(done: float, total: float, begun_s: float) -> str:
    """``, 30 %, 25 s left``; nothing at the start, and at the end how long it took."""
    spent_s = time.monotonic() - begun_s
    if done <= 0 or total <= 0:
        return ""
    if done >= total:
        return f", 100 %, {time_words(spent_s)}"
    return f", {int(100 * done / total)} %, {time_left(spent_s * (total / done - 1.0))}"


@dataclass
class RunsShown:
    """Which of several scenarios is run, and how far it is."""

    scenarios: Sequence[Scenario]
    show: Callable[..., None]
    _before: int = 0
    _shown: int = 0
    _words: str = ""
    _ticks: int = field(default=0, init=False)

    def begin(self, number: int) -> None:
        """Scenario ``number`` starts."""
        name = self.scenarios[number].name
        self._before = sum(s.ticks + 1 for s in self.scenarios[:number])
        self._ticks, self._shown = self.scenarios[number].ticks + 1, 0
        self._words = name if is_live() else f"[{number + 1}/{len(self.scenarios)}] {name}"
        self.show(self._before, self._words)

    def tick(self, done: int) -> None:
        """``done`` ticks of the current scenario are over; shown every 50, and at its end."""
        if done - self._shown >= 50 or done >= self._ticks:
            self._shown = done
            self.show(self._before + done, self._words)


@contextmanager
def watching_runs(scenarios: Sequence[Scenario]) -> Iterator[RunsShown]:
    """Yields what is told which scenario is run, and of its ticks."""
    with counting(sum(s.ticks + 1 for s in scenarios), "ticks") as show:
        yield RunsShown(scenarios, show)


@contextmanager
def watching_search(budget: int) -> Iterator[Callable[[Findings], None]]:
    """Yields what is told of the findings after every batch."""
    from safety_harness.search.session import nearest_lines, summary

    begun_s = time.monotonic()
    with block() as show:
        show([f"tried 0/{budget}"])
        yield lambda findings: show(
            [summary(findings, budget) + where(findings.tried, budget, begun_s), *nearest_lines(findings)]
        )


@contextmanager
def watching_words() -> Iterator[Callable[[str], None]]:
    """Yields what is told in words what comes next, where nobody knows how much that is."""
    with block() as show:
        yield lambda words: show([words])


@contextmanager
def watching_steps() -> Iterator[Callable[[str, float], None]]:
    """Yields what is told which step comes next, and what share of all is done."""
    begun_s = time.monotonic()
    with block() as show:
        yield lambda words, share: show([words + where(share, 1.0, begun_s)])


def time_left(seconds: float) -> str:
    """Return words for the time that is left."""
    return f"{time_words(seconds)} left" if math.isfinite(seconds) else "time left unknown"


def time_words(seconds: float) -> str:
    """Whole seconds, minutes, or hours with a tenth."""
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h"
