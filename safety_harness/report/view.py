"""What the page shows of each run, as plain values: the template only places them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from safety_harness.properties.base import Evaluation
from safety_harness.report.evidence import JudgedRun
from safety_harness.report.words import (
    MODE_WORDS,
    OUTCOME_WORDS,
    TRIGGER_WORDS,
    changed_settings,
    failed_words,
    flag_words,
    margin_words,
    point_words,
)
from safety_harness.scenario.model import RecordedHand, Verdict
from safety_harness.trace.records import Check, Limit, Outcome, Trigger
from safety_harness.trace.trace import Trace

MOST_DECISION_ROWS = 100  # a page with more is no longer read; the trace has them all
MOST_FAULT_NOTES = 5


@dataclass(frozen=True, kw_only=True)
class ClaimRow:
    """One row of the table of verdicts."""

    section: str  # id of the scenario's section
    scenario: str
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
class DecisionRow:
    """One row of the table of decisions."""

    number: int
    time: str
    trigger: str
    hand: str
    tcp: str
    proposed: str
    spread: str
    outcome: str
    failed: str
    chosen: str


@dataclass(frozen=True, kw_only=True)
class LimitRow:
    """One limit that acted, or one mode that occurred."""

    name: str
    ticks: int
    share: str
    first: str


def claim_rows(run: JudgedRun, section: str) -> list[ClaimRow]:
    """A row for each claim of ``run``."""
    return [
        ClaimRow(
            section=section,
            scenario=run.trace.scenario.title,
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


def _margin_sort(evaluation: Evaluation) -> str:
    return "" if evaluation.margin is None else f"{float(evaluation.margin)!r}"


def _seconds(time_s: float | None) -> str:
    return "\u2013" if time_s is None else f"{time_s:.2f} s"


def decision_rows(trace: Trace) -> list[DecisionRow]:
    """A row for each of the first ``MOST_DECISION_ROWS`` decisions, positions in mm."""
    return [
        DecisionRow(
            number=number,
            time=f"{decision['time_s']:.3f}",
            trigger=TRIGGER_WORDS[Trigger(int(decision["trigger"]))],
            hand=point_words(decision["hand_position_in_base_m"]),
            tcp=point_words(decision["tcp_position_in_base_m"]),
            proposed=point_words(decision["proposed_position_in_base_m"]),
            spread=_spread(decision["proposed_spread_m"], float(decision["spread_threshold_m"])),
            outcome=OUTCOME_WORDS[Outcome(int(decision["outcome"]))],
            failed=failed_words(
                Check(int(decision["proposed_failed"])),
                Check(int(decision["opposite_failed"])),
                str(decision["fault"]),
            ),
            chosen=point_words(decision["chosen_position_in_base_m"]),
        )
        for number, decision in enumerate(trace.decisions[:MOST_DECISION_ROWS], start=1)
    ]


def _spread(spread_m: NDArray[np.float64], threshold_m: float) -> str:
    """A predictive spread and what it may be, in words; nothing for an avoider that states none."""
    if not np.all(np.isfinite(spread_m)) or not np.any(spread_m):
        return ""
    allowed = f" (at most {threshold_m * 1e3:.1f})" if np.isfinite(threshold_m) else ""
    return point_words(spread_m) + allowed


def fault_notes(trace: Trace) -> list[str]:
    """A sentence on each way in which the avoider gave no usable answer, the first ones first."""
    decisions = trace.decisions
    counts = Counter(str(fault) for fault in decisions["fault"] if fault)
    found = []
    for fault, count in list(counts.items())[:MOST_FAULT_NOTES]:
        first = decisions["time_s"][int(np.argmax(decisions["fault"] == fault))]
        often = f"{count} of {len(decisions)} decisions, first at {first:.3f} s"
        found.append(f"The avoider gave no usable answer ({often}): {fault}")
    if len(counts) > MOST_FAULT_NOTES:
        found.append(f"and in {len(counts) - MOST_FAULT_NOTES} other ways; the trace has them all")
    return found


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
    first = f"{trace.time_s[int(np.argmax(mask))]:.2f} s" if ticks else ""
    share = f"{100.0 * ticks / max(1, len(mask)):.1f} %"
    return LimitRow(name=name, ticks=ticks, share=share, first=first)


def notes(run: JudgedRun) -> list[str]:
    """What the reader has to know: decision faults, the caller's notes, what recordings bridged."""
    found = fault_notes(run.trace) + list(run.notes)
    for hand in run.trace.scenario.hands:
        if isinstance(hand, RecordedHand):
            found += [f"{hand.name}: {note}" for note in hand.motion.notes if note not in run.notes]
    return found


def changes(run: JudgedRun) -> list[tuple[str, str, str]]:
    """(setting, default, this run) where they differ."""
    return changed_settings(run.trace.scenario.settings)


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

    @property
    def clear(self) -> bool:
        """Nothing that has to be said before the numbers: every claim holds or fails as expected."""
        return self.claims > 0 and not (
            self.interrupted or self.differing or self.inconclusive or self.cut_short or self.without_claims
        )


def summarise(runs: Sequence[JudgedRun], *, interrupted: bool) -> Summary:
    """Counts over all runs."""
    return Summary(
        runs=len(runs),
        claims=sum(len(run.evaluations) for run in runs),
        holds=sum(run.count(Verdict.HOLDS) for run in runs),
        violated=sum(run.count(Verdict.VIOLATED) for run in runs),
        inconclusive=sum(run.count(Verdict.INCONCLUSIVE) for run in runs),
        differing=sum(run.as_expected.count(False) for run in runs),
        cut_short=sum(not run.trace.complete for run in runs),
        without_claims=sum(not run.evaluations for run in runs),
        interrupted=interrupted,
    )
