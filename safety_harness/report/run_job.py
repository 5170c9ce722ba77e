"""Provide ``safety_harness.run``, which runs scenarios and judges their claims."""

from __future__ import annotations

import os
import time
import traceback
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from itertools import count
from pathlib import Path
from types import FunctionType

from safety_harness.admission.admit import Admitted, admit
from safety_harness.admission.avoiders import (
    command_line_reference,
    one_of,
    option_of,
    replay_command,
    told_avoider,
)
from safety_harness.admission.comparison import reference_for
from safety_harness.admission.repeatability import Repeatability, RepeatabilityResult
from safety_harness.admission.run_processes import RunProcesses, run_processes
from safety_harness.admission.taking import Incompatible, accept, made_equal
from safety_harness.admission.trial import run_trial
from safety_harness.base.exceptions import InputError, OutputError, SafetyHarnessError
from safety_harness.base.extension_points import ExtensionPoint, part_named
from safety_harness.base.extras import LOGS
from safety_harness.base.input_errors import InputErrors, each_once, usable
from safety_harness.base.output import QUIET, Output
from safety_harness.base.whole_file import writing
from safety_harness.cell.simulation.worlds import REFERENCE, WorldEntry, default_world, defaulted, world_named
from safety_harness.claims.properties.against import Against, RunDifference
from safety_harness.claims.properties.tried import TriedParts
from safety_harness.report.decisions import fault_notes
from safety_harness.report.evidence import JudgedRun, notes_of
from safety_harness.report.run_result import TRACES, RunResult, save_mcap, saved
from safety_harness.report.verdict_lines import every_line
from safety_harness.scenario.expand import Gathered, gather
from safety_harness.scenario.files import as_path
from safety_harness.scenario.model import Scenario
from safety_harness.scenario.ours import aside_lines

OF_REFERENCE, EARLIER = "traces-against", ".earlier"
KINDS = "*.trace", "*/run.mcap", "*/LOG.yaml"

ScenarioInput = str | Path | Scenario


def run(
    scenarios: ScenarioInput | Iterable[ScenarioInput],
    *,
    avoider: str | Path | None = None,
    controller: str | Path | None = None,
    against: str | Path | None = None,
    world: str | WorldEntry | None = None,
    out: str | Path | None = None,
    keep_going: bool = False,
    jobs: int | None = None,
    mcap: bool = False,
    output: Output = QUIET,
) -> RunResult:
    """Run scenarios in a world and judge their claims.

    Args:
        scenarios: One or several inputs: a scenario file, a suite, a folder, ``shipped:NAME`` or a
            ``Scenario``.
        avoider: The avoider that replaces the avoiders of the scenarios: a name, ``FILE.py:NAME`` or a model
            file.
        controller: The controller that replaces the visual servo: a name, ``FILE.py:NAME`` or a program.
        against: A reference avoider or controller, with which every scenario runs again. The result compares
            the runs with the runs of the reference.
        world: A world or its label, such as ``kinematic``. The default is PyBullet if it is installed,
            otherwise MuJoCo if it is installed, and otherwise the kinematic world.
        out: The folder into which each trace is written as soon as its run ends. If it is None, no files are
            written.
        keep_going: Whether to run the usable inputs even if other inputs cannot be used.
        jobs: The number of processes. The default is one process for each core if there are many runs.
        mcap: Whether to write each run also as an MCAP file beside its trace.
        output: The ``Output`` that shows the progress.

    Ctrl-C ends the job, and the result then contains the finished runs. A run that fails does not stop the
    other runs.

    Raises:
        InputErrors: Inputs cannot be used. In this case, no scenario ran.
        InputError: An option cannot be used, the world is not installed, or ``out`` cannot be written.

    """
    if mcap:
        replace(LOGS, instead="").require("--mcap")  # a run is not written as .csv
        part_named(ExtensionPoint.RUN_FORMATS, "mcap", FunctionType)
    chosen = world_named(world, "world") if isinstance(world, str) else world or default_world()
    if world is None and chosen is not REFERENCE:
        output.say(defaulted(chosen))
    tested = one_of(_reference(avoider), _reference(controller))
    reference = reference_for(tested, _reference(against))
    paths, objects = _paths_and_objects(scenarios)
    admitted, skipped, errors = read_all(paths, tested, reference, chosen, objects, output)
    if skipped and not admitted:
        errors += [skip.error for skip in skipped]
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
    options += [
        part for option, reference in named.items() if reference for part in (option, told_avoider(reference))
    ]
    options += [] if chosen is REFERENCE else ["--world", chosen.label]
    differences, beside = list[RunDifference](), None
    if reference is not None:
        mine = "what each file names" if tested is None else told_avoider(tested)
        beside = Against(mine=mine, reference=told_avoider(reference), runs=differences)
    output.say(*(f"skipped: {skip}" for skip in skipped))
    job = RunResult(
        given=(*paths, *objects),
        options=tuple(options),
        planned=len(admitted),
        skipped=tuple(skipped),
        refused=tuple(refused),
        against=beside,
        mcap=mcap,
    )
    return RunSession(job, where, chosen, output, differences).run(admitted, jobs)


def _reference(given: str | Path | None) -> str | None:
    """Return the tested program as text.

    A ``Driver`` object is returned unchanged.
    """
    return str(given) if isinstance(given, Path) else given


def _paths_and_objects(
    given: ScenarioInput | Iterable[ScenarioInput],
) -> tuple[list[Path], list[Scenario]]:
    one_by_one = list(given) if isinstance(given, Iterable) and not isinstance(given, str) else [given]
    objects = [given for given in one_by_one if isinstance(given, Scenario)]
    paths = []
    for each in one_by_one:
        if isinstance(each, Path):
            paths.append(each)
        elif not isinstance(each, Scenario):
            as_path(each, "run(scenarios)")
            paths.append(Path(each))
    return paths, objects


def read_all(
    paths: Sequence[Path],
    avoider: str | None = None,
    against: str | None = None,
    world: WorldEntry = REFERENCE,
    objects: Sequence[Scenario] = (),
    output: Output = QUIET,
) -> tuple[list[list[Admitted]], list[Incompatible], list[InputError]]:
    """Read all scenarios, and admit each of them with its avoider and, if there is one, with the reference.

    Args:
        paths: Scenario files, suites or folders.
        avoider: The avoider that replaces the avoider of every scenario. If it is None, the scenarios keep
            their avoiders.
        against: The reference, or None if no comparison is wanted.
        world: The world of the runs.
        objects: Scenarios that were passed as objects, not as files.
        output: The ``Output`` that shows the progress.

    Returns:
        Three lists. The first list has the admitted scenarios, each with its reference. The second list has
        the scenarios that a given avoider does not support. The third list has the errors of all inputs that
        cannot be used.

    Raises:
        InstallationError: There is a scenario to run, and the world is not installed.

    """

    def take(scenario: Scenario) -> list[Admitted] | Incompatible:
        world.refuse(scenario)
        return equal.get(scenario.name) or accept(scenario, avoiders, admit)

    gathered = gather(paths) if paths or not objects else Gathered()
    for instance in objects:
        gathered.take(instance)
    output.say(*aside_lines(gathered.aside))
    # A missing engine is reported before any scenario is admitted, and only if there is a scenario to run.
    if gathered.scenarios:
        world.opener()
    avoiders = [(avoider, option_of(avoider or ""))] + ([] if against is None else [(against, "--against")])
    equal = made_equal(gathered.scenarios, *avoiders[0])
    accepted, errors = usable(gathered.scenarios, take)
    return (
        [outcome for outcome in accepted if not isinstance(outcome, Incompatible)],
        [outcome for outcome in accepted if isinstance(outcome, Incompatible)],
        [*gathered.errors, *errors],
    )


@dataclass
class RunsShown:
    """The progress display of several scenarios, which shows the current scenario and its ticks."""

    scenarios: Sequence[Scenario]
    show: Callable[..., None]
    _number: int = 0
    _shown: int = 0

    def begin(self, number: int) -> None:
        """Show the start of scenario ``number``."""
        self._number = number
        self._show(0)

    def tick(self, done: int) -> None:
        """Show that ``done`` ticks are finished.

        The display changes every 50 ticks and at the end.
        """
        if done - self._shown >= 50 or done > self.scenarios[self._number].ticks:
            self._show(done)

    def _show(self, done: int) -> None:
        ticks_before, self._shown = sum(s.ticks + 1 for s in self.scenarios[: self._number]), done
        name, at = self.scenarios[self._number].name, f"[{self._number + 1}/{len(self.scenarios)}] "
        self.show(ticks_before + done, name, at)


@contextmanager
def watching_runs(scenarios: Sequence[Scenario], output: Output) -> Iterator[RunsShown]:
    """Yield the display.

    The caller updates the display with the current scenario and its finished ticks.
    """
    with output.counting(sum(s.ticks + 1 for s in scenarios), "ticks") as show:
        yield RunsShown(scenarios, show)


@dataclass
class RunSession:
    """The state of one call of ``run`` while its scenarios run.

    ``asked`` is the result before the first run. ``out`` is the folder into which each trace is written at
    once. If ``out`` is None, the traces stay in memory. ``differences`` compares the runs with the runs of a
    reference, if there is a reference.
    """

    asked: RunResult
    out: Path | None
    world: WorldEntry = REFERENCE
    output: Output = QUIET
    differences: list[RunDifference] = field(default_factory=list)
    runs: list[JudgedRun] = field(default_factory=list)
    failed: list[str] = field(default_factory=list)
    interrupted: bool = False
    unwritable: OutputError | None = None
    repeatability: Repeatability = field(default_factory=Repeatability)
    repeated: RepeatabilityResult | None = None
    begun_s: float = field(default_factory=lambda: time.time() - 0.1)  # because disks' clocks are coarse
    written: set[Path] = field(default_factory=set)  # by this job, whatever times the disk reports

    def run(self, admitted: Sequence[Sequence[Admitted]], jobs: int | None = 1) -> RunResult:
        """Simulate all runs, rename the traces of earlier runs, and query a second avoider.

        Args:
            admitted: For each scenario, its run and the run of its reference, if there is one.
            jobs: The number of processes. The default is one process for each core if there are many runs.

        """
        self._run_all(admitted, jobs)
        self._rename_earlier()
        if self.unwritable is not None:
            self.output.explain(self.unwritable)
        if self.interrupted or self.unwritable is not None:
            kept = f"the results of {len(self.runs)} of {self.asked.planned} scenarios are kept"
            self.output.say(f"stopped before the end: {kept}; the same command repeats all")
        self._ask_again()
        return replace(
            self.asked,
            runs=tuple(self.runs),
            failed=tuple(self.failed),
            repeated=self.repeated,
            interrupted=self.interrupted,
            unwritable=self.unwritable,
        )

    def _run_all(self, admitted: Sequence[Sequence[Admitted]], jobs: int | None) -> None:
        """Run all scenarios in order, each with its reference, until Ctrl-C or a full disk ends the job."""
        flat = [run for each in admitted for run in each]
        with (
            watching_runs([run.scenario for run in flat], self.output) as progress,
            run_processes(flat, self.world, jobs) as apart,
        ):
            for number, (own, *references) in enumerate(admitted):
                progress.begin(number * (1 + len(references)))
                name = own.scenario.name
                try:
                    self._take(self._run_one(own, apart, TRACES, progress))
                    for reference_run in references[: not self.interrupted]:
                        progress.begin(2 * number + 1)
                        name += f" with {command_line_reference(reference_run.scenario)}"
                        self._compare(self._run_one(reference_run, apart, OF_REFERENCE, progress))
                except KeyboardInterrupt:
                    self._take_finished(admitted[number:], apart, progress)
                    self.interrupted = True
                except OutputError as error:
                    self.unwritable = error
                except Exception as error:  # one scenario's failure must not cost the others' evidence
                    self._fail(name, error)
                if self.interrupted or self.unwritable is not None:
                    return

    def _run_one(
        self, admitted: Admitted, processes: RunProcesses, folder: str, progress: RunsShown
    ) -> JudgedRun:
        """Simulate a run in this process or in another process, then save and judge the run."""
        trace = processes.trace(admitted) or run_trial(admitted, world=processes.world, on_tick=progress.tick)
        file = None if self.out is None else saved(trace, self.out / folder)
        judged = JudgedRun(
            trace=trace,
            evaluations=tuple(prop.evaluate(trace) for prop in admitted.properties),
            replay_command=""
            if file is None
            else replay_command(admitted.scenario, file, made_in=trace.provenance.world),
            trace_file=file,
            notes=notes_of(admitted.scenario),
        )
        if file is not None:
            self.written.add(file)
            if self.asked.mcap:
                self.written.add(save_mcap(judged, file))
        return judged

    def _take_finished(
        self, left: Sequence[Sequence[Admitted]], processes: RunProcesses, progress: RunsShown
    ) -> None:
        """Add to the result the runs that other processes finished before Ctrl-C."""
        for admitted, *_ in left if self.asked.against is None else ():
            if processes.is_done(admitted):
                with suppress(Exception):
                    self._take(self._run_one(admitted, processes, TRACES, progress))

    def _take(self, judged: JudgedRun) -> None:
        self.runs.append(judged)
        self.repeatability.add(judged.trace)
        say = self.output.say
        if self.asked.against is None:
            self.output.detail(*every_line(judged))
        say(*(f"note: {judged.trace.scenario.name}: {note}" for note in fault_notes(judged.trace)))
        say(*(f"note: {line}" for line in TriedParts.from_traces(judged.trace).lines()))
        self.interrupted = not judged.trace.complete

    def _compare(self, reference: JudgedRun) -> None:
        """Compare the last run with the reference's run.

        The result keeps only the differences, not the reference's run.
        """
        assert self.asked.against is not None
        mine, self.interrupted = self.runs[-1], not reference.trace.complete
        if not self.interrupted:
            pairs = zip(mine.evaluations, reference.evaluations, strict=True)
            self.differences.append(RunDifference.from_traces(mine.trace, reference.trace, pairs))
            self.output.result(*self.differences[-1].lines(self.asked.against.reference))

    def _fail(self, name: str, error: Exception) -> None:
        self.failed.append(f"{name} could not be run to its end: {type(error).__name__}: {error}")
        say = self.output.say
        say(f"error: {self.failed[-1]}")
        if not isinstance(error, SafetyHarnessError):
            say(traceback.format_exc().rstrip())
            say("This is a defect of safety-harness, not of your file; the other scenarios are not affected.")

    def _rename_earlier(self) -> None:
        """Rename the traces of earlier runs, so that users do not mistake them for evidence of this run."""
        if self.out is None:
            return
        kinds = [f"{at}/{kind}" for at in (TRACES, OF_REFERENCE) for kind in KINDS]
        earlier = {
            path for kind in kinds for path in self.out.glob(kind) if path.lstat().st_mtime < self.begun_s
        }
        for file in sorted(file for file in earlier if not {file, file.parent} & self.written):
            names = (f"{file.name}{EARLIER}" + f"-{k}" * (k > 1) for k in count(1))
            name = next(name for name in names if not os.path.lexists(file.with_name(name)))
            self.output.say(f"of an earlier run: {file}, from now on {name}")
            try:
                with writing(file):
                    file.rename(file.with_name(name))
            except OutputError as error:
                self.unwritable = self.unwritable or error

    def _ask_again(self) -> None:
        """Check whether the avoider gives the same answers again, unless the job was interrupted."""
        if self.runs and not self.interrupted and self.unwritable is None:
            self.repeated = self.repeatability.reported(self.output)
            self.interrupted = self.repeated is None
