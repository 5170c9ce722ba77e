"""Check that the avoider always answers, answers in time, and repeats its answers.

The check is for runs without a ledger.
"""

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
    """A record of the avoider's answers in several runs.

    The record has the number of ``decisions`` and the number of ``unanswered`` decisions. The record also has
    the ``times`` of the answers, and the queries that ``remarks`` sends to the avoider again.
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
        """Add the answers of the run with the given ``row``.

        ``scenario`` is a function that returns the run's scenario when it is needed.
        """
        self.decisions += row.decisions
        self.unanswered += row.faults
        self.times += row.times
        self.repeatability.take(row.asked, scenario)
        if row.driven is not None:
            self.repeatability.take_run(row.driven, scenario)

    @property
    def time_lines(self) -> list[str]:
        """A list with one line if the avoider was slower than its runs allow, and otherwise an empty list."""
        return [f"computing time: {text}" for text in [self.times.summary] if text]

    def remarks(self, plan: Plan) -> Iterator[str]:
        """Repeat the queries to the avoider.

        Yield the reasons why the runs do not represent the avoider of ``plan``.
        """
        fallback = fallback_words(self.unanswered, self.decisions)
        if fallback and not is_claimed(claim.claim for claim in plan.claims):
            yield fallback
        again = self.repeatability.check()
        if again.problem:
            yield f"{again.line}: all numbers here are invalid"
