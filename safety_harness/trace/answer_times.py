"""Answer times on the machine of a run, against the run's limit: reported, never compared."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from safety_harness.base.proportions import share_words
from safety_harness.base.settings import DecisionTimes
from safety_harness.trace.trace import Trace

UNHEEDED = "it was tested as if it answered in time"
MOST_SLOW = 0.05  # of the answers: with more, the 95th percentile is above the limit


@dataclass(frozen=True)
class AnswersTook:
    """The count of timed ``answers``, and of ``slow`` answers, which took longer than ``limit_s`` [s].

    The limit is the largest cost of a decision in simulated time. Where a decision costs nothing, as with
    every controller, it is a control period. ``slowest_s`` [s] is the longest answer by the wall's clock.
    """

    answers: int = 0
    slow: int = 0
    slowest_s: float = 0.0
    limit_s: float = 0.0

    @classmethod
    def from_trace(cls, trace: Trace) -> AnswersTook:
        """Return the times from the record of one run. Answers that were given together have no time."""
        settings, took_s = trace.scenario.settings, trace.answer_s
        limit_s = 0.0
        if not trace.scenario.driven:
            took_s, limit_s = trace.decision_latency_s, most_cost_s(trace)
        took_s, limit_s = took_s[took_s > 0.0], limit_s or settings.clock.control_period_s
        slow = int(np.count_nonzero(took_s > limit_s))
        return cls(len(took_s), slow, float(np.max(took_s, initial=0.0)), limit_s)

    def __add__(self, addend: AnswersTook) -> AnswersTook:
        return AnswersTook(
            self.answers + addend.answers,
            self.slow + addend.slow,
            max(self.slowest_s, addend.slowest_s),
            max(self.limit_s, addend.limit_s),
        )

    @property
    def summary(self) -> str:
        """The sentence about slow answers; empty while the 95th percentile is within the limit."""
        if self.slow <= MOST_SLOW * self.answers:
            return ""
        share = share_words(self.slow, self.answers)
        return (
            f"on this machine {self.slow:,} of {self.answers:,} answers ({share}) took longer than the "
            f"{self.limit_s * 1e3:.4g} ms that the runs allow, the slowest {self.slowest_s * 1e3:,.1f} ms "
            f"({self.slowest_s / self.limit_s:.2g} times): {UNHEEDED}"
        )


def most_cost_s(trace: Trace) -> float:
    """Return the largest cost [s] of a decision of the run in simulated time."""
    cost = trace.scenario.settings.avoidance.decision_time
    drawn_s = cost.quantiles_s if isinstance(cost, DecisionTimes) else trace.decisions["decision_time_s"]
    return float(np.max(drawn_s, initial=0.0))
