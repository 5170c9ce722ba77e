"""What the page shows of each run, as plain values: the template only places them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from safety_harness.properties.base import Evaluation
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
from safety_harness.scenario.fault_phrases import fault_words
from safety_harness.scenario.model import RecordedHand, Robot, Verdict
from safety_harness.trace.records import Limit
from safety_harness.trace.trace import Trace


@dataclass(frozen=True, kw_only=True)
class ClaimRow:
    """One row of the table of verdicts."""

    section: str  # id of the scenario's section
    scenario: str
    file: str
    tally: DecisionTally
    again: bool  # another claim of the same scenario stands above
    number: int
    sentence: str
    read_as: str  # the catalogue's own wording, when it differs
    verdict: str
    expected: str
    as_expected: bool
    margin: str
    margin_sort: str
    worst: str
    worst_sort: str
    reason: str


@dataclass(frozen=True, kw_only=True)
class CoverageRow:
    """One claim over all runs of the page."""

    tally: ClaimTally
    worst: str
    worst_run: str


@dataclass(frozen=True, kw_only=True)
class LimitRow:
    """One limit that acted, or one mode that occurred."""

    name: str
    ticks: int
    share: str
    first: str


def claim_rows(run: JudgedRun, section: str) -> list[ClaimRow]:
    """A row for each claim of ``run``."""
    tally = DecisionTally.of([run.trace])
    return [
        ClaimRow(
            section=section,
            scenario=run.trace.scenario.title,
            file=file_name(run),
            tally=tally,
            again=number > 1,
            number=number,
            sentence=claim.sentence,
            read_as=evaluation.sentence if evaluation.sentence != claim.sentence else "",
            verdict=evaluation.verdict.value,
            expected=claim.expected.value,
            as_expected=expected,
            margin=margin_words(evaluation),
            margin_sort=_margin_sort(evaluation),
            worst=_seconds(evaluation.worst_time_s),
            worst_sort="" if evaluation.worst_time_s is None else f"{evaluation.worst_time_s!r}",
            reason=evaluation.reason,
        )
        for number, ((claim, evaluation), expected) in enumerate(
            zip(run.judged_claims(), run.as_expected, strict=True), start=1
        )
    ]


def coverage_rows(tallies: Sequence[ClaimTally]) -> list[CoverageRow]:
    """A row for each claim: how often it was put to the test, and its least margin."""
    return [
        CoverageRow(
            tally=tally,
            worst=margin_words(tally.worst.evaluation) if tally.worst else "\u2013",
            worst_run=tally.worst.run if tally.worst else "",
        )
        for tally in tallies
    ]


def file_name(run: JudgedRun) -> str:
    """What the scenario's file is called, and which one of its matrix this is; its name without a file."""
    scenario = run.trace.scenario
    if scenario.file is None:
        return scenario.name
    label = scenario.name.removeprefix(scenario.file.stem)  # which one of a matrix
    return scenario.file.name + (f" {label}" if label.startswith("[") else "")


def _margin_sort(evaluation: Evaluation) -> str:
    return "" if evaluation.margin is None else f"{float(evaluation.margin)!r}"


def _seconds(time_s: float | None) -> str:
    return "\u2013" if time_s is None else f"{time_s:.3f} s"


def limit_rows(trace: Trace) -> list[LimitRow]:
    """Each limit that acted on at least one tick."""
    acted = trace.ticks["limits"]
    rows = [_ticks_row(flag_words(flag), trace, (acted & flag.value) != 0) for flag in Limit if flag]
    return [row for row in rows if row.ticks]


def mode_rows(trace: Trace) -> list[LimitRow]:
    """Each controller mode that occurred."""
    rows = [_ticks_row(words, trace, trace.ticks["mode"] == mode) for mode, words in MODE_WORDS.items()]
    return [row for row in rows if row.ticks]


def _ticks_row(name: str, trace: Trace, mask: NDArray[np.bool_]) -> LimitRow:
    ticks = int(mask.sum())
    first = f"{trace.time_s[int(np.argmax(mask))]:.3f} s" if ticks else ""
    return LimitRow(name=name, ticks=ticks, share=share_words(ticks, len(mask)), first=first)


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
