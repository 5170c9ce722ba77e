"""What ``fuzz`` shows while it searches: a line that changes on a terminal, a line now and then elsewhere."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from rich.console import Console
from rich.live import Live
from rich.text import Text

from safety_harness.cli.console import say
from safety_harness.search.findings import Findings
from safety_harness.search.outcomes import Goal


def margin_text(goal: Goal, margin: float) -> str:
    """A margin in the unit that people read."""
    shown = margin * goal.unit.per_si
    number = f"{shown:+.1f}" if abs(shown) >= 1.0 else f"{shown:+.3g}"
    return f"{number} {goal.unit.symbol}".rstrip()


def nearest_lines(findings: Findings) -> list[str]:
    """For each claim how near it came, and how often it was put to the test and violated."""
    lines = []
    for claim, goal in enumerate(findings.goals):
        nearest = findings.nearest[claim]
        near = "no margin yet" if nearest is None else margin_text(goal, float(nearest.margins[claim]))
        counts = f"violated {findings.violated[claim]} of {findings.evidence[claim]} with a verdict"
        lines.append(f"  {near:>14}  {goal.sentence}: {counts}")
    return lines


def summary(findings: Findings, budget: int) -> str:
    """Tried, refused, found."""
    violations = sum(group.claim is not None for group in findings.groups)
    words = (
        f"tried {findings.tried}/{budget}, refused {findings.refused.total()}, {violations} violations apart"
    )
    mishaps = len(findings.groups) - violations
    return words + (f", {mishaps} kinds of mishap" if mishaps else "")


@dataclass
class FuzzProgress:
    """Told of the findings after every batch."""

    budget: int
    _live: Live | None = None
    _said: int = 0

    @contextmanager
    def running(self) -> Iterator[FuzzProgress]:
        """While the search lasts."""
        console = Console(stderr=True)
        if not console.is_terminal:
            yield self
            return
        with Live(console=console, refresh_per_second=4, transient=True) as self._live:
            yield self
        self._live = None

    def show(self, findings: Findings) -> None:
        """On a terminal at once; elsewhere ten times over the budget."""
        if self._live is not None:
            self._live.update(Text("\n".join([summary(findings, self.budget), *nearest_lines(findings)])))
            return
        tenth = findings.tried * 10 // self.budget
        if tenth > self._said:
            self._said = tenth
            say(summary(findings, self.budget))
