"""``safety-harness run``: scenario files in, verdicts and a report out."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

from safety_harness.admission.admit import Admitted, admit
from safety_harness.admission.trial import run_trial
from safety_harness.cli.console import (
    AS_EXPECTED,
    BAD_INPUT,
    DIFFERS,
    INTERRUPTED,
    ScenarioProgress,
    explain,
    result,
    result_lines,
    say,
)
from safety_harness.compiled import PACKAGE, cache_folder, forget_old_machine_code
from safety_harness.exceptions import InputError, OutputError, Place, ScenarioError
from safety_harness.report.evidence import JudgedRun
from safety_harness.scenario.model import RecordedHand, Scenario
from safety_harness.scenario.read import read_scenario
from safety_harness.trace.store import save_trace

REPORT = "report.html"
TRACES = "traces"


def scenario_files(paths: Sequence[Path]) -> list[Path]:
    """The scenario files that ``paths`` mean: files as they are, folders with all their *.yaml."""
    files: list[Path] = []
    for path in paths:
        if path.is_dir():
            found = sorted(path.glob("*.yaml"))
            if not found:
                raise ScenarioError(
                    place=Place(file=path), expected="a folder with scenario files (*.yaml)", got="none in it"
                )
            files.extend(found)
        else:
            files.append(path)
    return files


def read_all(paths: Sequence[Path]) -> tuple[list[Admitted], list[InputError]]:
    """Read and admit every file; all the mistakes, not only the first."""
    admitted: list[Admitted] = []
    errors: list[InputError] = []
    names: dict[str, Path] = {}
    try:
        files = scenario_files(paths)
    except InputError as error:
        return [], [error]
    for file in files:
        try:
            scenario = read_scenario(file)
            if scenario.name in names:
                raise ScenarioError(
                    place=Place(file=file),
                    expected="file names that tell the scenarios apart",
                    got=f"the name {scenario.name!r} again, after {names[scenario.name]}",
                )
            names[scenario.name] = file
            admitted.append(admit(scenario))
        except InputError as error:
            errors.append(error)
    return admitted, errors


def notes_of(scenario: Scenario) -> tuple[str, ...]:
    """What a reader has to know of the recordings: gaps that were bridged, jumps removed."""
    return tuple(
        f"{hand.name} hand, {hand.recording}: {note}"
        for hand in scenario.hands
        if isinstance(hand, RecordedHand)
        for note in hand.motion.notes
    )


def run(paths: Sequence[Path], out: Path) -> int:
    """Run, judge, print, save and report; returns the exit code."""
    admitted, errors = read_all(paths)
    if errors:
        for error in errors:
            explain(error)
        say(f"{len(errors)} of the inputs cannot be used; nothing was run.")
        return BAD_INPUT
    if not cache_folder(PACKAGE / "controller" / "stack.py").is_dir():
        say("compiling the control stack; this takes a minute, once")
        forget_old_machine_code()
    traces = out / TRACES
    try:
        traces.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        explain(_unwritable(traces, error))
        return BAD_INPUT
    runs: list[JudgedRun] = []
    stopped: OutputError | None = None
    interrupted = False
    progress = ScenarioProgress([a.scenario for a in admitted])
    with progress.running():
        for number, one in enumerate(admitted):
            progress.begin(number)
            try:
                judged = _run_one(one, traces, progress)
            except KeyboardInterrupt:
                interrupted = True
                break
            except OutputError as error:
                stopped = error
                break
            runs.append(judged)
            for line in result_lines(judged):
                result(line)
            if not judged.trace.complete:
                interrupted = True
                break
    if stopped is not None:
        explain(stopped)
    code = _finish(runs, len(admitted), out, paths, interrupted=interrupted or stopped is not None)
    return code if stopped is None else BAD_INPUT


def _unwritable(path: Path, error: OSError) -> OutputError:
    return OutputError(place=Place(file=path), expected="a place that can be written", got=str(error))


def _run_one(admitted: Admitted, traces: Path, progress: ScenarioProgress) -> JudgedRun:
    """Simulate, save, judge."""
    trace = run_trial(admitted, on_tick=progress.tick)
    file = traces / f"{admitted.scenario.name}.trace"
    try:
        save_trace(trace, file)
    except OSError as error:
        raise _unwritable(file, error) from error
    return JudgedRun(
        trace=trace,
        evaluations=tuple(prop.evaluate(trace) for prop in admitted.properties),
        replay_command=shlex.join(["safety-harness", "replay", str(file)]),
        notes=notes_of(admitted.scenario),
    )


def _finish(
    runs: list[JudgedRun], planned: int, out: Path, paths: Sequence[Path], *, interrupted: bool
) -> int:
    """Write the report, sum up, choose the exit code."""
    if interrupted:
        say(f"stopped before the end: the results of {len(runs)} of {planned} scenarios are kept")
    if runs:
        from safety_harness.report.html import write_report  # matplotlib is slow to import

        try:
            write_report(
                out / REPORT,
                runs,
                title="Safety verification of a hand-avoiding UR10",
                command=shlex.join(["safety-harness", "run", *map(str, paths), "--out", str(out)]),
                generated_at=datetime.now(UTC),
                interrupted=interrupted,
            )
        except OSError as error:
            explain(_unwritable(out / REPORT, error))
            return BAD_INPUT
    claims = [
        evaluation.verdict is claim.expected
        for run in runs
        for claim, evaluation in zip(run.trace.scenario.claims, run.evaluations, strict=True)
    ]
    say(f"{sum(claims)} of {len(claims)} verdicts as expected, {len(runs)} of {planned} scenarios run")
    if runs:
        say(f"report: {out / REPORT}")
    if interrupted:
        return INTERRUPTED
    return AS_EXPECTED if all(claims) else DIFFERS
