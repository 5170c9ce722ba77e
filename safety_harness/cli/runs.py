"""What is said of runs: a line for each claim."""

from __future__ import annotations

from safety_harness.cli.console import result
from safety_harness.report.evidence import JudgedRun


def say_results(run: JudgedRun) -> None:
    """One line for each claim of a run, and one more for what could not be judged for want of measurement."""
    for claim, evaluation in run.judged_claims():
        same = evaluation.verdict is claim.expected
        mark = "ok  " if same else "DIFF"
        when = "-" if evaluation.worst_time_s is None else f"{evaluation.worst_time_s:.3f} s"
        expected = "" if same else f"  (expected {claim.expected.value})"
        result(
            f"{mark} {evaluation.verdict.value:<12} {evaluation.margin_text():>13} at {when:>9}  "
            f"{run.trace.scenario.name}: {claim.sentence}{expected}"
        )
        if evaluation.unmeasured:
            result(f"     {evaluation.reason}")
