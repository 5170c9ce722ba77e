"""The result of ``safety_harness.run``, and the files that it writes."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from types import FunctionType
from typing import Any

from safety_harness.admission.avoiders import as_seen_from, replay_command
from safety_harness.admission.repeatability import RepeatabilityResult
from safety_harness.admission.taking import NotTaken
from safety_harness.base.exceptions import InputError, OutputError
from safety_harness.base.extension_points import ExtensionPoint, part_named
from safety_harness.base.interrupts import one_more_ctrl_c
from safety_harness.base.output import AS_EXPECTED, BAD_INPUT, DIFFERS, INTERRUPTED, QUIET, Output
from safety_harness.base.whole_file import write_text, writing
from safety_harness.claims.properties.against import Against
from safety_harness.claims.properties.base import Evaluation
from safety_harness.claims.properties.tally import ClaimTally, untested_lines
from safety_harness.report.evidence import JudgedRun, as_expected, basis_of, tallies, worst_verdict
from safety_harness.scenario.files import told
from safety_harness.scenario.model import Scenario, Verdict
from safety_harness.scenario.write import write_scenario
from safety_harness.trace.store import save_trace
from safety_harness.trace.trace import Trace

REPORT, DATA, TRACES = "report.html", "report.json", "traces"
GIVEN = "scenarios"  # of a folder that is written to: scenarios that were no files


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

    runs: tuple[JudgedRun, ...] = ()
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
        if self.against is None:
            verdicts, others = as_expected(self.runs)
            untested = untested_lines(self.coverage)
            good = all(verdicts) and bool(verdicts or not others) and not (untested or self.skipped)
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
        out = Path(folder)
        remark = f"writing {out / REPORT}; Ctrl-C once more gives it up"
        with one_more_ctrl_c(output.say, remark) as asked:
            runs = tuple(self._kept(one, out) for one in self.runs)
            title = "Safety verification of a hand-avoiding robot arm"
            write_files(out, runs, title=title, command=self._command(out), **self._of_all)
        return replace(self, runs=runs, interrupted=self.interrupted or asked())

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


def write_files(out: Path, runs: Sequence[JudgedRun], *, title: str, command: str, **of_all: Any) -> None:
    """Write the report of runs for a browser, for programs and for CI; OutputError.

    ``of_all`` is what ``write_report`` and ``report_data`` take besides.
    """
    from safety_harness.report.ci_formats import write_for_ci
    from safety_harness.report.html import write_report
    from safety_harness.report.machine import report_data, write_json

    with writing(out / REPORT):
        now = datetime.now(UTC)
        write_report(out / REPORT, runs, title=title, command=command, generated_at=now, **of_all)
        write_json(out / DATA, report_data(runs, **of_all))
        write_for_ci(out, runs)


def saved(trace: Trace, folder: Path, recordings: Mapping[str, bytes] | None = None) -> Path:
    """Return the file of a folder to which a trace is written; OutputError."""
    file = folder / f"{trace.scenario.name}.trace"
    with writing(file):
        file.parent.mkdir(parents=True, exist_ok=True)
        save_trace(trace, file, recordings)
    return file


def save_mcap(one: JudgedRun, file: Path) -> Path:
    """Return the folder beside a trace's file to which the run is written as MCAP."""
    write_mcap = part_named(ExtensionPoint.RUN_FORMATS, "mcap", FunctionType)
    folder = file.with_suffix("")
    write_mcap(one.trace, one.evaluations, folder / "run.mcap")
    return folder
