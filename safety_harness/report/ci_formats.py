"""Write the verdicts for code review: SARIF for remarks on lines of files, and Markdown for a summary."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

from safety_harness.base.distribution import installed_version
from safety_harness.base.whole_file import write_whole
from safety_harness.claims.properties.base import Evaluation
from safety_harness.report.evidence import JudgedRun, answer, basis_of
from safety_harness.report.words import margin_words, tested_words
from safety_harness.scenario.files import display_path
from safety_harness.scenario.model import Claim, Verdict
from safety_harness.trace.limiting import limit_lines

SCHEMA = "https://json.schemastore.org/sarif-2.1.0.json"
SUMMARY, SARIF = "summary.md", "report.sarif"
MOST_LINES = 50  # in a summary, because the summary of a CI job is limited
MOST_TESTED = 3  # systems under test that a summary names


def write_for_ci(folder: Path, runs: Sequence[JudgedRun]) -> None:
    """Write ``summary.md`` and ``report.sarif`` into ``folder``.

    Raise OSError if the writing fails.
    """
    write_whole(folder / SUMMARY, markdown(runs))
    write_whole(folder / SARIF, json.dumps(sarif(runs), indent=1) + "\n")


def _reported(runs: Sequence[JudgedRun]) -> Iterator[tuple[JudgedRun, Claim, Evaluation, bool]]:
    """Yield all unexpected verdicts, then the expected violations.

    The last item of each tuple states whether the verdict is as expected.
    """
    for wanted in (False, True):
        for run in runs:
            for (claim, evaluation), expected in zip(run.judged_claims(), run.as_expected, strict=True):
                if expected is wanted and (not expected or evaluation.verdict is Verdict.VIOLATED):
                    yield run, claim, evaluation, expected


def markdown(runs: Sequence[JudgedRun]) -> str:
    """Return a job's summary in Markdown.

    The summary has the overall result and a table of unexpected verdicts and violations.
    """
    rows = list(_reported(runs))
    lines = [f"### {answer(runs)}", ""]
    if rows:
        lines += ["| scenario | claim | verdict | expected | margin | at |", "|---|---|---|---|---|---|"]
    for run, claim, evaluation, expected in rows[:MOST_LINES]:
        verdict = evaluation.verdict.value if expected else f"**{evaluation.verdict.value}**"
        at = "" if evaluation.worst_time_s is None else f"{evaluation.worst_time_s:.3f} s"
        cells = (
            run.trace.scenario.name,
            claim.sentence,
            verdict,
            claim.expectation,
            margin_words(evaluation),
            at,
        )
        lines.append(f"| {' | '.join(map(_cell, cells))} |")
    if len(rows) > MOST_LINES:
        lines += ["", f"{len(rows) - MOST_LINES} more are in report.html."]
    for line in limit_lines(run.trace for run in runs):
        lines += ["", f"limits: {_cell(line)}"]
    tested = list(dict.fromkeys(tested_words(run.trace.scenario, run.trace.system) for run in runs))
    for part in tested[:MOST_TESTED]:
        lines += ["", f"tested: {_cell(part)}"]
    if len(tested) > MOST_TESTED:
        lines += ["", f"tested: {len(tested) - MOST_TESTED} more systems"]
    lines += ["", basis_of(runs)]
    return "\n".join(lines) + "\n"


def _cell(text: str) -> str:
    """Return ``text`` escaped so that it stays within its table cell and contains no markup."""
    plain = text.replace("&", "&amp;").replace("<", "&lt;")
    return " ".join(re.sub(r"[\\|`\[\]*!]", r"\\\g<0>", plain).split())


def sarif(runs: Sequence[JudgedRun]) -> dict[str, Any]:
    """Return SARIF 2.1.0 with a result for each unexpected verdict and for each violation.

    Each result refers to the line of its claim. An unexpected verdict has the level "error", and an expected
    violation has the level "note".
    """
    rows = list(_reported(runs))
    rules = dict.fromkeys(claim.sentence for _, claim, _, _ in rows)
    tool = {
        "name": "safety-harness",
        "version": installed_version(),
        "rules": [{"id": sentence, "shortDescription": {"text": sentence}} for sentence in rules],
    }
    results = [_result(run, claim, evaluation, expected) for run, claim, evaluation, expected in rows]
    run = {"tool": {"driver": tool}, "columnKind": "unicodeCodePoints", "results": results}
    run["properties"] = {"basis": basis_of(runs)}
    return {
        "$schema": SCHEMA,
        "version": "2.1.0",
        "runs": [run],
    }


def _result(run: JudgedRun, claim: Claim, evaluation: Evaluation, expected: bool) -> dict[str, Any]:
    at = "" if evaluation.worst_time_s is None else f" at {evaluation.worst_time_s:.3f} s"
    text = (
        f"{run.trace.scenario.name}: {claim.sentence}: {evaluation.verdict.value}, "
        f"expected {claim.expectation}; margin {margin_words(evaluation)}{at}; {evaluation.reason}"
    )
    result: dict[str, Any] = {
        "ruleId": claim.sentence,
        "level": "note" if expected else "error",
        "message": {"text": text},
    }
    file = claim.place.file or run.trace.scenario.file
    if file is not None:
        physical: dict[str, Any] = {"artifactLocation": {"uri": quote(display_path(file).as_posix())}}
        if claim.place.line is not None:
            physical["region"] = {"startLine": claim.place.line}
        result["locations"] = [{"physicalLocation": physical}]
    return result
