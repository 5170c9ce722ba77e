"""What the command line prints: results on standard output, everything else on standard error."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

from safety_harness.admission.avoiders import command_line_reference, is_a_program
from safety_harness.exceptions import InputError
from safety_harness.report.evidence import JudgedRun
from safety_harness.scenario.files import told
from safety_harness.scenario.model import Scenario
from safety_harness.scenario.references import file_and_name
from safety_harness.trace.provenance import shared_modules

AS_EXPECTED, DIFFERS, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130


def strip_control_chars(text: str) -> str:
    """Without the characters that command a terminal: names of files and traces may come from anybody."""
    return text if text.isprintable() else "".join(c if c.isprintable() or c in "\n\t" else "?" for c in text)


def say(text: str) -> None:
    """A remark on standard error."""
    sys.stderr.write(strip_control_chars(text) + "\n")
    sys.stderr.flush()


def say_shared_modules() -> None:
    """Warn of packages that own the same module: one lies over the other, and nobody knows which runs."""
    for module, packages in shared_modules().items():
        say(f"warning: {' and '.join(packages)} own the module {module}; uninstall all, install one")


def result(text: str) -> None:
    """A line of results on standard output."""
    sys.stdout.write(strip_control_chars(text) + "\n")
    sys.stdout.flush()


def explain(error: Exception) -> None:
    """A user's mistake: where, what was expected, what came, and the hint on a line of its own."""
    if not isinstance(error, InputError):
        say(f"error: {error}")
        return
    say(f"error: {error.place}")
    say(f"  expected {error.expected}")
    say(f"  got      {error.got}")
    if error.hint:
        say(f"  hint     {error.hint}")


def without_repetition(errors: Sequence[InputError]) -> list[InputError]:
    """Each message once: what is wrong in a file that others extend is the same mistake for all of them."""
    return list({str(error): error for error in errors}.values())


def replay_command(scenario: Scenario, trace: Path) -> list[str]:
    """The command that repeats a run; a program of the user's has to be named anew to be executed."""
    command = ["safety-harness", "replay", str(told(trace))]
    if is_a_program(scenario.avoider):
        command += ["--avoider", told_avoider(os.path.abspath(command_line_reference(scenario)))]
    return command


def told_avoider(reference: str) -> str:
    """An avoider as a result names it: its file is ``told``."""
    file, name = file_and_name(reference)
    return str(told(Path(os.path.expanduser(file)))) + (f":{name}" if name else "") if file else reference


@contextmanager
def one_more_ctrl_c(remark: str) -> Iterator[Callable[[], bool]]:
    """Ctrl-C is answered with ``remark``, only the second one raises; yields whether there was one."""
    asked = False

    def note(number: int, frame: FrameType | None) -> None:
        nonlocal asked
        if asked:
            raise KeyboardInterrupt
        asked = True
        say(remark)

    before = signal.signal(signal.SIGINT, note)
    try:
        yield lambda: asked
    finally:
        signal.signal(signal.SIGINT, before)


def result_lines(run: JudgedRun) -> list[str]:
    """One line for each claim of a run."""
    lines = []
    for claim, evaluation in run.judged_claims():
        same = evaluation.verdict is claim.expected
        mark = "ok  " if same else "DIFF"
        when = "-" if evaluation.worst_time_s is None else f"{evaluation.worst_time_s:.3f} s"
        expected = "" if same else f"  (expected {claim.expected.value})"
        lines.append(
            f"{mark} {evaluation.verdict.value:<12} {evaluation.margin_text():>13} at {when:>9}  "
            f"{run.trace.scenario.name}: {claim.sentence}{expected}"
        )
    return lines


@dataclass
class ScenarioProgress:
    """A bar over all scenarios' ticks on a terminal, a line a scenario elsewhere."""

    scenarios: Sequence[Scenario]
    _bar: Progress | None = None
    _task: TaskID | None = None
    _before: int = 0
    _shown: int = field(default=0)

    @contextmanager
    def running(self) -> Iterator[ScenarioProgress]:
        """Show the bar while the runs last."""
        console = Console(stderr=True)
        if not console.is_terminal:
            yield self
            return
        columns = (
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("ticks"),
            TimeRemainingColumn(),
        )
        with Progress(*columns, console=console, transient=True) as self._bar:
            self._task = self._bar.add_task("", total=sum(s.ticks + 1 for s in self.scenarios))
            yield self
        self._bar = None

    def begin(self, number: int) -> None:
        """Scenario ``number`` starts."""
        name = self.scenarios[number].name
        self._before = sum(s.ticks + 1 for s in self.scenarios[:number])
        self._shown = 0
        if self._bar is not None and self._task is not None:
            self._bar.update(self._task, description=name, completed=self._before)
        else:
            say(f"[{number + 1}/{len(self.scenarios)}] {name}")

    def tick(self, done: int) -> None:
        """``done`` ticks of the current scenario are over; the bar moves every 50."""
        if self._bar is not None and self._task is not None and done - self._shown >= 50:
            self._shown = done
            self._bar.update(self._task, completed=self._before + done)
