"""``safety-harness run``: scenario files in, verdicts and a report out."""

from __future__ import annotations

import os
import shlex
import sys
import time
import traceback
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from itertools import count
from pathlib import Path
from types import FunctionType
from typing import Any

from safety_harness.admission.admit import Admitted, admit
from safety_harness.admission.avoiders import (
    command_line_reference,
    option_of,
    replay_command,
    told_avoider,
)
from safety_harness.admission.repeatability import Repeatability, RepeatabilityResult
from safety_harness.admission.taking import NotTaken, made_equal, not_taken_words, taken
from safety_harness.admission.trial import run_trial
from safety_harness.base.exceptions import InputError, OutputError, SafetyHarnessError
from safety_harness.base.extension_points import ExtensionPoint, part_named
from safety_harness.base.extras import LOGS
from safety_harness.base.interrupts import one_more_ctrl_c
from safety_harness.base.whole_file import writing
from safety_harness.cell.simulation.worlds import REFERENCE, WorldEntry
from safety_harness.claims.properties.against import Against, RunDifference
from safety_harness.claims.properties.tally import far_lines, table_lines, untested_lines
from safety_harness.claims.properties.tried import TriedParts
from safety_harness.cli.console import (
    AS_EXPECTED,
    BAD_INPUT,
    DIFFERS,
    INTERRUPTED,
    columns_of,
    document,
    explain,
    explain_each,
    result,
    say,
    say_shared_modules,
    usable,
)
from safety_harness.cli.progress import RunsShown, watching_runs
from safety_harness.cli.run_processes import RunProcesses, run_processes
from safety_harness.report.decisions import (
    DecisionTally,
    computing_time_lines,
    fault_notes,
    overruling_lines,
    overruling_of_each,
)
from safety_harness.report.evidence import JudgedRun, basis_of, notes_of, tallies
from safety_harness.report.possible_hands import possible_lines
from safety_harness.report.shielding import shield_lines
from safety_harness.report.words import tested_words
from safety_harness.scenario.expand import gather
from safety_harness.scenario.files import told
from safety_harness.scenario.model import Scenario, Verdict
from safety_harness.scenario.ours import aside_lines
from safety_harness.trace.store import save_trace

REPORT, DATA = "report.html", "report.json"
TRACES, OF_REFERENCE, EARLIER = "traces", "traces-against", ".earlier"
KINDS = "*.trace", "*/run.mcap", "*/LOG.yaml"


def read_all(
    paths: Sequence[Path],
    avoider: str | None = None,
    against: str | None = None,
    world: WorldEntry = REFERENCE,
) -> tuple[list[list[Admitted]], list[NotTaken], list[InputError]]:
    """Read and admit everything, with another avoider if one is given, and with the reference as well.

    All mistakes, not only the first, and what the avoiders given here cannot take.  InstallationError if
    there is something to run, and the world is not installed.
    """

    def take(one: Scenario) -> list[Admitted] | NotTaken:
        world.refuse(one)
        return equal.get(one.name) or taken(one, avoiders, admit)

    gathered = gather(paths)
    say(*aside_lines(gathered.aside))
    if gathered.scenarios:
        world.opener()
    avoiders = [(avoider, option_of(avoider or ""))] + ([] if against is None else [(against, "--against")])
    equal = made_equal(gathered.scenarios, *avoiders[0])
    found, errors = usable(gathered.scenarios, take)
    return (
        [one for one in found if not isinstance(one, NotTaken)],
        [one for one in found if isinstance(one, NotTaken)],
        [*gathered.errors, *errors],
    )


def run(
    paths: Sequence[Path],
    out: Path,
    avoider: str | None = None,
    against: str | None = None,
    *,
    world: WorldEntry = REFERENCE,
    keep_going: bool = False,
    jobs: int | None = None,
    mcap: bool = False,
) -> int:
    """Run in ``world``, judge, print, save and report; returns the exit code.

    InstallationError as of ``read_all``.  ``keep_going``: what cannot be used is told and
    counted, and the rest is run.  ``jobs``: as of ``run_processes``.
    """
    say_shared_modules()
    if mcap:
        LOGS.require("--mcap")
        part_named(ExtensionPoint.RUN_FORMATS, "mcap", FunctionType)
    try:
        admitted, skipped, errors = read_all(paths, avoider, against, world)
    except KeyboardInterrupt:
        say("interrupted: nothing was run")
        return INTERRUPTED
    if skipped and not admitted:
        errors += [one.error for one in skipped]
    refused = explain_each(errors)
    if refused and not (keep_going and admitted):
        go_on = "; --keep-going runs the others" if admitted else ""
        say(f"{len(refused)} of the inputs cannot be used; nothing was run{go_on}.")
        return BAD_INPUT
    for folder in (TRACES, *[OF_REFERENCE] * (against is not None)):
        with writing(out / folder):
            (out / folder).mkdir(parents=True, exist_ok=True)
    again = ["safety-harness", "run", *(str(told(path)) for path in paths), "--out", str(told(out))]
    named = {option_of(avoider or ""): avoider, "--against": against}
    again += ["--keep-going"] * keep_going + ["--mcap"] * mcap
    again += [word for option, one in named.items() if one for word in (option, told_avoider(one))]
    again += [] if world is REFERENCE else ["--world", world.label]
    session = RunSession(out, shlex.join(again), len(admitted), skipped, refused, world, mcap=mcap)
    if against is not None:
        mine = "what each file names" if avoider is None else told_avoider(avoider)
        session.against = Against(mine=mine, reference=told_avoider(against), runs=session.differences)
    say(*(f"skipped: {one}" for one in skipped))
    session.run_all(admitted, jobs)
    return session.finish()


@dataclass
class RunSession:
    """The runs of one command: what came out, and whether they came to an end.

    ``against`` holds their ``differences`` from the runs with a reference, if there is one.
    """

    out: Path
    command: str
    planned: int
    skipped: Sequence[NotTaken] = ()
    refused: Sequence[InputError] = ()  # of inputs that did not keep the others from running
    world: WorldEntry = REFERENCE
    against: Against | None = None
    mcap: bool = False
    differences: list[RunDifference] = field(default_factory=list)
    runs: list[JudgedRun] = field(default_factory=list)
    failed: list[str] = field(default_factory=list)  # scenarios that could not be simulated, and why
    interrupted: bool = False
    unwritable: OutputError | None = None
    repeatability: Repeatability = field(default_factory=Repeatability)
    repeated: RepeatabilityResult | None = None  # None: not asked again
    begun_s: float = field(default_factory=lambda: time.time() - 0.1)  # clocks of disks are coarse
    written: set[Path] = field(default_factory=set)  # whatever the disk says of when

    def run_all(self, admitted: Sequence[Sequence[Admitted]], jobs: int | None = 1) -> None:
        """In their order, each with the reference too, until Ctrl-C or a disk that takes no more."""
        flat = [one for each in admitted for one in each]
        with (
            watching_runs([one.scenario for one in flat]) as progress,
            run_processes(flat, self.world, jobs) as apart,
        ):
            for number, (one, *others) in enumerate(admitted):
                progress.begin(number * (1 + len(others)))
                name = one.scenario.name
                try:
                    self._take(self._run_one(one, apart, TRACES, progress))
                    for other in others[: not self.interrupted]:
                        progress.begin(2 * number + 1)
                        name += f" with {command_line_reference(other.scenario)}"
                        self._compare(self._run_one(other, apart, OF_REFERENCE, progress))
                except KeyboardInterrupt:
                    self._take_finished(admitted[number:], apart, progress)
                    self.interrupted = True
                except OutputError as error:
                    self.unwritable = error
                except Exception as error:  # one scenario's failure must not cost the others' evidence
                    self._fail(name, error)
                if self.interrupted or self.unwritable is not None:
                    return

    def _run_one(self, one: Admitted, apart: RunProcesses, folder: str, progress: RunsShown) -> JudgedRun:
        """Simulate, here or in another process, save, judge."""
        trace = apart.trace(one) or run_trial(one, world=apart.world, on_tick=progress.tick)
        file = self.out / folder / f"{one.scenario.name}.trace"
        with writing(file):
            save_trace(trace, file)
        self.written.add(file)
        evaluations = tuple(prop.evaluate(trace) for prop in one.properties)
        if self.mcap:
            write_mcap = part_named(ExtensionPoint.RUN_FORMATS, "mcap", FunctionType)
            write_mcap(trace, evaluations, file.with_name(one.scenario.name) / "run.mcap")
            self.written.add(file.with_name(one.scenario.name))
        return JudgedRun(
            trace=trace,
            evaluations=evaluations,
            replay_command=replay_command(one.scenario, file),
            trace_file=file,
            notes=notes_of(one.scenario),
        )

    def _take_finished(
        self, left: Sequence[Sequence[Admitted]], apart: RunProcesses, progress: RunsShown
    ) -> None:
        """After Ctrl-C what has come to its end in other processes."""
        for one, *_ in left if self.against is None else ():
            if apart.is_done(one):
                with suppress(Exception):
                    self._take(self._run_one(one, apart, TRACES, progress))

    def _take(self, judged: JudgedRun) -> None:
        self.runs.append(judged)
        self.repeatability.add(judged.trace)
        if self.against is None:
            say_results(judged)
        say(*(f"note: {judged.trace.scenario.name}: {note}" for note in fault_notes(judged.trace)))
        say(*(f"note: {line}" for line in TriedParts.of(judged.trace).lines()))
        self.interrupted = not judged.trace.complete

    def _compare(self, reference: JudgedRun) -> None:
        """The last run with that of the reference; only what the reference does not do is a result."""
        assert self.against is not None
        mine, self.interrupted = self.runs[-1], not reference.trace.complete
        if not self.interrupted:
            pairs = zip(mine.evaluations, reference.evaluations, strict=True)
            self.differences.append(RunDifference.of(mine.trace, reference.trace, pairs))
            result(*self.differences[-1].lines(self.against.reference))

    def _fail(self, name: str, error: Exception) -> None:
        self.failed.append(f"{name} could not be run to its end: {type(error).__name__}: {error}")
        say(f"error: {self.failed[-1]}")
        if not isinstance(error, SafetyHarnessError):
            say(traceback.format_exc().rstrip())
            say("This is a defect of safety-harness, not of your file; the other scenarios are not affected.")

    def finish(self) -> int:
        """Write the report, sum up, choose the exit code."""
        self._rename_earlier()
        if self.unwritable is not None:
            explain(self.unwritable)
        if self.interrupted or self.unwritable is not None:
            kept = f"the results of {len(self.runs)} of {self.planned} scenarios are kept"
            say(f"stopped before the end: {kept}")
        self._ask_again()
        if self.runs and not self._report():
            return INTERRUPTED if self.interrupted else BAD_INPUT
        untested = self._say_coverage()
        say(*[basis_of(self.runs)] * bool(self.runs))
        times = computing_time_lines(run.trace for run in self.runs)
        say(*(f"computing time: {line}" for line in times))
        say(*(f"shield: {line}" for line in shield_lines(run.trace for run in self.runs)))
        say(*(f"gate: {line}" for line in possible_lines(run.trace for run in self.runs)))
        say(*overruling_lines(overruling_of_each(run.trace for run in self.runs)))
        every = [same for one in self.runs for same in zip(one.as_expected, one.applicable, strict=True)]
        verdicts = [same for same, applicable in every if applicable]
        others = len(every) - len(verdicts)
        fallback = DecisionTally.of(one.trace for one in self.runs).fallback
        say(
            f"{sum(verdicts)} of {len(verdicts)} verdicts as expected, "
            f"{len(self.runs)} of {self.planned + len(self.skipped)} scenarios run"
            + (f", {others} claims not applicable to the controller" if others else "")
            + (f", {not_taken_words(self.skipped)}" if self.skipped else "")
            + (f", {len(self.refused)} of the inputs cannot be used" if self.refused else "")
            + (f"; {fallback}" if fallback else "")
        )
        if self.against is not None:
            result(*self.against.lines())
        if self.runs:
            say(f"report: {self.out / REPORT} (for programs: {DATA})")
        self._say_whose_fault()
        if self.unwritable is not None:
            return BAD_INPUT
        if self.interrupted:
            return INTERRUPTED
        if self.refused:
            return BAD_INPUT
        if self.against is None:
            good = all(verdicts) and bool(verdicts or not others) and not (untested or self.skipped)
        else:  # what cannot be compared differs in nothing
            good = len(self.differences) == self.planned and not self.against.worse
        good &= self.repeated is None or not self.repeated.problem
        return AS_EXPECTED if good and not self.failed else DIFFERS

    def _rename_earlier(self) -> None:
        """Traces of earlier runs stay, by names that no folder or pattern takes for evidence of this one."""
        kinds = [f"{at}/{kind}" for at in (TRACES, OF_REFERENCE) for kind in KINDS]
        found = {one for kind in kinds for one in self.out.glob(kind) if one.lstat().st_mtime < self.begun_s}
        for file in sorted(one for one in found if not {one, one.parent} & self.written):
            names = (f"{file.name}{EARLIER}" + f"-{k}" * (k > 1) for k in count(1))
            name = next(name for name in names if not os.path.lexists(file.with_name(name)))
            say(f"of an earlier run: {file}, from now on {name}")
            try:
                with writing(file):
                    file.rename(file.with_name(name))
            except OutputError as error:
                self.unwritable = self.unwritable or error

    def _say_whose_fault(self) -> None:
        """The commands that attribute what was violated and not expected to be: one for each avoider."""
        wrong: dict[str, list[JudgedRun]] = {}
        for one in self.runs:
            if any(e.verdict is Verdict.VIOLATED is not c.given(e.margin) for c, e in one.judged_claims()):
                wrong.setdefault(command_line_reference(one.trace.scenario), []).append(one)
        for runs in wrong.values():
            files = [one.trace_file for one in runs if one.trace_file is not None]
            command = replay_command(runs[0].trace.scenario, *files, by="attribute", told=Path)
            say(f"whose fault: {command}")

    def _ask_again(self) -> None:
        """Does the avoider answer alike when it is asked again?  Not after an interruption."""
        if not self.runs or self.interrupted or self.unwritable is not None:
            return
        try:
            self.repeated = self.repeatability.check()
        except KeyboardInterrupt:
            self.interrupted = True
        else:
            say(f"{'error: ' if self.repeated.problem else ''}{self.repeated.line}")

    def _say_coverage(self) -> bool:
        """How often each claim was put to the test; True if one that should have been never was."""
        found = tallies(self.runs)
        say(*table_lines(found, columns_of(sys.stderr)), *far_lines(found))
        untested = untested_lines(found)
        if untested:
            say(f"error: {untested[0]}", *untested[1:])
            say("  What hands do is drawn by: safety-harness show FILE")
        return bool(untested)

    def _report(self) -> bool:
        """Write the report; False if it cannot be written, or is given up by a second Ctrl-C."""
        from safety_harness.report.ci_formats import write_for_ci
        from safety_harness.report.html import write_report
        from safety_harness.report.machine import report_data, write_json

        path = self.out / REPORT
        of_all: dict[str, Any] = {
            "interrupted": len(self.runs) < self.planned or self.interrupted,
            "skipped": self.skipped,
            "refused": self.refused,
            "against": self.against,
            "repeated": self.repeated,
        }
        try:
            remark = f"writing {path}; Ctrl-C once more gives it up"
            with writing(path), one_more_ctrl_c(say, remark) as asked:
                write_report(
                    path,
                    self.runs,
                    title="Safety verification of a hand-avoiding robot arm",
                    command=self.command,
                    generated_at=datetime.now(UTC),
                    **of_all,
                )
                found = report_data(self.runs, **of_all)
                document(**found, failed=self.failed)
                write_json(self.out / DATA, found)
                write_for_ci(self.out, self.runs)
        except OutputError as error:
            explain(error)
            return False
        except KeyboardInterrupt:
            self.interrupted = True
            say(f"no report was written; the traces are in {self.out / TRACES}")
            return False
        self.interrupted = self.interrupted or asked()
        return True


def say_results(run: JudgedRun) -> None:
    """One line for each claim of a run, and one more for what could not be judged for want of measurement."""
    place = run.trace.scenario.places.get("avoider")
    overridden = place.field if place is not None and (place.field or "").startswith("--") else ""
    for claim, evaluation in run.judged_claims():
        same = evaluation.verdict is claim.given(evaluation.margin) or not evaluation.applicable
        mark = ("ok  " if same else "DIFF") if evaluation.applicable else "n/a "
        when = "-" if evaluation.worst_time_s is None else f"{evaluation.worst_time_s:.3f} s"
        expected = "" if same else f"  (expected {claim.expectation})"
        if overridden and claim.is_loosely(evaluation.verdict):
            expected = f"  (expected of another than {overridden}: it may be for another reason)"
        result(
            f"{mark} {evaluation.verdict.value:<12} {evaluation.margin_text():>13} at {when:>9}  "
            f"{run.trace.scenario.name}: {claim.sentence}{expected}"
        )
        if evaluation.unmeasured:
            result(f"     {evaluation.reason}")
    say(f"tested in {run.trace.scenario.name}: {tested_words(run.trace.scenario, run.trace.system)}")
