"""What the page shows of each run, as plain values: the template only places them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from safety_harness.properties.tally import ClaimTally
from safety_harness.report.computing_time import computing_time_lines
from safety_harness.report.decisions import DecisionTally, avoiders
from safety_harness.report.evidence import JudgedRun
from safety_harness.report.words import (
    MODE_WORDS,
    changed_settings,
    count_words,
    flag_words,
    margin_words,
    share_words,
)
from safety_harness.scenario.faults import fault_words
from safety_harness.scenario.model import RecordedHand, Robot, Verdict
from safety_harness.trace.records import Limit
from safety_harness.trace.trace import Trace

Row = dict[str, object]


def claim_rows(run: JudgedRun, section: str) -> list[Row]:
    """A row of the table of verdicts for each claim of ``run``, whose section has the id ``section``."""
    tally = DecisionTally.of([run.trace])
    judged = zip(run.judged_claims(), run.as_expected, strict=True)
    return [
        {
            "section": section,
            "scenario": run.trace.scenario.title,
            "file": file_name(run),
            "tally": tally,
            "again": number > 1,  # another claim of the same scenario stands above
            "number": number,
            "sentence": claim.sentence,
            "read_as": found.sentence
            if found.sentence != claim.sentence
            else "",  # the catalogue's own wording
            "verdict": found.verdict.value,
            "expected": claim.expected.value,
            "as_expected": expected,
            "margin": margin_words(found),
            "margin_sort": "" if found.margin is None else f"{float(found.margin)!r}",
            "worst": "\u2013" if found.worst_time_s is None else f"{found.worst_time_s:.3f} s",
            "worst_sort": "" if found.worst_time_s is None else f"{found.worst_time_s!r}",
            "reason": found.reason,
        }
        for number, ((claim, found), expected) in enumerate(judged, start=1)
    ]


def coverage_rows(tallies: Sequence[ClaimTally]) -> list[Row]:
    """A row for each claim over all runs: how often it was put to the test, and its least margin."""
    return [
        {
            "tally": tally,
            "worst": margin_words(tally.worst.evaluation) if tally.worst else "\u2013",
            "worst_run": tally.worst.run if tally.worst else "",
        }
        for tally in tallies
    ]


def file_name(run: JudgedRun) -> str:
    """What the scenario's file is called, and which one of its matrix this is; its name without a file."""
    scenario = run.trace.scenario
    if scenario.file is None:
        return scenario.name
    label = scenario.name.removeprefix(scenario.file.stem)  # which one of a matrix
    return scenario.file.name + (f" {label}" if label.startswith("[") else "")


def limit_rows(trace: Trace) -> list[Row]:
    """Each limit that acted on at least one tick."""
    acted = trace.ticks["limits"]
    rows = [_ticks_row(flag_words(flag), trace, (acted & flag.value) != 0) for flag in Limit if flag]
    return [row for row in rows if row["ticks"]]


def mode_rows(trace: Trace) -> list[Row]:
    """Each controller mode that occurred."""
    rows = [_ticks_row(words, trace, trace.ticks["mode"] == mode) for mode, words in MODE_WORDS.items()]
    return [row for row in rows if row["ticks"]]


def _ticks_row(name: str, trace: Trace, mask: NDArray[np.bool_]) -> Row:
    ticks = int(mask.sum())
    first = f"{trace.time_s[int(np.argmax(mask))]:.3f} s" if ticks else ""
    return {"name": name, "ticks": ticks, "share": share_words(ticks, len(mask)), "first": first}


def notes(run: JudgedRun) -> list[str]:
    """What the reader has to know: the caller's notes, what recordings bridged, which faults acted."""
    found = list(run.notes)
    for hand in run.trace.scenario.hands:
        if isinstance(hand, RecordedHand):
            found += [f"{hand.name}: {note}" for note in hand.motion.notes if note not in run.notes]
    return found + acted_faults(run.trace)


def acted_faults(trace: Trace) -> list[str]:
    """A sentence on each fault of the scenario, and on how many ticks it acted."""
    found = []
    for k, fault in enumerate(trace.scenario.faults):
        mask = (trace.ticks["faults"] >> k & 1) != 0
        ticks = int(np.count_nonzero(mask))
        when = f"first at {trace.time_s[int(np.argmax(mask))]:.3f} s" if ticks else "so it changed nothing"
        found.append(
            f"Fault: {fault_words(fault)}. It acted on {count_words(ticks, 'tick', 'ticks')}, {when}."
        )
    return found


def changes(run: JudgedRun) -> list[tuple[str, str, str]]:
    """(setting, default, this run) where they differ, the robot first."""
    scenario = run.trace.scenario
    robot = [("robot", Robot.UR10.value, scenario.robot.value)] if scenario.robot is not Robot.UR10 else []
    return robot + changed_settings(scenario.settings)


@dataclass(frozen=True, kw_only=True)
class Summary:
    """The first thing that the reader sees."""

    runs: int
    claims: int
    holds: int
    violated: int
    inconclusive: int
    differing: int
    cut_short: int
    without_claims: int
    interrupted: bool
    avoiders: list[tuple[str, int]]  # name, runs
    computing_time: tuple[str, ...]
    decisions: DecisionTally

    @property
    def clear(self) -> bool:
        """Nothing that has to be said before the numbers: every claim holds or fails as expected."""
        return self.claims > 0 and not (
            self.interrupted or self.differing or self.inconclusive or self.cut_short or self.without_claims
        )


def summarise(runs: Sequence[JudgedRun], *, interrupted: bool) -> Summary:
    """Counts over all runs."""
    traces = [run.trace for run in runs]
    return Summary(
        runs=len(runs),
        claims=sum(len(run.as_expected) for run in runs),
        holds=sum(run.count(Verdict.HOLDS) for run in runs),
        violated=sum(run.count(Verdict.VIOLATED) for run in runs),
        inconclusive=sum(run.count(Verdict.INCONCLUSIVE) for run in runs),
        differing=sum(run.as_expected.count(False) for run in runs),
        cut_short=sum(not run.trace.complete for run in runs),
        without_claims=sum(not run.trace.scenario.claims for run in runs),
        interrupted=interrupted,
        avoiders=avoiders(traces),
        computing_time=tuple(computing_time_lines(traces)),
        decisions=DecisionTally.of(traces),
    )
