"""What a failed claim prints: margin, moment, the decision before it, a picture, how to see it again."""

from __future__ import annotations

import shlex
from pathlib import Path

import numpy as np

from safety_harness.properties.base import Evaluation
from safety_harness.report.decisions import DecisionRow, decision_rows
from safety_harness.report.words import count_words
from safety_harness.scenario.expand import gather
from safety_harness.scenario.model import Scenario, Verdict
from safety_harness.scenario.write import write_scenario
from safety_harness.testing.picture import picture
from safety_harness.testing.session import TestRun, session
from safety_harness.testing.simulating import digest_of
from safety_harness.trace.trace import Trace


def failure_text(
    evaluation: Evaluation, trace: Trace, *, expected: Verdict, scenario: Scenario, test: TestRun | None
) -> str:
    """The whole text; ``scenario`` is as the test asked for it, ``test`` the one that failed."""
    parts = [
        _verdict(evaluation, expected),
        _facts(evaluation, trace),
        _decision(evaluation, trace),
        picture(trace, evaluation),
        _scenario(scenario, test),
        again(scenario, test),
    ]
    return "\n\n".join("\n".join(part) for part in parts if part)


def _verdict(evaluation: Evaluation, expected: Verdict) -> list[str]:
    verdict = evaluation.verdict.value
    lines = [
        f"{evaluation.sentence}: {verdict}"
        + ("" if expected is Verdict.HOLDS else f", expected {expected.value}")
    ]
    if evaluation.verdict is Verdict.INCONCLUSIVE:
        lines.append("  no evidence either way, which a test does not take for a safe run")
    return lines


def _facts(evaluation: Evaluation, trace: Trace) -> list[str]:
    worst_s = evaluation.worst_time_s
    at = f" at {worst_s:.3f} s" if worst_s is not None else ""
    lines = [f"  margin    {evaluation.margin_text()}{at}"]
    lines.append(f"  because   {evaluation.reason}")
    lines += [
        f"  part      {part.sentence}: {part.verdict.value}, {part.margin_text()}"
        for part in evaluation.parts
    ]
    lines.append(f"  exercised {count_words(evaluation.exercised, 'time', 'times')}")
    lines.append(
        f"  run       {trace.scenario.name}, avoider {trace.provenance.avoider}, seed {trace.scenario.seed}"
    )
    if not trace.complete:
        lines.append(f"  ended     {trace.ended}")
    return lines


def _decision(evaluation: Evaluation, trace: Trace) -> list[str]:
    """The last decision up to the worst moment, the one that was in force then."""
    rows = decision_rows(trace)
    if not rows:
        return ["  no decision was made in this run"]
    worst_s = evaluation.worst_time_s
    times = trace.decisions["time_s"][: len(rows)]
    before = np.flatnonzero(times <= (np.inf if worst_s is None else worst_s))
    if not len(before):
        first = f"the first of {count_words(len(trace.decisions), 'decision', 'decisions')}"
        return [f"  no decision was made before that moment; {first} came at {float(times[0]):.3f} s"]
    return _row(rows[int(before[-1])], len(trace.decisions))


def _row(row: DecisionRow, count: int) -> list[str]:
    lines = [
        f"  decision  {row.number} of {count}, at {row.time} s, because: {row.trigger}",
        f"  predicted hand at ({row.hand}) mm, TCP at ({row.tcp}) mm",
        f"  proposed  ({row.proposed}) mm" + (f", spread {row.spread} mm" if row.spread else ""),
        f"  chosen    ({row.chosen}) mm: {row.outcome}",
    ]
    return [*lines, f"  failed    {row.failed}"] if row.failed != "none" else lines


def _scenario(scenario: Scenario, test: TestRun | None) -> list[str]:
    """The text of what was tried, unless it is a file that the reader has."""
    if (test is None or not test.draws) and _is_what_its_file_holds(scenario):
        assert scenario.file is not None
        return [f"  scenario  {near(scenario.file)}"]
    title = "the scenario, made smaller:" if test is not None and test.draws else "the scenario:"
    return [title, *(f"  {line}" for line in write_scenario(scenario).splitlines())]


def again(scenario: Scenario, test: TestRun | None) -> list[str]:
    """The commands that show the failure again."""
    avoider = session().avoider
    own = [] if avoider is None else ["--avoider", avoider]
    lines = []
    file = scenario.file if in_store(scenario) or _is_what_its_file_holds(scenario) else None
    file = file or (test.kept if test is not None else None)
    if test is not None:
        lines.append("  " + shlex.join(["pytest", test.id, *own]))
    if file is not None:
        lines.append("  " + shlex.join(["safety-harness", "run", str(near(file)), *own]))
    return ["to see it again:", *lines] if lines else []


def _is_what_its_file_holds(scenario: Scenario) -> bool:
    """Not a draw of a space, and not made from a file by other code."""
    if scenario.file is None:
        return False
    return digest_of(scenario) in map(digest_of, gather([scenario.file], spaces=True).scenarios)


def in_store(scenario: Scenario) -> bool:
    """Is it read from the folder of kept failures?"""
    file = scenario.file
    return file is not None and session().failures.resolve() in file.resolve().parents


def near(file: Path) -> Path:
    """As seen from the working directory, if it is below it."""
    try:
        return file.resolve().relative_to(Path.cwd())
    except ValueError:
        return file
