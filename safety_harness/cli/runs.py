"""What is shown of runs: a bar while they last, or a line for each where there is no terminal; results."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from safety_harness.cli.console import result, say
from safety_harness.report.evidence import JudgedRun
from safety_harness.scenario.model import Scenario


def bar_of(unit: str) -> Progress:
    """A bar that counts; disabled where there is no terminal."""
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TextColumn(unit))
    return Progress(
        *columns,
        TimeRemainingColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    )


@dataclass
class ScenarioProgress:
    """A ``bar`` over all scenarios' ticks on a terminal, a line a scenario elsewhere."""

    scenarios: Sequence[Scenario]
    bar: Progress = field(default_factory=lambda: bar_of("ticks"))
    _before: int = 0
    _shown: int = 0

    def __post_init__(self) -> None:
        self._task = self.bar.add_task("", total=sum(s.ticks + 1 for s in self.scenarios))

    def begin(self, number: int) -> None:
        """Scenario ``number`` starts."""
        name = self.scenarios[number].name
        self._before = sum(s.ticks + 1 for s in self.scenarios[:number])
        self._shown = 0
        if self.bar.disable:
            say(f"[{number + 1}/{len(self.scenarios)}] {name}")
        self.bar.update(self._task, description=name, completed=self._before)

    def tick(self, done: int) -> None:
        """``done`` ticks of the current scenario are over; the bar moves every 50."""
        if done - self._shown >= 50:
            self._shown = done
            self.bar.update(self._task, completed=self._before + done)


def say_results(run: JudgedRun) -> None:
    """One line for each claim of a run."""
    for claim, evaluation in run.judged_claims():
        same = evaluation.verdict is claim.expected
        mark = "ok  " if same else "DIFF"
        when = "-" if evaluation.worst_time_s is None else f"{evaluation.worst_time_s:.3f} s"
        expected = "" if same else f"  (expected {claim.expected.value})"
        result(
            f"{mark} {evaluation.verdict.value:<12} {evaluation.margin_text():>13} at {when:>9}  "
            f"{run.trace.scenario.name}: {claim.sentence}{expected}"
        )
