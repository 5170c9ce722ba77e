"""Define the result of ``safety_harness.run``, and write its files."""

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
from safety_harness.admission.taking import Incompatible
from safety_harness.base.exceptions import InputError, OutputError
from safety_harness.base.extension_points import ExtensionPoint, optional_part, part_named
from safety_harness.base.interrupts import one_more_ctrl_c
from safety_harness.base.output import AS_EXPECTED, BAD_INPUT, DIFFERS, INTERRUPTED, QUIET, Output
from safety_harness.base.whole_file import write_text, writing
from safety_harness.claims.properties.against import Against
from safety_harness.claims.properties.base import Evaluation
from safety_harness.claims.properties.tally import ClaimTally, untested_lines
from safety_harness.report.evidence import JudgedRun, as_expected, basis_of, tallies, worst_verdict
from safety_harness.scenario.files import display_path
from safety_harness.scenario.model import Scenario, Verdict
from safety_harness.scenario.write import write_scenario
from safety_harness.trace.store import save_trace
from safety_harness.trace.trace import Trace

REPORT, DATA, TRACES = "report.html", "report.json", "traces"
GIVEN = "scenarios"  # the subfolder for scenarios that had no file


@dataclass(frozen=True, eq=False, repr=False)
class RunResult:
    """The judged runs of one call of ``run``, and the errors of inputs that could not run.

    Args:
        runs: The finished runs, in order.
        given: The unchanged inputs that the caller passed.
        options: The command-line options that repeat the runs.
        planned: The number of scenarios that were to run.
        skipped: Scenarios that did not run because they do not suit the avoider.
        refused: The errors of inputs that could not be used.
        failed: Scenarios that could not be simulated to their end, with the reasons.
        against: The differences from the reference's runs, or None if there is no reference.
        repeated: The answers of a second instance of the avoider to the same queries, or None if there was no
            second instance.
        interrupted: Whether Ctrl-C ended the runs.
        unwritable: The error that prevented the writing of a file, or None if all files were written.
        mcap: Whether to write each run also as an MCAP file.

    """

    runs: tuple[JudgedRun, ...] = ()
    _: KW_ONLY
    given: tuple[Path | Scenario, ...] = ()
    options: tuple[str, ...] = ()
    planned: int = 0
    skipped: tuple[Incompatible, ...] = ()
    refused: tuple[InputError, ...] = ()
    failed: tuple[str, ...] = ()
    against: Against | None = None
    repeated: RepeatabilityResult | None = None
    interrupted: bool = False
    unwritable: OutputError | None = None
    mcap: bool = False

    @property
    def verdict(self) -> Verdict:
        """Return the worst verdict of all claims, or inconclusive if there are no claims."""
        return worst_verdict(evaluation.verdict for run in self.runs for _, evaluation in run.judged_claims())

    @property
    def trace(self) -> Trace:
        """Return the trace of the only run.

        Raise InputError unless there is exactly one run.
        """
        if len(self.runs) != 1:
            raise InputError.of_option("RunResult.trace", "the result of one run", f"{len(self.runs)} runs")
        return self.runs[0].trace

    @property
    def coverage(self) -> tuple[ClaimTally, ...]:
        """Return how often the runs exercised each claim."""
        return tallies(self.runs)

    @property
    def basis(self) -> str:
        """Return a sentence on the world, the exercised claims, and the aspects that no claim monitors."""
        return basis_of(self.runs)

    @property
    def exit_code(self) -> int:
        """Return the command's exit code."""
        if self.unwritable is not None:
            return BAD_INPUT
        if self.interrupted:
            return INTERRUPTED
        if self.refused:
            return BAD_INPUT
        if self.against is None:
            verdicts, rest = as_expected(self.runs)
            untested = untested_lines(self.coverage)
            good = all(verdicts) and bool(verdicts or not rest) and not (untested or self.skipped)
        else:  # runs that cannot be compared show no difference
            good = len(self.against.runs) == self.planned and not self.against.worse
        good &= self.repeated is None or not self.repeated.problem
        return AS_EXPECTED if good and not self.failed else DIFFERS

    def __getitem__(self, sentence: str) -> Evaluation:
        """Return the evaluation of the claim ``sentence``.

        If several runs have the claim, return the worst evaluation.

        Raises:
            InputError: No run has the claim.

        """
        matches = [e for run in self.runs for claim, e in run.judged_claims() if claim.sentence == sentence]
        if not matches:
            claims = dict.fromkeys(claim.sentence for run in self.runs for claim, _ in run.judged_claims())
            raise InputError.of_option("RunResult[claim]", f"one of: {', '.join(claims)}", repr(sentence))
        worst = worst_verdict(run.verdict for run in matches)
        return min(
            (e for e in matches if e.verdict is worst), key=lambda e: (e.margin is None, e.margin or 0.0)
        )

    def __repr__(self) -> str:
        names = [run.trace.scenario.name for run in self.runs]
        label = names[0] if len(names) == 1 else f"{len(names)} of {self.planned} scenarios"
        kinds = [e.verdict for run in self.runs for _, e in run.judged_claims()]
        counts = ", ".join(f"{kinds.count(kind)} {kind.value}" for kind in Verdict if kind in kinds)
        return f"<{self.verdict.value}: {label}, claims: {counts or 'none'}. {self.basis}>"

    def data(self) -> dict[str, Any]:
        """Return the content of report.json.

        The method writes the traces first, because the content includes their hashes.
        """
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
        """Write report.html, report.json, report.sarif, summary.md, and each trace that the folder lacks.

        The method also writes a file for each scenario without a file, because the report's command needs
        files. The method finishes writing even if the user has pressed Ctrl-C once.

        Args:
            folder: The folder to write into.
            output: The ``Output`` that shows the progress.

        Returns:
            This result, whose runs now refer to the traces in ``folder``.

        Raises:
            OutputError: The folder cannot be written.

        """
        out = Path(folder)
        remark = f"writing {out / REPORT}; Ctrl-C once more gives it up"
        with one_more_ctrl_c(output.say, remark) as stopped:
            runs = tuple(self._kept(run, out) for run in self.runs)
            title = "Safety verification of a hand-avoiding robot arm"
            write_files(out, runs, title=title, command=self._command(out), **self._of_all)
        return replace(self, runs=runs, interrupted=self.interrupted or stopped())

    def _kept(self, run: JudgedRun, out: Path) -> JudgedRun:
        """Return the run with its trace file in the folder ``out``.

        The method writes the trace file if the folder does not contain it.
        """
        if run.trace_file is not None and run.trace_file.parent == out / TRACES:
            return run
        file = saved(run.trace, out / TRACES)
        if self.mcap:
            save_mcap(run, file)
        return replace(
            run,
            trace_file=file,
            replay_command=replay_command(run.trace.scenario, file, made_in=run.trace.provenance.world),
        )

    def _command(self, out: Path) -> str:
        """Return the command line that repeats these runs.

        Scenarios without a file are written to files.
        """
        parts = ["safety-harness", "run"]
        for item in self.given:
            file = item if isinstance(item, Path) else out / GIVEN / f"{item.name}.yaml"
            if isinstance(item, Scenario):
                write_text(file, write_scenario(as_seen_from(file.parent, item)))
            parts.append(str(display_path(file)))
        return shlex.join([*parts, "--out", str(display_path(out)), *self.options])


def write_files(out: Path, runs: Sequence[JudgedRun], *, title: str, command: str, **of_all: Any) -> None:
    """Write the report of runs in three forms, which are for a browser, for programs, and for CI.

    Args:
        out: The folder.
        runs: The judged runs.
        title: The title of the page.
        command: The command line that the page shows.
        of_all: Additional arguments for ``safety_harness.write_report`` and ``report_data``.

    Raises:
        OutputError: The folder cannot be written.

    """
    from safety_harness.report.ci_formats import write_for_ci
    from safety_harness.report.machine import report_data, write_json

    with writing(out / REPORT):
        now = datetime.now(UTC)
        draw_page("runs", out / REPORT, runs, title=title, command=command, generated_at=now, **of_all)
        write_json(out / DATA, report_data(runs, **of_all))
        write_for_ci(out, runs)


def report_line(folder: Path) -> str:
    """Return a line that names the page in ``folder``, or its JSON file if no package draws pages."""
    page = folder / REPORT
    return f"report: {page} (for programs: {DATA})" if page.exists() else f"report: {folder / DATA}"


def draw_page(name: str, path: Path, content: object, **details: object) -> bool:
    """Write a page or picture, and return whether a package draws it.

    If no package draws it, remove an earlier file, which a reader would take for the file of this result.

    Args:
        name: The name of the entry point, such as ``runs``.
        path: The file.
        content: The result that the page shows.
        **details: Further arguments of the function that draws.

    Raises:
        OutputError: The file cannot be written.

    """
    draw = optional_part(ExtensionPoint.PAGES, name, FunctionType)
    if draw is None:
        path.unlink(missing_ok=True)
        return False
    draw(path, content, **details)
    return True


def saved(trace: Trace, folder: Path, recordings: Mapping[str, bytes] | None = None) -> Path:
    """Write ``trace`` to ``folder`` and return the file.

    Raise OutputError if the file cannot be written.
    """
    file = folder / f"{trace.scenario.name}.trace"
    with writing(file):
        file.parent.mkdir(parents=True, exist_ok=True)
        save_trace(trace, file, recordings)
    return file


def save_mcap(run: JudgedRun, file: Path) -> Path:
    """Write a run as MCAP into a folder beside its trace file, and return that folder."""
    write_mcap = part_named(ExtensionPoint.RUN_FORMATS, "mcap", FunctionType)
    folder = file.with_suffix("")
    write_mcap(run.trace, run.evaluations, folder / "run.mcap")
    return folder
