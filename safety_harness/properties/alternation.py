"""The arm does not go back and forth between giving way and its task."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from safety_harness.properties.base import Evaluation, Unit, begins_at, inconclusive, judged, unreadable
from safety_harness.properties.entry import CatalogueEntry, count
from safety_harness.properties.reaction import gives_way
from safety_harness.trace.trace import Trace


@dataclass(frozen=True, kw_only=True)
class GivesWayAtMost:
    """``most`` less how often the arm went from its task to giving way.

    From servoing, or from standing without the object, to repulsing or to a protective stop.  What is
    decided anew while it gives way counts as one.
    """

    most: int
    unit: Unit = Unit.COUNT

    @property
    def sentence(self) -> str:
        """As the catalogue writes it."""
        return f"gives way at most {self.most} {'time' if self.most == 1 else 'times'}"

    def evaluate(self, trace: Trace) -> Evaluation:
        """Count the transitions."""
        problem = unreadable(trace, ())
        if problem is not None:
            return inconclusive(self, problem)
        entered = gives_way_at(trace)
        if len(entered) == 0:
            return inconclusive(self, "never exercised: the arm never gave way")
        return judged(
            self,
            trace,
            margin=float(self.most - len(entered)),
            worst_time_s=float(trace.time_s[entered[min(len(entered) - 1, self.most)]]),
            reason=f"gave way {len(entered)} times" if len(entered) > 1 else "gave way once",
            exercised=len(entered),
        )


def gives_way_at(trace: Trace) -> NDArray[np.int64]:
    """The ticks at which the arm leaves its task to give way; every run begins with its task."""
    return np.flatnonzero(begins_at(gives_way(trace)))


GIVES_WAY_AT_MOST = CatalogueEntry(
    example="gives way at most 3 times",
    pattern=r"gives way at most (\S+) times?",
    make=lambda match, _, place: GivesWayAtMost(most=count(match[1], place)),
    unit=Unit.COUNT,
    rationale="an arm that goes to and fro before a hand is of no use, and nobody can foresee it",
    source="hysteresis, a common demand on switched controllers",
    margin="the times allowed less those at which the arm leaves its task to repulse or to stop",
    parameters="the times allowed",
    exercised="the arm gives way",
    inconclusive="-",
    scenario="hand-returns",
    broken_by="an avoider that hardly leaves a hand that stays",
)
