"""What the gate refused only for where a hand may be: the way leads away from where it was predicted."""

from __future__ import annotations

from collections.abc import Iterable

from safety_harness.cell.avoidance.gate import leads_away
from safety_harness.trace.records import Check
from safety_harness.trace.trace import Trace


def refused_for_possible(trace: Trace) -> int:
    """How many proposals failed TOWARDS_A_HAND though they lead away from every predicted hand."""
    count = 0
    for decision in trace.decisions:
        if decision["proposed_failed"] & Check.TOWARDS_A_HAND:
            tick = trace.ticks[decision["tick"]]
            start_m = tick["transform_tcp_to_base"][:3, 3]
            hands_m = tick["predicted_hand_in_base_m"][tick["track_valid"] != 0]
            count += leads_away(start_m, decision["proposed_position_in_base_m"] - start_m, hands_m)
    return count


def asks_of_hands(trace: Trace) -> bool:
    """Has the gate such a rule?"""
    return trace.scenario.gate is not None and trace.scenario.gate.hands_within is not None


def possible_lines(traces: Iterable[Trace]) -> list[str]:
    """One line on all runs whose gate has such a rule; none where no run has."""
    ruled = [trace for trace in traces if asks_of_hands(trace)]
    if not ruled:
        return []
    refused = sum(map(refused_for_possible, ruled))
    asked = sum(len(trace.decisions) for trace in ruled)
    return [f"{refused} of {asked} proposals refused only for where a hand may be"]
