"""Define ``safety_harness.read_log``, a function that reads the log of a real cell, and its return type."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from safety_harness.extensions.field.logs.assumptions import Assumption, assumptions_of
from safety_harness.extensions.field.logs.certain import LoggedTrace, trace_from_log
from safety_harness.extensions.field.logs.model import CellLog
from safety_harness.extensions.field.logs.read import read_log as read_description
from safety_harness.report.evidence import JudgedRun, basis_of, worst_verdict
from safety_harness.report.judge_job import judged_run, write_judged
from safety_harness.trace.trace import Trace

__all__ = ["LogResult", "read_log"]


def read_log(file: str | Path) -> LogResult:
    """Read the log of a real cell, and return it as a trace.

    Args:
        file: The description of the log, ``LOG.yaml``.

    Raises:
        InputError: The log contradicts itself or its description, or cannot be read.

    """
    log = read_description(file)
    return LogResult(Path(file), log, trace_from_log(log))


@dataclass(frozen=True, eq=False, repr=False)
class LogResult:
    """A log in the form of a trace.

    If the log does not contain a column, the trace marks this column as not measured.

    Args:
        file: The description of the log.
        log: The recorded data.
        recorded: The trace, its recordings, and notes on the parts that are not measured.

    """

    file: Path
    log: CellLog
    recorded: LoggedTrace

    @property
    def trace(self) -> Trace:
        """The run as a trace."""
        return self.recorded.trace

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on the columns, tracks and intervals that are not measured."""
        return self.recorded.notes

    @property
    def assumptions(self) -> tuple[Assumption, ...]:
        """The assumptions on which verdicts on the log depend, each with the evidence that confirms it."""
        return tuple(assumptions_of(self.log))

    def judge(self, *claims: str) -> JudgedRun:
        """Judge the log.

        Args:
            claims: Sentences that should hold. If there are no sentences, the method judges the claims in the
                log's own file.

        Raises:
            InputError: There is no claim, or a claim cannot be read.

        """
        return judged_run(self.file, claims)

    def __repr__(self) -> str:
        if not self.trace.scenario.claims:
            return f"<{self.file.name}: {len(self.trace.ticks)} ticks, no claims of its own>"
        run = self.judge()
        verdict = worst_verdict(claim.verdict for claim in run.evaluations)
        return f"<{verdict.value}: {self.file.name}, {len(run.evaluations)} claims. {basis_of([run])}>"

    def write(self, folder: str | Path, *claims: str) -> JudgedRun:
        """Judge the log, and write report.html, report.json and the trace.

        Args:
            folder: The folder for the files.
            claims: As for ``judge``.

        Raises:
            OutputError: A file cannot be written.

        """
        run = judged_run(self.file, claims, Path(folder))
        write_judged([run], [], Path(folder), [self.file])
        return run
