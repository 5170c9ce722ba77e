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
from safety_harness.search.trials import Trials


def nearest_lines(findings: Findings) -> list[str]:
    """For each claim how near it came, and how often it was put to the test and violated."""
    lines = []
    for claim, goal in enumerate(findings.goals):
        nearest = findings.nearest[claim]
        near = "no margin yet" if nearest is None else goal.margin_text(float(nearest.margins[claim]))
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


def remarks(trials: Trials, findings: Findings) -> list[str]:
    """What a reader would otherwise get wrong."""
    lines = [f"{count} points refused: {reason}" for reason, count in findings.refused.most_common(3)]
    for claim, goal in enumerate(findings.goals):
        if findings.always_violated(claim):
            lines.append(f"every run violates {goal.sentence!r}: it is the claim or the space, no corner")
        elif findings.tried and not findings.evidence[claim]:
            lines.append(f"no run put {goal.sentence!r} to the test: nothing is known of it")
    if not findings.found and findings.tried:
        lines.append(
            f"nothing found in {findings.tried} runs. A search estimates nothing: that is no evidence of "
            "safety in the rest of the space"
        )
    lines.append("coverage: " + str(trials.coverage).replace("\n", "\n  "))
    return lines


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
