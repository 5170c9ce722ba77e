"""Describe the decisions of a run: the question, the outcome, and the computing time.

The computing time is the cost of decisions in simulated time, and their duration on the run's machine.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from safety_harness.base.settings import DecisionCost, DecisionTimes
from safety_harness.cell.avoidance.gate import leads_away
from safety_harness.claims.properties.answered import NOT_MODELLED, fallback_words, unanswered
from safety_harness.report.words import (
    CHECK_MEANINGS,
    OUTCOME_WORDS,
    TRIGGER_WORDS,
    count_words,
    failed_words,
    flag_words,
    milliseconds_words,
    point_words,
    spread_words,
)
from safety_harness.trace.answer_times import AnswersTook, most_cost_s
from safety_harness.trace.overruling import Overruling, answered, is_measured
from safety_harness.trace.records import Check, DecisionOutcome, Trigger
from safety_harness.trace.trace import Trace
from safety_harness.trace.unmeasured import as_measured, decided

MOST_DECISION_ROWS = 100  # nobody reads a page with more; the trace contains all of them
MOST_FAULT_NOTES = 5
FAR_M = 10.0  # beyond any arm of a cell; half a metre, taken for millimetres, is 500 m


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
    faulty: bool
    chosen: str
    certified: str = ""


@dataclass(frozen=True, kw_only=True)
class DecisionTally:
    """The number of decisions, and how often each outcome occurred.

    ``faults`` counts the decisions without a usable answer.  ``unanswered`` counts those ``faults`` that no
    fault of the scenario explains.  The tally leaves out traces that did not measure their decisions (see
    ``are_counted``).
    """

    made: int
    proposed: int
    opposite: int
    stops: int
    faults: int
    unanswered: int

    @classmethod
    def from_traces(cls, traces: Iterable[Trace]) -> DecisionTally:
        """Count the decisions of all ``traces`` together."""
        counts: Counter[int] = Counter()
        faults = missing = 0
        for trace in filter(are_counted, traces):
            counts.update(trace.decisions["outcome"].tolist())
            faults += int(np.count_nonzero(trace.decisions["fault"] != ""))
            missing += int(np.count_nonzero(unanswered(trace)))
        return cls(
            made=counts.total(),
            proposed=counts[DecisionOutcome.PROPOSED],
            opposite=counts[DecisionOutcome.OPPOSITE],
            stops=counts[DecisionOutcome.STOP],
            faults=faults,
            unanswered=missing,
        )

    @property
    def fallback(self) -> str:
        """Return how often the fallback replaced the avoider, for headlines; empty if it never did."""
        return fallback_words(self.unanswered, self.made)

    @property
    def fault_words(self) -> str:
        """Return how often the avoider gave no usable answer; empty if it always gave one."""
        return count_words(self.faults, "fault", "faults") if self.faults else ""

    @property
    def departures(self) -> list[str]:
        """Return brief texts on the outcomes that differ from what the avoider proposed."""
        of_all = f"of {count_words(self.made, 'decision', 'decisions')}"
        events = (("fell back to the opposite pose", self.opposite), ("stopped the arm", self.stops))
        return [f"{count} {of_all} {event}" for event, count in events if count]


def are_counted(trace: Trace) -> bool:
    """Return whether the trace measured the outcomes of its decisions."""
    return is_measured(trace) and decided(trace, "tick") and not trace.known.column("faults").limited


def avoiders(traces: Iterable[Trace]) -> list[tuple[str, int]]:
    """Return (name, runs) for every avoider or controller, in the order of their first runs."""
    return list(Counter(trace.system.tested.name for trace in traces).items())


def tested_words(traces: Iterable[Trace]) -> str:
    """Return the heading above the names of ``avoiders``: ``Avoider``, ``Controllers``, or both."""
    names = {trace.system.tested.name: trace.system.avoider is not None for trace in traces}
    kinds = [w for w, asks in (("Avoider", True), ("Controller", False)) if asks in names.values()]
    return " and ".join(kinds).capitalize() + "s" * (len(names) > 1)


def overruling_of_each(traces: Iterable[Trace]) -> dict[str, Overruling]:
    """Return the overruling of every avoider that made proposals, in the order of their first runs."""
    sums: dict[str, Overruling] = {}
    for trace in traces:
        name = trace.system.tested.name
        sums[name] = sums.get(name, Overruling()) + Overruling.from_traces([trace])
    return {name: row for name, row in sums.items() if row.proposals}


def overruling_lines(each: Mapping[str, Overruling]) -> list[str]:
    """Return a line on all avoiders together, then one line for each avoider if there are several."""
    whole = sum(each.values(), Overruling()).summary
    rows = [f"{name}: {row.summary}" for name, row in each.items() if len(each) > 1]
    return [whole, *rows] if whole else []


def decision_rows(trace: Trace) -> list[DecisionRow]:
    """Return a row for each of the first ``MOST_DECISION_ROWS`` decisions, with positions in mm.

    A dash stands for a value that was not measured.  The list is empty if the decision times were not
    measured.
    """
    if not decided(trace, "tick", "time_s"):
        return []
    trace = as_measured(trace)

    def known(text: str, *names: str) -> str:
        return text if decided(trace, *names) else "\u2013"

    return [
        DecisionRow(
            number=number,
            time=f"{decision['time_s']:.3f}",
            trigger=known(TRIGGER_WORDS[Trigger(int(decision["trigger"]))], "trigger"),
            hand=point_words(decision["hand_position_in_base_m"]),
            tcp=point_words(decision["tcp_position_in_base_m"]),
            proposed=point_words(decision["proposed_position_in_base_m"]),
            spread=spread_words(decision["proposed_spread_m"], float(decision["spread_threshold_m"])),
            outcome=known(OUTCOME_WORDS[DecisionOutcome(int(decision["outcome"]))], "outcome"),
            failed=known(
                failed_words(
                    Check(int(decision["proposed_failed"])),
                    Check(int(decision["opposite_failed"])),
                    str(decision["fault"]),
                ),
                *("proposed_failed", "opposite_failed", "fault"),
            ),
            faulty=bool(decision["fault"]),
            chosen=point_words(decision["chosen_position_in_base_m"]),
            certified="" if trace.certified is None else trace.certified.decisions[number - 1].summary,
        )
        for number, decision in enumerate(trace.decisions[:MOST_DECISION_ROWS], start=1)
    ]


def failed_checks(trace: Trace) -> list[tuple[str, str]]:
    """Return (name, meaning) of every check that some candidate of this run failed."""
    flags = trace.decisions["proposed_failed"] | trace.decisions["opposite_failed"]
    failed = int(np.bitwise_or.reduce(flags)) if len(flags) else 0
    return [(flag_words(check), CHECK_MEANINGS[check]) for check in Check if check and check & failed]


def fault_notes(trace: Trace) -> list[str]:
    """Return a sentence on each kind of unusable answer, in the order of their first occurrence.

    A sentence on answers that no arm reaches, perhaps in another unit than metres, comes first.
    """
    decisions = trace.decisions
    counts = Counter(str(fault) for fault in decisions["fault"] if fault)
    sentences = list(_far_words(trace))
    for fault, count in list(counts.items())[:MOST_FAULT_NOTES]:
        first = decisions["time_s"][int(np.argmax(decisions["fault"] == fault))]
        often = f"{count} of {len(decisions)} decisions, first at {first:.3f} s"
        sentences.append(f"The avoider gave no usable answer ({often}): {fault}")
    if len(counts) > MOST_FAULT_NOTES:
        sentences.append(f"and in {len(counts) - MOST_FAULT_NOTES} other ways; the trace has them all")
    return sentences


def _far_words(trace: Trace) -> Iterator[str]:
    """Yield a sentence if every proposed position is over ``FAR_M`` from the base."""
    proposed_m = trace.decisions["proposed_position_in_base_m"][answered(trace)]
    far_m = np.linalg.norm(proposed_m, axis=1)
    if len(far_m) and far_m.min() > FAR_M:
        where = f"every proposed position is {far_m.min():,.0f} m or more from the base"
        yield f"The gate refused all proposals, since {where}: are they in metres?"


def latency_words(trace: Trace) -> str:
    """Return the median and the slowest decision by the wall clock; empty if no times were measured.

    A replay neither repeats a question whose answer came too late, nor records a time for it.
    """
    measured_s = trace.decision_latency_s[trace.decision_latency_s > 0.0]
    if len(measured_s) == 0:
        return ""
    slowest = f"slowest decision {milliseconds_words(float(np.max(measured_s)))}"
    if len(measured_s) == 1:
        return slowest
    return f"median decision {milliseconds_words(float(np.median(measured_s)))}, {slowest}"


@dataclass(frozen=True)
class ComputingTime:
    """The computing time of a run: a decision's cost, in ``words``, and the duration of its answers."""

    tested: str
    words: str
    times: AnswersTook

    @classmethod
    def from_trace(cls, trace: Trace) -> ComputingTime:
        """Return the computing time that ``trace`` records."""
        cost = trace.scenario.settings.avoidance.decision_time
        noun = "an answer" if trace.scenario.driven else "a decision"
        cost_text = cost_words(cost, most_cost_s(trace), noun)
        return cls(trace.system.tested.name, cost_text, AnswersTook.from_trace(trace))


def cost_words(
    cost: DecisionCost | DecisionTimes, declared_s: float, decision_noun: str = "a decision"
) -> str:
    """Return the cost of a decision by the settings, or ``declared_s`` [s] if the avoider declares it.

    ``decision_noun`` is the term for a decision, such as "an answer" of a controller.
    """
    noun = decision_noun.rpartition(" ")[2]
    if cost is DecisionCost.WALL_CLOCK:
        return "what each answer took on the wall's clock: the run repeats from its record only"
    if not isinstance(cost, DecisionTimes):
        if declared_s == 0.0:
            return NOT_MODELLED
        return f"{milliseconds_words(declared_s)} {decision_noun}, as the avoider declares"
    least, middle, most = (milliseconds_words(float(np.quantile(cost.quantiles_s, q))) for q in (0, 0.5, 1))
    if cost.measured is not None:
        source = f"{cost.measured.questions:,} answers of {cost.measured.avoider} on {cost.measured.machine}"
        return f"drawn for each {noun} from {source}: median {middle}, at most {most}"
    if cost.most_s == 0.0:
        return NOT_MODELLED
    always = len(cost.quantiles_s) == 1
    return f"{most} {decision_noun}" if always else f"{least} to {most}, drawn for each {noun}"


def computing_times(traces: Iterable[Trace]) -> list[ComputingTime]:
    """Return the computing times of all runs that have decisions or a timed controller."""
    return [
        ComputingTime.from_trace(trace)
        for trace in traces
        if len(trace.answer_s)
        or (len(trace.decisions) and not trace.scenario.driven and decided(trace, "decision_time_s"))
    ]


def computing_time_lines(traces: Iterable[Trace]) -> list[str]:
    """Return lines on the cost of each avoider and controller, and on those slower than their runs allow."""
    return lines_of(computing_times(traces))


def lines_of(runs: Iterable[ComputingTime]) -> list[str]:
    """Return the lines of ``computing_time_lines`` for computing times that are known already."""
    groups: dict[tuple[str, str], AnswersTook] = {}
    for run in runs:
        key = run.tested, run.words
        groups[key] = groups.get(key, AnswersTook()) + run.times
    return [
        f"{tested}: {line}"
        for (tested, cost_text), times in groups.items()
        for line in (cost_text, times.summary)
        if line
    ]


def refused_for_possible(trace: Trace) -> int:
    """Return how many proposals failed TOWARDS_A_HAND but lead away from every predicted hand."""
    count = 0
    for decision in trace.decisions:
        if decision["proposed_failed"] & Check.TOWARDS_A_HAND:
            tick = trace.ticks[decision["tick"]]
            start_m = tick["transform_tcp_to_base"][:3, 3]
            hands_m = tick["predicted_hand_in_base_m"][tick["track_valid"] != 0]
            count += leads_away(start_m, decision["proposed_position_in_base_m"] - start_m, hands_m)
    return count


def asks_of_hands(trace: Trace) -> bool:
    """Return whether the scenario's gate has a rule about possible hands."""
    return trace.scenario.gate is not None and trace.scenario.gate.of_possible_hands


def possible_lines(traces: Iterable[Trace]) -> list[str]:
    """Return one line on all runs whose gate has a rule about possible hands; empty without such a gate."""
    ruled = [trace for trace in traces if asks_of_hands(trace)]
    if not ruled:
        return []
    refused = sum(map(refused_for_possible, ruled))
    decided_count = sum(len(trace.decisions) for trace in ruled)
    return [f"{refused} of {decided_count} proposals refused only for where a hand may be"]
