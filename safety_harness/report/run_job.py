"""Run scenarios and judge them: ``safety_harness.run``, its result, and the result's report."""

from __future__ import annotations

import os
import shlex
import time
import traceback
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import KW_ONLY, dataclass, field, replace
from datetime import UTC, datetime
from itertools import count
from pathlib import Path
from types import FunctionType
from typing import Any

from safety_harness.admission.admit import Admitted, admit
from safety_harness.admission.avoiders import (
    as_seen_from,
    command_line_reference,
    one_of,
    option_of,
    reference_for,
    replay_command,
    told_avoider,
)
from safety_harness.admission.repeatability import Repeatability, RepeatabilityResult
from safety_harness.admission.run_processes import RunProcesses, run_processes
from safety_harness.admission.taking import NotTaken, made_equal, taken
from safety_harness.admission.trial import run_trial
from safety_harness.base.exceptions import InputError, OutputError, SafetyHarnessError
from safety_harness.base.extension_points import ExtensionPoint, part_named
from safety_harness.base.extras import LOGS
from safety_harness.base.input_errors import InputErrors, each_once, usable
from safety_harness.base.interrupts import one_more_ctrl_c
from safety_harness.base.output import AS_EXPECTED, BAD_INPUT, DIFFERS, INTERRUPTED, QUIET, Output
from safety_harness.base.whole_file import write_text, writing
from safety_harness.cell.simulation.worlds import REFERENCE, WorldEntry, world_named
from safety_harness.claims.properties.against import Against, RunDifference
from safety_harness.claims.properties.base import Evaluation
from safety_harness.claims.properties.tally import ClaimTally, untested_lines
from safety_harness.claims.properties.tried import TriedParts
from safety_harness.report.decisions import fault_notes
from safety_harness.report.evidence import JudgedRun, basis_of, notes_of, tallies, worst_verdict
from safety_harness.report.words import tested_words
from safety_harness.scenario.expand import Gathered, gather
from safety_harness.scenario.files import as_path, told
from safety_harness.scenario.model import Scenario, Verdict
from safety_harness.scenario.ours import aside_lines
from safety_harness.scenario.write import write_scenario
from safety_harness.trace.store import save_trace
from safety_harness.trace.trace import Trace

REPORT, DATA = "report.html", "report.json"
TRACES, OF_REFERENCE, EARLIER = "traces", "traces-against", ".earlier"
GIVEN = "scenarios"  # of a folder that is written to: scenarios that were no files
KINDS = "*.trace", "*/run.mcap", "*/LOG.yaml"

ScenarioInput = str | Path | Scenario


def run(
    scenarios: ScenarioInput | Iterable[ScenarioInput],
    *,
    avoider: str | Path | None = None,
    controller: str | Path | None = None,
    against: str | Path | None = None,
    world: str | WorldEntry = REFERENCE,
    out: str | Path | None = None,
    keep_going: bool = False,
    jobs: int | None = None,
    mcap: bool = False,
    output: Output = QUIET,
) -> RunResult:
    """Run scenarios in a world and judge their claims.

    Args:
        scenarios: One or many of: a scenario file, a suite, a folder, ``shipped:NAME``, a ``Scenario``.
        avoider: What proposes retreats in place of what the scenarios name: a name, ``FILE.py:NAME``, ...
        controller: What drives the arm in place of the visual servo, likewise.
        against: A reference for either, which is run in the same draws.
        world: A world or its label, such as ``kinematic``.
        out: A folder that keeps each trace as soon as its run ends.
        keep_going: Run the others where some inputs cannot be used.
        jobs: Processes; None: one for each core, if there are many runs.
        mcap: Write each run as MCAP too, beside its trace.
        output: What hears of the progress.

    Ctrl-C ends the runs, and the result keeps those that were finished.  A run that fails costs no other.

    Raises:
        InputErrors: Inputs cannot be used; nothing was run.
        InputError: An option cannot be used, the world is not installed, or ``out`` cannot be written.

    """
    if mcap:
        LOGS.require("--mcap")
        part_named(ExtensionPoint.RUN_FORMATS, "mcap", FunctionType)
    chosen = world if isinstance(world, WorldEntry) else world_named(world, "world")
    tested = one_of(_reference(avoider), _reference(controller))
    reference = reference_for(tested, _reference(against))
    paths, objects = _paths_and_objects(scenarios)
    admitted, skipped, errors = read_all(paths, tested, reference, chosen, objects, output)
    if skipped and not admitted:
        errors += [one.error for one in skipped]
    refused = each_once(errors)
    for error in refused:
        output.explain(error)
    if refused and not (keep_going and admitted):
        raise InputErrors(refused, left=len(admitted))
    where = None if out is None else Path(out)
    if where is not None:
        for folder in (TRACES, *[OF_REFERENCE] * (reference is not None)):
            with writing(where / folder):
                (where / folder).mkdir(parents=True, exist_ok=True)
    options = ["--keep-going"] * keep_going + ["--mcap"] * mcap
    named = {option_of(tested or ""): tested, "--against": reference}
    options += [word for option, one in named.items() if one for word in (option, told_avoider(one))]
    options += [] if chosen is REFERENCE else ["--world", chosen.label]
    session = RunSession(
        where, [*paths, *objects], options, len(admitted), skipped, refused, chosen, mcap=mcap, output=output
    )
    if reference is not None:
        mine = "what each file names" if tested is None else told_avoider(tested)
        session.against = Against(mine=mine, reference=told_avoider(reference), runs=session.differences)
    output.say(*(f"skipped: {one}" for one in skipped))
    return session.run(admitted, jobs)


def _reference(given: str | Path | None) -> str | None:
    """Return what is tested as references are written; a ``Driver`` stays one."""
    return str(given) if isinstance(given, Path) else given


def _paths_and_objects(
    given: ScenarioInput | Iterable[ScenarioInput],
) -> tuple[list[Path], list[Scenario]]:
    one_by_one = list(given) if isinstance(given, Iterable) and not isinstance(given, str) else [given]
    objects = [one for one in one_by_one if isinstance(one, Scenario)]
    paths = []
    for one in one_by_one:
        if isinstance(one, Path):
            paths.append(one)
        elif not isinstance(one, Scenario):
            as_path(one, "run(scenarios)")
            paths.append(Path(one))
    return paths, objects


def read_all(
    paths: Sequence[Path],
    avoider: str | None = None,
    against: str | None = None,
    world: WorldEntry = REFERENCE,
    objects: Sequence[Scenario] = (),
    output: Output = QUIET,
) -> tuple[list[list[Admitted]], list[NotTaken], list[InputError]]:
    """Read and admit everything, with another avoider if one is given, and with the reference as well.

    All mistakes, not only the first, and what the avoiders given here cannot take.  InstallationError if
    there is something to run, and the world is not installed.
    """

    def take(one: Scenario) -> list[Admitted] | NotTaken:
        world.refuse(one)
        return equal.get(one.name) or taken(one, avoiders, admit)

    gathered = gather(paths) if paths or not objects else Gathered()
    for one in objects:
        gathered.take(one)
    output.say(*aside_lines(gathered.aside))
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


@dataclass(frozen=True, eq=False, repr=False)
class RunResult:
    """The judged runs of one call of ``run``, and what became of the other inputs.

    Args:
        runs: The runs that came to an end, in order.
        given: The scenarios as they were asked for.
        options: The options of the command that makes the same runs.
        planned: How many scenarios were to be run.
        skipped: Scenarios that the avoider cannot take.
        refused: Errors of inputs that kept no other from running.
        failed: Scenarios that could not be simulated, and why.
        against: The differences from the runs with the reference, if there is one.
        repeated: What a second avoider answered to the questions of the runs; None if it was not asked.
        interrupted: Ctrl-C ended the runs.
        unwritable: Why no more was written.
        mcap: Write each run as MCAP too.

    """

    runs: tuple[JudgedRun, ...]
    _: KW_ONLY
    given: tuple[Path | Scenario, ...] = ()
    options: tuple[str, ...] = ()
    planned: int = 0
    skipped: tuple[NotTaken, ...] = ()
    refused: tuple[InputError, ...] = ()
    failed: tuple[str, ...] = ()
    against: Against | None = None
    repeated: RepeatabilityResult | None = None
    interrupted: bool = False
    unwritable: OutputError | None = None
    mcap: bool = False

    @property
    def verdict(self) -> Verdict:
        """The worst verdict of all claims; inconclusive without any."""
        return worst_verdict(evaluation.verdict for run in self.runs for _, evaluation in run.judged_claims())

    @property
    def trace(self) -> Trace:
        """The trace of the only run; InputError if there is not one alone."""
        if len(self.runs) != 1:
            raise InputError.of_option("RunResult.trace", "the result of one run", f"{len(self.runs)} runs")
        return self.runs[0].trace

    @property
    def coverage(self) -> tuple[ClaimTally, ...]:
        """How often each claim was exercised."""
        return tallies(self.runs)

    @property
    def basis(self) -> str:
        """What the verdicts rest on: the world, the exercised runs, and what nothing watched."""
        return basis_of(self.runs)

    @property
    def exit_code(self) -> int:
        """The command's exit code."""
        if self.unwritable is not None:
            return BAD_INPUT
        if self.interrupted:
            return INTERRUPTED
        if self.refused:
            return BAD_INPUT
        every = [same for one in self.runs for same in zip(one.as_expected, one.applicable, strict=True)]
        verdicts = [same for same, applicable in every if applicable]
        if self.against is None:
            untested = untested_lines(self.coverage)
            good = all(verdicts) and bool(verdicts or not every) and not (untested or self.skipped)
        else:  # what cannot be compared differs in nothing
            good = len(self.against.runs) == self.planned and not self.against.worse
        good &= self.repeated is None or not self.repeated.problem
        return AS_EXPECTED if good and not self.failed else DIFFERS

    def __getitem__(self, sentence: str) -> Evaluation:
        """Return the evaluation of a claim by its sentence, the worst of several runs; InputError."""
        found = [e for one in self.runs for claim, e in one.judged_claims() if claim.sentence == sentence]
        if not found:
            claims = dict.fromkeys(claim.sentence for one in self.runs for claim, _ in one.judged_claims())
            raise InputError.of_option("RunResult[claim]", f"one of: {', '.join(claims)}", repr(sentence))
        worst = worst_verdict(one.verdict for one in found)
        return min(
            (e for e in found if e.verdict is worst), key=lambda e: (e.margin is None, e.margin or 0.0)
        )

    def __repr__(self) -> str:
        names = [one.trace.scenario.name for one in self.runs]
        what = names[0] if len(names) == 1 else f"{len(names)} of {self.planned} scenarios"
        kinds = [e.verdict for one in self.runs for _, e in one.judged_claims()]
        counts = ", ".join(f"{kinds.count(kind)} {kind.value}" for kind in Verdict if kind in kinds)
        return f"<{self.verdict.value}: {what}, claims: {counts or 'none'}. {self.basis}>"

    def data(self) -> dict[str, Any]:
        """Return what report.json holds; the traces have to be written first to have a hash."""
        from safety_harness.report.machine import report_data

        return report_data(self.runs, **self._of_all)

    @property
    def _of_all(self) -> dict[str, Any]:
        return {
            "interrupted": len(self.runs) < self.planned or self.interrupted,
            "skipped": self.skipped,
            "refused": self.refused,
            "against": self.against,
            "repeated": self.repeated,
        }

    def write(self, folder: str | Path, output: Output = QUIET) -> RunResult:
        """Write report.html, report.json, report.sarif, summary.md, and each trace that is not there yet.

        Scenarios that were no files are written too, since the report names the command that runs them again.
        The result that is returned names the traces of the folder.  A first Ctrl-C lets it end.

        Raises:
            OutputError: The folder cannot be written.

        """
        from safety_harness.report.ci_formats import write_for_ci
        from safety_harness.report.html import write_report
        from safety_harness.report.machine import write_json

        out = Path(folder)
        path = out / REPORT
        remark = f"writing {path}; Ctrl-C once more gives it up"
        with writing(path), one_more_ctrl_c(output.say, remark) as asked:
            runs = tuple(self._kept(one, out) for one in self.runs)
            written = replace(self, runs=runs)
            write_report(
                path,
                runs,
                title="Safety verification of a hand-avoiding robot arm",
                command=self._command(out),
                generated_at=datetime.now(UTC),
                **self._of_all,
            )
            write_json(out / DATA, written.data())
            write_for_ci(out, runs)
        return replace(written, interrupted=self.interrupted or asked())

    def _kept(self, one: JudgedRun, out: Path) -> JudgedRun:
        """Return the run with its trace in the folder."""
        if one.trace_file is not None and one.trace_file.parent == out / TRACES:
            return one
        file = saved(one.trace, out / TRACES)
        if self.mcap:
            save_mcap(one, file)
        return replace(one, trace_file=file, replay_command=replay_command(one.trace.scenario, file))

    def _command(self, out: Path) -> str:
        """Return the command line that makes these runs again."""
        words = ["safety-harness", "run"]
        for one in self.given:
            file = one if isinstance(one, Path) else out / GIVEN / f"{one.name}.yaml"
            if isinstance(one, Scenario):
                write_text(file, write_scenario(as_seen_from(file.parent, one)))
            words.append(str(told(file)))
        return shlex.join([*words, "--out", str(told(out)), *self.options])


def saved(trace: Trace, folder: Path) -> Path:
    """Return the file of a folder to which a trace is written; OutputError."""
    file = folder / f"{trace.scenario.name}.trace"
    with writing(file):
        file.parent.mkdir(parents=True, exist_ok=True)
        save_trace(trace, file)
    return file


def save_mcap(one: JudgedRun, file: Path) -> Path:
    """Return the folder beside a trace's file to which the run is written as MCAP."""
    write_mcap = part_named(ExtensionPoint.RUN_FORMATS, "mcap", FunctionType)
    folder = file.with_suffix("")
    write_mcap(one.trace, one.evaluations, folder / "run.mcap")
    return folder


@dataclass
class RunsShown:
    """Which of several scenarios is run, and how far it is."""

    scenarios: Sequence[Scenario]
    show: Callable[..., None]
    _before: int = 0
    _shown: int = 0
    _words: str = ""
    _at: str = ""
    _ticks: int = field(default=0, init=False)

    def begin(self, number: int) -> None:
        """Scenario ``number`` starts."""
        name = self.scenarios[number].name
        self._before = sum(s.ticks + 1 for s in self.scenarios[:number])
        self._ticks, self._shown = self.scenarios[number].ticks + 1, 0
        self._words, self._at = name, f"[{number + 1}/{len(self.scenarios)}] "
        self.show(self._before, self._words, self._at)

    def tick(self, done: int) -> None:
        """``done`` ticks of the current scenario are over; shown every 50, and at its end."""
        if done - self._shown >= 50 or done >= self._ticks:
            self._shown = done
            self.show(self._before + done, self._words, self._at)


@contextmanager
def watching_runs(scenarios: Sequence[Scenario], output: Output) -> Iterator[RunsShown]:
    """Yield what takes which scenario is run, and how many of its ticks are over."""
    with output.counting(sum(s.ticks + 1 for s in scenarios), "ticks") as show:
        yield RunsShown(scenarios, show)


@dataclass
class RunSession:
    """The runs of one call while they are made; the attributes are those of ``RunResult``.

    ``out`` keeps the traces as they come; None keeps them in memory alone.  ``against`` holds the
    ``differences`` of the runs from those with a reference, if there is one.
    """

    out: Path | None
    given: Sequence[Path | Scenario]
    options: Sequence[str]
    planned: int
    skipped: Sequence[NotTaken] = ()
    refused: Sequence[InputError] = ()
    world: WorldEntry = REFERENCE
    against: Against | None = None
    mcap: bool = False
    output: Output = QUIET
    differences: list[RunDifference] = field(default_factory=list)
    runs: list[JudgedRun] = field(default_factory=list)
    failed: list[str] = field(default_factory=list)
    interrupted: bool = False
    unwritable: OutputError | None = None
    repeatability: Repeatability = field(default_factory=Repeatability)
    repeated: RepeatabilityResult | None = None
    begun_s: float = field(default_factory=lambda: time.time() - 0.1)  # clocks of disks are coarse
    written: set[Path] = field(default_factory=set)  # whatever the disk says of when

    def run(self, admitted: Sequence[Sequence[Admitted]], jobs: int | None = 1) -> RunResult:
        """Make all runs, put the traces of earlier runs aside, and ask a second avoider."""
        self._run_all(admitted, jobs)
        self._rename_earlier()
        if self.unwritable is not None:
            self.output.explain(self.unwritable)
        if self.interrupted or self.unwritable is not None:
            kept = f"the results of {len(self.runs)} of {self.planned} scenarios are kept"
            self.output.say(f"stopped before the end: {kept}")
        self._ask_again()
        return RunResult(
            tuple(self.runs),
            given=tuple(self.given),
            options=tuple(self.options),
            planned=self.planned,
            skipped=tuple(self.skipped),
            refused=tuple(self.refused),
            failed=tuple(self.failed),
            against=self.against,
            repeated=self.repeated,
            interrupted=self.interrupted,
            unwritable=self.unwritable,
            mcap=self.mcap,
        )

    def _run_all(self, admitted: Sequence[Sequence[Admitted]], jobs: int | None) -> None:
        """In their order, each with the reference too, until Ctrl-C or a disk that takes no more."""
        flat = [one for each in admitted for one in each]
        with (
            watching_runs([one.scenario for one in flat], self.output) as progress,
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
        file = None if self.out is None else saved(trace, self.out / folder)
        judged = JudgedRun(
            trace=trace,
            evaluations=tuple(prop.evaluate(trace) for prop in one.properties),
            replay_command="" if file is None else replay_command(one.scenario, file),
            trace_file=file,
            notes=notes_of(one.scenario),
        )
        if file is not None:
            self.written.add(file)
            if self.mcap:
                self.written.add(save_mcap(judged, file))
        return judged

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
        say = self.output.say
        if self.against is None:
            self.output.result(*result_lines(judged))
            say(tested_line(judged))
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
            self.output.result(*self.differences[-1].lines(self.against.reference))

    def _fail(self, name: str, error: Exception) -> None:
        self.failed.append(f"{name} could not be run to its end: {type(error).__name__}: {error}")
        say = self.output.say
        say(f"error: {self.failed[-1]}")
        if not isinstance(error, SafetyHarnessError):
            say(traceback.format_exc().rstrip())
            say("This is a defect of safety-harness, not of your file; the other scenarios are not affected.")

    def _rename_earlier(self) -> None:
        """Traces of earlier runs stay, by names that no folder or pattern takes for evidence of this one."""
        if self.out is None:
            return
        kinds = [f"{at}/{kind}" for at in (TRACES, OF_REFERENCE) for kind in KINDS]
        found = {one for kind in kinds for one in self.out.glob(kind) if one.lstat().st_mtime < self.begun_s}
        for file in sorted(one for one in found if not {one, one.parent} & self.written):
            names = (f"{file.name}{EARLIER}" + f"-{k}" * (k > 1) for k in count(1))
            name = next(name for name in names if not os.path.lexists(file.with_name(name)))
            self.output.say(f"of an earlier run: {file}, from now on {name}")
            try:
                with writing(file):
                    file.rename(file.with_name(name))
            except OutputError as error:
                self.unwritable = self.unwritable or error

    def _ask_again(self) -> None:
        """Does the avoider answer alike when it is asked again?  Not after an interruption."""
        if not self.runs or self.interrupted or self.unwritable is not None:
            return
        try:
            self.repeated = self.repeatability.check()
        except KeyboardInterrupt:
            self.interrupted = True
        else:
            self.output.say(f"{'error: ' if self.repeated.problem else ''}{self.repeated.line}")


def result_lines(run: JudgedRun) -> Iterator[str]:
    """Yield one line for each claim of a run, and one more for what could not be judged unmeasured."""
    place = run.trace.scenario.places.get("avoider")
    overridden = place.field if place is not None and (place.field or "").startswith("--") else ""
    for claim, evaluation in run.judged_claims():
        same = evaluation.verdict is claim.given(evaluation.margin) or not evaluation.applicable
        mark = ("ok  " if same else "DIFF") if evaluation.applicable else "n/a "
        when = "-" if evaluation.worst_time_s is None else f"{evaluation.worst_time_s:.3f} s"
        expected = "" if same else f"  (expected {claim.expectation})"
        if overridden and claim.is_loosely(evaluation.verdict):
            expected = f"  (expected of another than {overridden}: it may be for another reason)"
        yield (
            f"{mark} {evaluation.verdict.value:<12} {evaluation.margin_text():>13} at {when:>9}  "
            f"{run.trace.scenario.name}: {claim.sentence}{expected}"
        )
        if evaluation.unmeasured:
            yield f"     {evaluation.reason}"


def tested_line(run: JudgedRun) -> str:
    """Return what was tested in a run."""
    return f"tested in {run.trace.scenario.name}: {tested_words(run.trace.scenario, run.trace.system)}"
