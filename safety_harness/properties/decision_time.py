"""Decisions come in time: from the question to the avoider's answer, on the wall's clock and the arm's."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from safety_harness.properties.base import Evaluation, Unit, inconclusive, judged, unreadable
from safety_harness.properties.entry import Entry, quantity
from safety_harness.scenario.faults import AvoiderLate, AvoiderSilent
from safety_harness.scenario.units import TIME
from safety_harness.trace.records import Check
from safety_harness.trace.trace import Trace


@dataclass(frozen=True, kw_only=True)
class DecisionTime:
    """min over decisions of ``within_s`` less the time that the answer took.

    That is the wall-clock time of asking plus what a fault of the scenario let the arm wait.  An answer
    that was given up on at the deadline never came: it counts as one control period more than the
    limit, at least.
    """

    within_s: float
    unit: Unit = Unit.TIME

    @property
    def sentence(self) -> str:
        """As the catalogue writes it."""
        return f"decisions within {self.within_s * 1e3:g} ms"

    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge each decision."""
        problem = unreadable(trace, ())
        if problem is not None:
            return inconclusive(self, problem)
        wall_s = trace.decision_latency_s
        if len(wall_s) != len(trace.decisions) or not np.all(np.isfinite(wall_s) & (wall_s >= 0.0)):
            return inconclusive(self, "the times that the decisions took are not known")
        if len(wall_s) == 0:
            return inconclusive(self, "never exercised: nothing was decided")
        took_s = wall_s + waited_s(trace)
        late = (trace.decisions["proposed_failed"] & Check.LATE) != 0
        over_s = self.within_s + trace.scenario.settings.clock.control_period_s
        took_s = np.where(late, np.maximum(took_s, over_s), took_s)
        worst = int(np.argmax(took_s))
        words = f"slowest {took_s[worst] * 1e3:.1f} ms, median {np.median(took_s) * 1e3:.1f} ms"
        return judged(
            self,
            trace,
            margin=self.within_s - float(took_s[worst]),
            worst_time_s=float(trace.decisions["time_s"][worst]),
            reason=f"{np.count_nonzero(late)} of {len(late)} were never answered" if late.any() else words,
            exercised=len(wall_s),
        )


def waited_s(trace: Trace) -> NDArray[np.float64]:
    """(m,) how long the arm went on without the answer of each decision, since a fault made it late.

    Such a fault is marked at every tick from the question to the decision.
    """
    slow = 0
    for k, fault in enumerate(trace.scenario.faults):
        slow |= (1 << k) * isinstance(fault, AvoiderLate | AvoiderSilent)
    waiting = (trace.ticks["faults"] & slow) != 0
    ticks = np.arange(len(waiting))
    asked = np.maximum.accumulate(np.where(waiting, -1, ticks)) + 1  # the first tick of each wait
    made = trace.decisions["tick"]
    asked_at = np.maximum(asked[made], np.concatenate([[0], made[:-1] + 1]).astype(np.int64))
    waits: NDArray[np.float64] = np.where(waiting[made], made - asked_at, 0) * (
        trace.scenario.settings.clock.control_period_s
    )
    return waits


DECISION_TIME = Entry(
    example="decisions within 100 ms",
    pattern=r"decisions within (.+)",
    make=lambda match, _, place: DecisionTime(within_s=quantity(match[1], TIME, place)),
    unit=Unit.TIME,
    rationale="the hand moves on while the avoider thinks. The wall's clock is the one thing here that a "
    "replay does not repeat: the margin is that of the machine and the moment of the run",
    source="the reaction time T_r of ISO/TS 15066, in which all has to fit",
    margin="the limit less the longest time from a question to its answer: on the wall's clock, and what a "
    "simulated delay adds; one control period over the limit, at least, for an answer that was given up on",
    parameters="the limit; the decision deadline of the settings",
    exercised="a decision was made",
    inconclusive="a decision whose time was not taken down",
    scenario="hand-visits-and-leaves",
    broken_by="an avoider that never answers",
)
