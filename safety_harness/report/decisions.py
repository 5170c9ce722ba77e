"""Describe the decisions of a run: the query, the outcome, and the computing time.

There are two computing times: the time that decisions cost in the simulation, and the real time that they
took on the computer.
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

    ``faults`` counts the decisions without a usable answer. ``unanswered`` counts the ``faults`` that no
    fault of the scenario explains. The tally omits traces for which ``are_counted`` returns False, because
    their decisions were not measured.
    """

    made: int
    proposed: int
    opposite: int
    stops: int
    faults: int
    unanswered: int

    @classmethod
    def from_traces(cls, traces: Iterable[Trace]) -> DecisionTally:
        """Return the counts of decisions, summed over all ``traces``."""
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
        """Return a headline on how often the fallback replaced the avoider.

        The headline is empty if the fallback was never used.
        """
        return fallback_words(self.unanswered, self.made)

    @property
    def fault_words(self) -> str:
        """Return how often the avoider gave no usable answer, or an empty text if it always gave one."""
        return count_words(self.faults, "fault", "faults") if self.faults else ""

    @property
    def departures(self) -> list[str]:
        """Return short texts that state how often a decision did not choose the avoider's proposal."""
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
    """Return the heading above the names of ``avoiders``, such as ``Avoider`` or ``Controllers``."""
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
    """Return one line on all avoiders together and, if there are several, one line on each avoider."""
    whole = sum(each.values(), Overruling()).summary
    rows = [f"{name}: {row.summary}" for name, row in each.items() if len(each) > 1]
    return [whole, *rows] if whole else []


def decision_rows(trace: Trace) -> list[DecisionRow]:
    """Return a row for each of the first ``MOST_DECISION_ROWS`` decisions, with positions in mm.

    A dash means that a value was not measured. The list is empty if the decision times were not measured.
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
    """Return (name, meaning) of every check that any candidate of this run failed."""
    flags = trace.decisions["proposed_failed"] | trace.decisions["opposite_failed"]
    failed = int(np.bitwise_or.reduce(flags)) if len(flags) else 0
    return [(flag_words(check), CHECK_MEANINGS[check]) for check in Check if check and check & failed]


def fault_notes(trace: Trace) -> list[str]:
    """Return a sentence on each kind of unusable answer, in the order in which the kinds first occurred.

    A further sentence comes first if every proposed position is too far away for any arm. A wrong unit may be
    the cause.
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
    """Yield a sentence if every proposed position is more than ``FAR_M`` from the base."""
    proposed_m = trace.decisions["proposed_position_in_base_m"][answered(trace)]
    far_m = np.linalg.norm(proposed_m, axis=1)
    if len(far_m) and far_m.min() > FAR_M:
        where = f"every proposed position is {far_m.min():,.0f} m or more from the base"
        yield f"The gate refused all proposals, since {where}: are they in metres?"


def latency_words(trace: Trace) -> str:
    """Return the median and the longest measured time of a decision, or an empty text without measurements.

    A replay skips queries whose answers came too late, and records no time for these queries.
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
    """The computing time of a run.

    ``words`` states the cost of a decision. The other fields concern the durations of the answers.
    """

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
    """Describe the cost of a decision, which the settings state or the avoider declares.

    ``declared_s`` [s] is the cost that the avoider declares. ``decision_noun`` is the word for a decision in
    the text. For a controller, it is "an answer".
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
    """Return lines on the cost of each avoider and controller.

    If answers took longer than the cost, a line states this.
    """
    return lines_of(computing_times(traces))


def lines_of(runs: Iterable[ComputingTime]) -> list[str]:
    """Return the lines of ``computing_time_lines`` from computing times that are already known."""
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
    """Return how many proposals fail the check TOWARDS_A_HAND but lead away from every predicted hand."""
    count = 0
    for decision in trace.decisions:
        if decision["proposed_failed"] & Check.TOWARDS_A_HAND:
            tick = trace.ticks[decision["tick"]]
            start_m = tick["transform_tcp_to_base"][:3, 3]
            hands_m = tick["predicted_hand_in_base_m"][tick["track_valid"] != 0]
            count += leads_away(start_m, decision["proposed_position_in_base_m"] - start_m, hands_m)
    return count


def asks_of_hands(trace: Trace) -> bool:
    """Return whether the gate of the scenario has a rule about possible hand positions."""
    return trace.scenario.gate is not None and trace.scenario.gate.of_possible_hands


def possible_lines(traces: Iterable[Trace]) -> list[str]:
    """Return one line on all runs whose gate has a rule about possible hands.

    If there is no such run, the result is empty.
    """
    ruled = [trace for trace in traces if asks_of_hands(trace)]
    if not ruled:
        return []
    refused = sum(map(refused_for_possible, ruled))
    decided_count = sum(len(trace.decisions) for trace in ruled)
    return [f"{refused} of {decided_count} proposals refused only for where a hand may be"]
