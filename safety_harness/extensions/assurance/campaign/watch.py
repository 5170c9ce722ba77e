"""The avoider in runs that no ledger keeps: did it always answer, in time, and alike when asked again?"""

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
    """Counts ``decisions`` and those ``unanswered``, and takes in ``times`` and the questions of runs."""

    decisions: int = 0
    unanswered: int = 0
    times: AnswersTook = field(default_factory=AnswersTook)
    repeatability: Repeatability = field(default_factory=Repeatability)

    def add(self, run: Trace) -> None:
        """A run."""
        self.decisions += len(run.decisions)
        self.unanswered += int(np.count_nonzero(unanswered(run)))
        self.times += AnswersTook.of(run)
        self.repeatability.add(run)

    def add_row(self, row: Row, scenario: Callable[[], Scenario]) -> None:
        """A run by its row; ``scenario`` gives its own, when it is needed."""
        self.decisions += row.decisions
        self.unanswered += row.faults
        self.times += row.times
        self.repeatability.take(row.asked, scenario)
        if row.driven is not None:
            self.repeatability.take_run(row.driven, scenario)

    @property
    def time_lines(self) -> list[str]:
        """That it was slower than its runs allow; empty if it was not."""
        return [f"computing time: {words}" for words in [self.times.words] if words]

    def remarks(self, plan: Plan) -> Iterator[str]:
        """Why what the runs say is not of the avoider of ``plan``, or of no avoider at all; asks it again."""
        words = fallback_words(self.unanswered, self.decisions)
        if words and not is_claimed(claim.claim for claim in plan.claims):
            yield words
        again = self.repeatability.check()
        if again.problem:
            yield f"{again.line}: none of these numbers holds"
