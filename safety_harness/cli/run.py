"""Define ``safety-harness run``, which runs scenario files and prints their verdicts."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from safety_harness.admission.avoiders import command_line_reference, replay_command
from safety_harness.admission.taking import not_taken_words
from safety_harness.base.exceptions import OutputError
from safety_harness.base.input_errors import InputErrors
from safety_harness.claims.properties.tally import far_lines, short_basis, table_lines, untested_lines
from safety_harness.cli.console import (
    BAD_INPUT,
    INTERRUPTED,
    columns_of,
    document,
    explain,
    next_step,
    result,
    say,
    say_shared_modules,
)
from safety_harness.cli.progress import terminal
from safety_harness.report.decisions import (
    DecisionTally,
    computing_time_lines,
    overruling_lines,
    overruling_of_each,
    possible_lines,
)
from safety_harness.report.evidence import JudgedRun, answer
from safety_harness.report.run_job import run as run_scenarios
from safety_harness.report.run_result import DATA, TRACES, RunResult, report_line
from safety_harness.report.shielding import shield_lines
from safety_harness.report.verdict_lines import block_of, surprise_lines
from safety_harness.scenario.model import Verdict
from safety_harness.trace.answer_times import UNHEEDED
from safety_harness.trace.limiting import limit_lines


def run(
    paths: Sequence[Path],
    out: Path,
    avoider: str | None = None,
    against: str | None = None,
    *,
    verbose: bool = False,
    **options: Any,
) -> int:
    """Run scenarios, print the verdicts, write the report, and return the exit code.

    ``options`` are further arguments of ``safety_harness.run``.
    """
    say_shared_modules()
    output = terminal(verbose)
    try:
        finished = run_scenarios(paths, avoider=avoider, against=against, out=out, output=output, **options)
    except InputErrors as error:
        go_on = "; --keep-going runs the others" if error.left else ""
        say(f"{error.inputs} of the inputs cannot be used; nothing was run{go_on}.")
        return BAD_INPUT
    except KeyboardInterrupt:
        say("interrupted: nothing was run")
        return INTERRUPTED
    if finished.runs:
        try:
            finished = finished.write(out, output=output)
        except OutputError as error:
            explain(error)
            return INTERRUPTED if finished.interrupted else BAD_INPUT
        except KeyboardInterrupt:
            say(f"no report was written; the traces are in {out / TRACES}")
            return INTERRUPTED
        document(**json.loads((out / DATA).read_text("utf-8")), failed=finished.failed)
    _print_summary(finished, verbose)
    if finished.runs:
        say(report_line(out))
        _say_next(finished.runs, out)
    return finished.exit_code


def print_verdicts(runs: Sequence[JudgedRun], verbose: bool) -> None:
    """Print all verdicts of a single run, or only the unexpected verdicts of many runs.

    If ``verbose`` is true, this function does not print, because every verdict was already printed at the end
    of its run.
    """
    if not verbose:
        result(*(block_of(runs[0]) if len(runs) == 1 else surprise_lines(runs)))


def _print_summary(finished: RunResult, verbose: bool) -> None:
    """Print the verdicts, the untested claims, and a line of totals.

    If ``verbose`` is true, print more details.
    """
    coverage, traces = finished.coverage, [run.trace for run in finished.runs]
    if finished.against is None:
        print_verdicts(finished.runs, verbose)
    overruled, took = overruling_lines(overruling_of_each(traces)), computing_time_lines(traces)
    if verbose:
        say(*table_lines(coverage, columns_of(sys.stderr)))
    elif len(traces) > 1:
        took = [line for line in took if UNHEEDED in line]
    say(*far_lines(coverage))
    if untested := untested_lines(coverage):
        say(f"error: {untested[0]}", *untested[1:])
        say("  To see the motion of the hands: safety-harness show FILE")
    say(*[finished.basis if verbose else short_basis(finished.basis)] * bool(finished.runs))
    say(*(f"computing time: {line}" for line in took))
    say(*(f"shield: {line}" for line in shield_lines(traces)))
    say(*(f"limits: {line}" for line in limit_lines(traces)))
    say(*(f"gate: {line}" for line in possible_lines(traces)))
    say(*(overruled if verbose else overruled[:1]))
    fallback = DecisionTally.from_traces(traces).fallback
    result(
        f"{answer(finished.runs)}, "
        f"{len(finished.runs)} of {finished.planned + len(finished.skipped)} scenarios run"
        + (f", {len(finished.failed)} could not be run to the end" if finished.failed else "")
        + (f", {not_taken_words(finished.skipped)}" if finished.skipped else "")
        + (f", {len(finished.refused)} of the inputs cannot be used" if finished.refused else "")
        + (f"; {fallback}" if fallback else "")
    )
    if finished.against is not None:
        result(*finished.against.lines())


def _say_next(runs: Sequence[JudgedRun], out: Path) -> None:
    """Print the command that the user most likely needs next.

    If avoiders caused violations, this command attributes the violations of each avoider. Otherwise it shows
    the runs.
    """
    unexpected: dict[tuple[str, ...], list[JudgedRun]] = {}
    for run in runs:
        if any(
            evaluation.verdict is Verdict.VIOLATED
            and (len(runs) == 1 or claim.given(evaluation.margin) is Verdict.HOLDS)
            for claim, evaluation in run.judged_claims()
        ):
            scenario = run.trace.scenario
            system = command_line_reference(scenario), *scenario.parts_under_test[1:]
            unexpected.setdefault(system, []).append(run)
    for violated in unexpected.values():
        files = [run.trace_file for run in violated if run.trace_file is not None]
        trace = violated[0].trace
        made_in = trace.provenance.world
        command = replay_command(trace.scenario, *files, verb="attribute", made_in=made_in, shown_path=Path)
        next_step(command, "whose fault it is")
    file = runs[0].trace_file
    if len(runs) > 1 and not unexpected:
        next_step(f"safety-harness judge {shlex.quote(str(out / TRACES))}/*.trace -v", "every verdict")
    elif file is not None and not unexpected:
        next_step(f"safety-harness view {shlex.quote(str(file))}", "the run in 3-D")
