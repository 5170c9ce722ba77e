"""Counts of the avoider's proposals that the gate overruled, by reason and by result."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import reduce
from operator import add

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.proportions import share_words
from safety_harness.trace.records import ENDLESS, Check, DecisionOutcome
from safety_harness.trace.trace import Trace
from safety_harness.trace.unmeasured import decided

_NO_ANSWER = Check.NOT_FINITE | Check.LATE
REASONS: tuple[Check, ...] = tuple(check for check in Check if check and not check & _NO_ANSWER)

_READ = ("fault", "proposed_position_in_base_m", "outcome", "proposed_failed")  # of each decision
_BITS = tuple((check, int(check)) for check in REASONS)  # as numbers, because combining flags is slow
_NAMES = {check: str(check.name).lower() for check in REASONS}
COUNTS = ("proposals", *(f"overruled_{reason}" for reason in ("replaced", "stopped", *_NAMES.values())))


def answered(trace: Trace) -> NDArray[np.bool_]:
    """Return the decisions in which the avoider gave a usable answer in time, as a mask (m,)."""
    there: NDArray[np.bool_] = trace.decisions["fault"] == ""
    there &= (np.abs(trace.decisions["proposed_position_in_base_m"]) < ENDLESS).all(axis=1)
    return there


def overruled(trace: Trace) -> NDArray[np.bool_]:
    """Return the decisions in which the arm did not follow the avoider's answer, as a mask (m,)."""
    vetoed: NDArray[np.bool_] = trace.decisions["outcome"] != DecisionOutcome.PROPOSED
    return vetoed & answered(trace)


def is_measured(trace: Trace) -> bool:
    """Return whether the trace records which proposals the gate overruled, and why."""
    return decided(trace, *_READ)


@dataclass(frozen=True)
class Overruling:
    """Counts of the avoider's proposals and of the overruled proposals.

    ``proposals`` is the number of answers that came in time. If a proposal is overruled, the arm goes to the
    opposite pose (``replaced``) or stops (``stopped``). ``reasons`` counts the checks that overruled
    proposals failed; one proposal may fail several checks. A trace contributes to the counts only if its
    decisions were measured (``is_measured``).
    """

    proposals: int = 0
    replaced: int = 0
    stopped: int = 0
    reasons: Counter[Check] = field(default_factory=Counter)

    @classmethod
    def from_traces(cls, traces: Iterable[Trace]) -> Overruling:
        """Return the sums of the counts over all ``traces``."""
        return reduce(add, map(cls._of_one, traces)) if (traces := list(traces)) else cls()

    @classmethod
    def _of_one(cls, trace: Trace) -> Overruling:
        if len(trace.decisions) == 0 or not is_measured(trace):
            return cls()
        in_time, vetoed = answered(trace), overruled(trace)
        outcomes = trace.decisions["outcome"][vetoed].tolist()
        failed = trace.decisions["proposed_failed"][vetoed].tolist()
        return cls(
            int(np.count_nonzero(in_time)),
            outcomes.count(DecisionOutcome.OPPOSITE),
            outcomes.count(DecisionOutcome.STOP),
            Counter({check: n for check, bit in _BITS if (n := sum(flags & bit != 0 for flags in failed))}),
        )

    def __add__(self, addend: Overruling) -> Overruling:
        return Overruling(
            self.proposals + addend.proposals,
            self.replaced + addend.replaced,
            self.stopped + addend.stopped,
            self.reasons + addend.reasons,
        )

    @property
    def counts(self) -> tuple[int, ...]:
        """The counts as plain numbers, in the order of ``COUNTS``."""
        return (self.proposals, self.replaced, self.stopped, *(self.reasons[check] for check in REASONS))

    @classmethod
    def of_counts(cls, counts: Sequence[int]) -> Overruling:
        """Return an object with the given counts.

        The order of ``counts`` is that of ``COUNTS``.
        """
        proposals, replaced, stopped, *failed = counts
        reasons = Counter({check: n for check, n in zip(REASONS, failed, strict=True) if n})
        return cls(proposals, replaced, stopped, reasons)

    @property
    def named(self) -> dict[str, int]:
        """All counts for JSON, with their names as keys.

        There is one count for each reason.
        """
        return {"overruled": self.overruled, **dict(zip(COUNTS, self.counts, strict=True))}

    @property
    def summary(self) -> str:
        """The counts as one line, with the most frequent reason first.

        The line is empty without proposals.
        """
        if not self.proposals:
            return ""
        of_all = f"{self.proposals:,} {'proposal' if self.proposals == 1 else 'proposals'}"
        summary = f"overruled {self.overruled:,} of {of_all} ({share_words(self.overruled, self.proposals)})"
        why = ", ".join(f"{n:,} {_NAMES[check].replace('_', ' ')}" for check, n in self.reasons.most_common())
        results = ((self.replaced, "by the opposite pose"), (self.stopped, "by a stop"))
        instead = ", ".join(f"{n:,} {how}" for n, how in results if n).replace(" ", " replaced ", 1)
        return "; ".join(filter(None, (f"{summary}: {why}" if why else summary, instead)))

    @property
    def overruled(self) -> int:
        """The number of proposals that the arm did not follow."""
        return self.replaced + self.stopped

    @property
    def share(self) -> float:
        """The number of overruled proposals divided by the number of proposals, or NaN without proposals."""
        return self.overruled / self.proposals if self.proposals else float("nan")
