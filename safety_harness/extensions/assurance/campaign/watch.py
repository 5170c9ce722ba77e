"""Check, in runs without a ledger, that the avoider always answers, in time, and repeats its answers."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from safety_harness.admission.repeatability import Repeatability
from safety_harness.claims.properties.answered import fallback_words, is_claimed, unanswered
from safety_harness.extensions.assurance.campaign.plan import Plan
from safety_harness.extensions.assurance.campaign.rows import Row
from safety_harness.scenario.model import Scenario
from safety_harness.trace.answer_times import AnswersTook
from safety_harness.trace.trace import Trace


@dataclass
class AvoiderWatch:
    """A record of the avoider's answers over several runs.

    It counts ``decisions`` and ``unanswered`` decisions. It collects answer ``times`` and the questions,
    which ``remarks`` asks again.
    """

    decisions: int = 0
    unanswered: int = 0
    times: AnswersTook = field(default_factory=AnswersTook)
    repeatability: Repeatability = field(default_factory=Repeatability)

    def add(self, run: Trace) -> None:
        """Add the answers in ``run``."""
        self.decisions += len(run.decisions)
        self.unanswered += int(np.count_nonzero(unanswered(run)))
        self.times += AnswersTook.from_trace(run)
        self.repeatability.add(run)

    def add_row(self, row: Row, scenario: Callable[[], Scenario]) -> None:
        """Add the answers of a run from its ``row``; ``scenario`` returns the run's scenario on demand."""
        self.decisions += row.decisions
        self.unanswered += row.faults
        self.times += row.times
        self.repeatability.take(row.asked, scenario)
        if row.driven is not None:
            self.repeatability.take_run(row.driven, scenario)

    @property
    def time_lines(self) -> list[str]:
        """A line if the avoider was slower than its runs allow; otherwise empty."""
        return [f"computing time: {text}" for text in [self.times.summary] if text]

    def remarks(self, plan: Plan) -> Iterator[str]:
        """Ask the avoider again, and yield reasons why the runs do not represent the avoider of ``plan``."""
        fallback = fallback_words(self.unanswered, self.decisions)
        if fallback and not is_claimed(claim.claim for claim in plan.claims):
            yield fallback
        again = self.repeatability.check()
        if again.problem:
            yield f"{again.line}: all numbers here are invalid"
