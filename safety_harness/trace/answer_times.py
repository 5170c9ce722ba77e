"""How long answers took on the machine of a run, against what the run allows: reported, never compared."""

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
    """The ``answers`` that were timed, and how many of them were ``slow``: took longer than ``limit_s`` [s].

    That is the most that a decision costs in simulated time, or a control period where it costs nothing, as
    with every controller.  ``slowest_s`` [s] is the longest by the wall's clock.
    """

    answers: int = 0
    slow: int = 0
    slowest_s: float = 0.0
    limit_s: float = 0.0

    @classmethod
    def of(cls, trace: Trace) -> AnswersTook:
        """Take them from the record of one run; answers that were given together were not timed."""
        settings, took_s = trace.scenario.settings, trace.answer_s
        limit_s = 0.0
        if not trace.scenario.driven:
            took_s, limit_s = trace.decision_latency_s, most_cost_s(trace)
        took_s, limit_s = took_s[took_s > 0.0], limit_s or settings.clock.control_period_s
        slow = int(np.count_nonzero(took_s > limit_s))
        return cls(len(took_s), slow, float(np.max(took_s, initial=0.0)), limit_s)

    def __add__(self, other: AnswersTook) -> AnswersTook:
        return AnswersTook(
            self.answers + other.answers,
            self.slow + other.slow,
            max(self.slowest_s, other.slowest_s),
            max(self.limit_s, other.limit_s),
        )

    @property
    def words(self) -> str:
        """Say that they were slow; empty while the 95th percentile is within the limit."""
        if self.slow <= MOST_SLOW * self.answers:
            return ""
        share = share_words(self.slow, self.answers)
        return (
            f"on this machine {self.slow:,} of {self.answers:,} answers ({share}) took longer than the "
            f"{self.limit_s * 1e3:.4g} ms that the runs allow, the slowest {self.slowest_s * 1e3:,.1f} ms "
            f"({self.slowest_s / self.limit_s:.2g} times): {UNHEEDED}"
        )


def most_cost_s(trace: Trace) -> float:
    """Return the most [s] that a decision of the run costs in simulated time."""
    cost = trace.scenario.settings.avoidance.decision_time
    drawn_s = cost.quantiles_s if isinstance(cost, DecisionTimes) else trace.decisions["decision_time_s"]
    return float(np.max(drawn_s, initial=0.0))
