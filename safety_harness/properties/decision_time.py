"""Decisions come in time: from the question to the tick at which the answer counts, in simulated time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from safety_harness.properties.base import Evaluation, Unit, inconclusive, judged, unreadable
from safety_harness.properties.entry import CatalogueEntry, quantity
from safety_harness.scenario.units import TIME
from safety_harness.trace.records import Check
from safety_harness.trace.trace import Trace

NOT_MODELLED = "computing time not modelled"


@dataclass(frozen=True, kw_only=True)
class DecisionTime:
    """min over decisions of ``within_s`` less the time that the arm went on without the answer.

    That is the decision time of the settings, or as the avoider declares it, and what a fault of the
    scenario adds, to the tick at which the answer counts.  An answer that was given up on at the deadline
    never came: it counts as one control period more than the limit, at least.  A decision that costs no
    simulated time shows nothing: with one of those nothing holds.
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
        decisions, period_s = trace.decisions, trace.scenario.settings.clock.control_period_s
        if len(decisions) == 0:
            return inconclusive(self, "never exercised: nothing was decided")
        took_s = (decisions["tick"] - decisions["asked_tick"]) * period_s
        late = (decisions["proposed_failed"] & Check.LATE) != 0
        took_s = np.where(late, np.maximum(took_s, self.within_s + period_s), took_s)
        worst = int(np.argmax(took_s))
        free = np.count_nonzero(~late & (decisions["decision_time_s"] == 0.0))
        if free and not took_s[worst] > self.within_s:
            return inconclusive(self, NOT_MODELLED)
        words = f"slowest {took_s[worst] * 1e3:.1f} ms, median {np.median(took_s) * 1e3:.1f} ms"
        return judged(
            self,
            trace,
            margin=self.within_s - float(took_s[worst]),
            worst_time_s=float(decisions["time_s"][worst]),
            reason=f"{np.count_nonzero(late)} of {len(late)} were never answered" if late.any() else words,
            exercised=len(decisions) - int(free) + int(took_s[worst] > self.within_s),
        )


DECISION_TIME = CatalogueEntry(
    example="decisions within 100 ms",
    pattern=r"decisions within (.+)",
    make=lambda match, _, place: DecisionTime(within_s=quantity(match[1], TIME, place)),
    unit=Unit.TIME,
    rationale="the hand moves on while the avoider thinks. What a decision costs is declared, or measured in "
    "a profile: whether the avoider keeps to it on the robot's own computer is not shown by any run here",
    source="the reaction time T_r of ISO/TS 15066, in which all has to fit",
    margin="the limit less the longest simulated time from a question to the tick at which its answer "
    "counts; one control period over the limit, at least, for an answer that was given up on",
    parameters="the limit; the decision time and the decision deadline of the settings",
    exercised="a decision was made that costs simulated time",
    inconclusive="a decision that costs none: its computing time is not modelled",
    scenario="decisions-take-90-ms",
    broken_by="an avoider that never answers",
)
