"""Judge the record itself: every value must be a number, and time must go forward."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from safety_harness.claims.properties.base import (
    OF_HANDS,
    Evaluation,
    Unit,
    inconclusive,
    judged,
    unreal,
)
from safety_harness.claims.properties.entry import CatalogueEntry
from safety_harness.claims.properties.measured import only_whole
from safety_harness.trace.consistency import first_inconsistency
from safety_harness.trace.known import OF_DECISIONS
from safety_harness.trace.records import DECISION, ENDLESS, TICK, DecisionOutcome, columns
from safety_harness.trace.trace import Trace
from safety_harness.trace.unmeasured import decided, without_gaps

OF_IMAGES = ("features", "feature_error", "sse")


THERE = (
    "hand_present",
    "object_visible",
    "track_valid",
    "decision.tick",
    "decision.outcome",
    "decision.fault",
)
OF_A_DECISION = tuple(
    name for name in DECISION.names or () if DECISION[name].base.kind == "f" and name != "spread_threshold_m"
)
READ = (
    *(name for name in columns(TICK) if name != "time_s"),
    *(OF_DECISIONS + name for name in OF_A_DECISION),
    *THERE,
)


@dataclass(frozen=True, kw_only=True)
class FiniteTrace:
    """The claim that all values are numbers and that time goes forward.

    The margin is minus the number of records that are out of order or have a value that is not a number. A
    record is out of order if it is not later than the record before it. Values of absent things are ignored.
    In a tick, the ignored values are those of an absent hand, the features of an image without the object,
    and the prediction of a slot that tracks no hand. In a decision, the ignored values are the proposal of a
    missing answer, the position of a stop, a missing threshold, and the time of a decision that was not
    timed.
    """

    unit: Unit = Unit.COUNT
    sentence: str = "trace finite and monotone"

    @only_whole(*READ, of_any=True)
    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge all ticks and decisions."""
        ticks, decisions = trace.ticks, trace.decisions
        if len(ticks) == 0:
            return inconclusive(self, "the trace is empty")
        bad = bad_ticks(trace)
        wrong_decisions = bad_decisions(trace)
        total = int(np.count_nonzero(bad) + np.count_nonzero(wrong_decisions))
        if total == 0:
            odd = first_inconsistency(trace)
            if odd is not None:
                return inconclusive(self, f"the trace contradicts itself: {odd}")
        first = int(np.argmax(bad)) if bad.any() else len(ticks) - 1
        if wrong_decisions.any():
            first = min(first, int(decisions["tick"][int(np.argmax(wrong_decisions))]))
        worst_time_s = max(first, 0) * trace.scenario.settings.clock.control_period_s
        reason = f"{total or 'nothing'} wrong; {len(ticks)} ticks, decisions: {len(decisions)}"
        return judged(self, trace, -total, worst_time_s, reason, exercised=len(ticks))


def bad_ticks(trace: Trace) -> NDArray[np.bool_]:
    """Return a mask of the ticks with a wrong record, shape (n,).

    Such a tick is out of order, or has a measured value that is not a number.
    """
    trace = without_gaps(trace, READ)
    bad = np.zeros(len(trace.ticks), np.bool_)
    ticks, time_s, lacking = trace.ticks, trace.time_s, trace.known.missing(READ)
    bad[1:] = ~(time_s[1:] > time_s[:-1])
    present, visible, tracked = (
        np.zeros_like(ticks[name]) if name in lacking else ticks[name]
        for name in ("hand_present", "object_visible", "track_valid")
    )
    there = dict.fromkeys(OF_HANDS, present) | dict.fromkeys(OF_IMAGES, visible[:, None])
    there["predicted_hand_in_base_m"] = tracked
    there["predicted_distance_m"] = np.asarray(tracked.any(axis=1, keepdims=True))
    for name, invalid in unreal(trace, there):
        if name not in lacking:
            bad |= invalid
    return bad


def bad_decisions(trace: Trace) -> NDArray[np.bool_]:
    """Return a mask of the decisions with a wrong record, shape (m,).

    Such a decision is out of order, or has a measured value that is not a number.
    """
    decisions, latency_s = trace.decisions, trace.decision_latency_s
    bad = np.zeros(len(decisions), np.bool_)
    if len(decisions) == 0:
        return bad
    in_time, fault_decided, chose = (decided(trace, name) for name in ("time_s", "fault", "outcome"))
    bad[1:] = ~(np.diff(decisions["time_s"]) > 0.0) & in_time
    if len(latency_s) == len(decisions):
        bad |= np.isinf(latency_s)  # NaN: not timed
    answered = fault_decided & (decisions["fault"] == "")
    chosen = chose & (decisions["outcome"] != DecisionOutcome.STOP)
    opposite = chose & (decisions["outcome"] == DecisionOutcome.OPPOSITE)
    expected = {"proposed": answered, "chosen": chosen, "opposite": opposite}
    for name in filter(partial(decided, trace), OF_A_DECISION):
        invalid = ~(np.abs(decisions[name]) < ENDLESS).reshape(len(bad), -1).all(axis=1)
        bad |= invalid & expected.get(name.split("_")[0], np.True_)
    return bad


FINITE_TRACE = CatalogueEntry(
    prop=FiniteTrace(),
    rationale="every other claim is computed from these numbers",
    source="arithmetic: a comparison with NaN is never true",
    margin=(
        "minus the number of ticks and decisions that contain NaN or infinity, or whose time "
        "is not later than the previous one. The claim holds if the margin is 0"
    ),
    parameters="none",
    exercised="always",
    broken_by="a controller whose features are NaN",
)
