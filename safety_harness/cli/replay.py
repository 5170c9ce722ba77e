"""``safety-harness replay`` and ``judge``: a stored trace repeated, or judged again."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from safety_harness.admission.admit import admit
from safety_harness.admission.trial import judge, run_trial
from safety_harness.cli.console import (
    AS_EXPECTED,
    BAD_INPUT,
    DIFFERS,
    ScenarioProgress,
    explain,
    result,
    result_lines,
    say,
)
from safety_harness.exceptions import InputError
from safety_harness.report.evidence import JudgedRun
from safety_harness.trace.compare import first_difference
from safety_harness.trace.provenance import provenance
from safety_harness.trace.store import load_trace
from safety_harness.trace.trace import Provenance


def replay(path: Path) -> int:
    """Repeat a recorded run: "identical", or the first step that differs."""
    try:
        stored = load_trace(path)
        admitted = admit(stored.scenario)
    except InputError as error:
        explain(error)
        return BAD_INPUT
    progress = ScenarioProgress([stored.scenario])
    with progress.running():
        progress.begin(0)
        fresh = run_trial(admitted, on_tick=progress.tick)
    difference = first_difference(stored, fresh)
    if difference is None:
        result(
            f"identical: {stored.scenario.name}, {len(fresh.ticks)} ticks, {len(fresh.decisions)} decisions"
        )
        return AS_EXPECTED
    result(f"{stored.scenario.name}: {difference}")
    for line in changes(stored.provenance, provenance(fresh.provenance.world, fresh.provenance.avoider)):
        say(line)
    return DIFFERS


def changes(stored: Provenance, now: Provenance) -> list[str]:
    """What is not the same as when the trace was made."""
    lines = []
    for name in ("package_version", "source_hash", "world", "avoider", "python", "platform"):
        before, after = getattr(stored, name), getattr(now, name)
        if before != after:
            lines.append(f"  {name}: {before} then, {after} now")
    versions = dict(now.libraries)
    for name, before in stored.libraries:
        if versions.get(name) != before:
            lines.append(f"  {name}: {before} then, {versions.get(name, 'absent')} now")
    return lines or ["  the software is the same as when the trace was made"]


def judge_again(paths: Sequence[Path]) -> int:
    """Judge stored traces by their claims, with the present code, without simulating."""
    code = AS_EXPECTED
    for path in paths:
        try:
            trace = load_trace(path)
            run = JudgedRun(trace=trace, evaluations=judge(trace), replay_command="", notes=())
        except InputError as error:
            explain(error)
            return BAD_INPUT
        for line in result_lines(run):
            result(line)
        if any(
            e.verdict is not c.expected for e, c in zip(run.evaluations, trace.scenario.claims, strict=True)
        ):
            code = DIFFERS
    return code
