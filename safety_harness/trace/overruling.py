"""How often what an avoider proposed was overruled by the gate, for which reasons, and what came instead."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from safety_harness.trace.records import ENDLESS, Check, DecisionOutcome
from safety_harness.trace.trace import Trace

REASONS = tuple(check for check in Check if check and check not in (Check.NOT_FINITE, Check.LATE))


def answered(trace: Trace) -> NDArray[np.bool_]:
    """(m,) decisions to which the avoider gave a usable answer in time."""
    there: NDArray[np.bool_] = trace.decisions["fault"] == ""
    there &= (np.abs(trace.decisions["proposed_position_in_base_m"]) < ENDLESS).all(axis=1)
    return there


def overruled(trace: Trace) -> NDArray[np.bool_]:
    """(m,) decisions of which the avoider's answer was not what the arm did."""
    vetoed: NDArray[np.bool_] = trace.decisions["outcome"] != DecisionOutcome.PROPOSED
    return vetoed & answered(trace)


@dataclass(frozen=True)
class Overruling:
    """Of ``proposals`` (answers in time): ``replaced`` by the opposite pose, or the arm ``stopped``.

    ``reasons`` counts the checks that overruled proposals failed; one proposal may fail several.
    """

    proposals: int = 0
    replaced: int = 0
    stopped: int = 0
    reasons: Counter[Check] = field(default_factory=Counter)

    @classmethod
    def of(cls, traces: Iterable[Trace]) -> Overruling:
        """Of all ``traces`` together."""
        return sum((cls._of_one(trace) for trace in traces), cls())

    @classmethod
    def _of_one(cls, trace: Trace) -> Overruling:
        vetoed = overruled(trace)
        outcome, failed = trace.decisions["outcome"][vetoed], trace.decisions["proposed_failed"][vetoed]
        return cls(
            int(np.count_nonzero(answered(trace))),
            int(np.count_nonzero(outcome == DecisionOutcome.OPPOSITE)),
            int(np.count_nonzero(outcome == DecisionOutcome.STOP)),
            Counter({check: n for check in REASONS if (n := int(np.count_nonzero(failed & check)))}),
        )

    def __add__(self, other: Overruling) -> Overruling:
        return Overruling(
            self.proposals + other.proposals,
            self.replaced + other.replaced,
            self.stopped + other.stopped,
            self.reasons + other.reasons,
        )

    @property
    def overruled(self) -> int:
        """Proposals that were not what the arm did."""
        return self.replaced + self.stopped

    @property
    def share(self) -> float:
        """Overruled proposals a proposal; NaN without any."""
        return self.overruled / self.proposals if self.proposals else float("nan")
