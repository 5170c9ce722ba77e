"""Compare the wall-clock time of answers with the time limit of the run.

The times depend on the machine of the run. These times appear in reports, but comparisons of traces ignore
them.
"""

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
    """Counts of timed answers.

    ``answers`` is the number of all timed answers, and ``slow`` is the number of those that took longer than
    ``limit_s`` [s]. The limit is the largest cost of an answer in simulated time. If answers cost nothing,
    the limit is one control period. ``slowest_s`` [s] is the longest wall-clock time of an answer.
    """

    answers: int = 0
    slow: int = 0
    slowest_s: float = 0.0
    limit_s: float = 0.0

    @classmethod
    def from_trace(cls, trace: Trace) -> AnswersTook:
        """Return the answer times of one run.

        Answers that were computed together in one call are left out, because the time of a single answer is
        unknown.
        """
        took_s = trace.answer_s if trace.scenario.driven else trace.decision_latency_s
        limit_s = most_cost_s(trace) or trace.scenario.settings.clock.control_period_s
        took_s = took_s[took_s > 0.0]
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
        """A sentence about slow answers, which is empty if the 95th percentile is within the limit."""
        if self.slow <= MOST_SLOW * self.answers:
            return ""
        share = share_words(self.slow, self.answers)
        return (
            f"on this machine {self.slow:,} of {self.answers:,} answers ({share}) took longer than the "
            f"{self.limit_s * 1e3:.4g} ms that the runs allow, the slowest {self.slowest_s * 1e3:,.1f} ms "
            f"({self.slowest_s / self.limit_s:.2g} times): {UNHEEDED}"
        )


def most_cost_s(trace: Trace) -> float:
    """Return the largest cost [s] in simulated time that an answer of the run may have."""
    cost = trace.scenario.settings.avoidance.decision_time
    if isinstance(cost, DecisionTimes):
        return cost.most_s
    drawn_s = () if trace.scenario.driven else trace.decisions["decision_time_s"]
    return float(np.max(drawn_s, initial=0.0))
