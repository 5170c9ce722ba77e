"""``safety-harness run``: what a terminal shows of the runs of scenario files."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from safety_harness.admission.avoiders import command_line_reference, replay_command
from safety_harness.admission.taking import not_taken_words
from safety_harness.base.exceptions import OutputError
from safety_harness.base.input_errors import InputErrors
from safety_harness.claims.properties.tally import far_lines, table_lines, untested_lines
from safety_harness.cli.console import (
    BAD_INPUT,
    INTERRUPTED,
    columns_of,
    document,
    explain,
    result,
    say,
    say_shared_modules,
)
from safety_harness.cli.progress import TERMINAL
from safety_harness.report.decisions import (
    DecisionTally,
    computing_time_lines,
    overruling_lines,
    overruling_of_each,
    possible_lines,
)
from safety_harness.report.evidence import JudgedRun, as_expected
from safety_harness.report.run_job import run as run_scenarios
from safety_harness.report.run_result import DATA, REPORT, TRACES, RunResult
from safety_harness.report.shielding import shield_lines
from safety_harness.scenario.model import Verdict


def run(
    paths: Sequence[Path], out: Path, avoider: str | None = None, against: str | None = None, **options: Any
) -> int:
    """Run, print and write the report; returns the exit code.  ``options`` as of ``safety_harness.run``."""
    say_shared_modules()
    try:
        found = run_scenarios(paths, avoider=avoider, against=against, out=out, output=TERMINAL, **options)
    except InputErrors as error:
        go_on = "; --keep-going runs the others" if error.left else ""
        say(f"{len(error.errors)} of the inputs cannot be used; nothing was run{go_on}.")
        return BAD_INPUT
    except KeyboardInterrupt:
        say("interrupted: nothing was run")
        return INTERRUPTED
    if found.runs:
        try:
            found = found.write(out, output=TERMINAL)
        except OutputError as error:
            explain(error)
            return INTERRUPTED if found.interrupted else BAD_INPUT
        except KeyboardInterrupt:
            say(f"no report was written; the traces are in {out / TRACES}")
            return INTERRUPTED
        document(**json.loads((out / DATA).read_text("utf-8")), failed=found.failed)
    _say_summary(found)
    if found.runs:
        say(f"report: {out / REPORT} (for programs: {DATA})")
    _say_whose_fault(found.runs)
    return found.exit_code


def _say_summary(found: RunResult) -> None:
    """How often each claim was exercised, what the runs cost, and how many verdicts are as expected."""
    coverage = found.coverage
    say(*table_lines(coverage, columns_of(sys.stderr)), *far_lines(coverage))
    if untested := untested_lines(coverage):
        say(f"error: {untested[0]}", *untested[1:])
        say("  What hands do is drawn by: safety-harness show FILE")
    say(*[found.basis] * bool(found.runs))
    traces = [run.trace for run in found.runs]
    say(*(f"computing time: {line}" for line in computing_time_lines(traces)))
    say(*(f"shield: {line}" for line in shield_lines(traces)))
    say(*(f"gate: {line}" for line in possible_lines(traces)))
    say(*overruling_lines(overruling_of_each(traces)))
    verdicts, others = as_expected(found.runs)
    fallback = DecisionTally.of(traces).fallback
    say(
        f"{sum(verdicts)} of {len(verdicts)} verdicts as expected, "
        f"{len(found.runs)} of {found.planned + len(found.skipped)} scenarios run"
        + (f", {others} claims not applicable to the controller" if others else "")
        + (f", {not_taken_words(found.skipped)}" if found.skipped else "")
        + (f", {len(found.refused)} of the inputs cannot be used" if found.refused else "")
        + (f"; {fallback}" if fallback else "")
    )
    if found.against is not None:
        result(*found.against.lines())


def _say_whose_fault(found: Sequence[JudgedRun]) -> None:
    """The commands that attribute what was violated and not expected to be: one for each avoider."""
    wrong: dict[str, list[JudgedRun]] = {}
    for one in found:
        if any(e.verdict is Verdict.VIOLATED is not c.given(e.margin) for c, e in one.judged_claims()):
            wrong.setdefault(command_line_reference(one.trace.scenario), []).append(one)
    for runs in wrong.values():
        files = [one.trace_file for one in runs if one.trace_file is not None]
        command = replay_command(runs[0].trace.scenario, *files, verb="attribute", told=Path)
        say(f"whose fault: {command}")
