"""How often what an avoider proposed was overruled by the gate, for which reasons, and what came instead."""

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
_BITS = tuple((check, int(check)) for check in REASONS)  # a flag is slow to combine
_NAMES = {check: str(check.name).lower() for check in REASONS}
COUNTS = ("proposals", *(f"overruled_{what}" for what in ("replaced", "stopped", *_NAMES.values())))


def answered(trace: Trace) -> NDArray[np.bool_]:
    """(m,) decisions to which the avoider gave a usable answer in time."""
    there: NDArray[np.bool_] = trace.decisions["fault"] == ""
    there &= (np.abs(trace.decisions["proposed_position_in_base_m"]) < ENDLESS).all(axis=1)
    return there


def overruled(trace: Trace) -> NDArray[np.bool_]:
    """(m,) decisions of which the avoider's answer was not what the arm did."""
    vetoed: NDArray[np.bool_] = trace.decisions["outcome"] != DecisionOutcome.PROPOSED
    return vetoed & answered(trace)


def is_measured(trace: Trace) -> bool:
    """Is it known of a trace's proposals what became of them?"""
    return decided(trace, *_READ)


@dataclass(frozen=True)
class Overruling:
    """Of ``proposals`` (answers in time): ``replaced`` by the opposite pose, or the arm ``stopped``.

    ``reasons`` counts the checks that overruled proposals failed; one proposal may fail several.  A trace
    whose decisions were not measured counts for nothing, as ``is_measured`` says.
    """

    proposals: int = 0
    replaced: int = 0
    stopped: int = 0
    reasons: Counter[Check] = field(default_factory=Counter)

    @classmethod
    def of(cls, traces: Iterable[Trace]) -> Overruling:
        """Of all ``traces`` together."""
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
            Counter({check: n for check, bit in _BITS if (n := sum(one & bit != 0 for one in failed))}),
        )

    def __add__(self, other: Overruling) -> Overruling:
        return Overruling(
            self.proposals + other.proposals,
            self.replaced + other.replaced,
            self.stopped + other.stopped,
            self.reasons + other.reasons,
        )

    @property
    def counts(self) -> tuple[int, ...]:
        """Plain numbers, named by ``COUNTS``."""
        return (self.proposals, self.replaced, self.stopped, *(self.reasons[check] for check in REASONS))

    @classmethod
    def of_counts(cls, counts: Sequence[int]) -> Overruling:
        """Of such numbers."""
        proposals, replaced, stopped, *failed = counts
        reasons = Counter({check: n for check, n in zip(REASONS, failed, strict=True) if n})
        return cls(proposals, replaced, stopped, reasons)

    @property
    def named(self) -> dict[str, int]:
        """For JSON: all counts by their names, those of reasons too."""
        return {"overruled": self.overruled, **dict(zip(COUNTS, self.counts, strict=True))}

    @property
    def words(self) -> str:
        """One line, the most frequent reason first; empty if nothing was proposed."""
        if not self.proposals:
            return ""
        of_all = f"{self.proposals:,} {'proposal' if self.proposals == 1 else 'proposals'}"
        said = f"overruled {self.overruled:,} of {of_all} ({share_words(self.overruled, self.proposals)})"
        why = ", ".join(f"{n:,} {_NAMES[check].replace('_', ' ')}" for check, n in self.reasons.most_common())
        ways = ((self.replaced, "by the opposite pose"), (self.stopped, "by a stop"))
        instead = ", ".join(f"{n:,} {how}" for n, how in ways if n).replace(" ", " replaced ", 1)
        return "; ".join(filter(None, (f"{said}: {why}" if why else said, instead)))

    @property
    def overruled(self) -> int:
        """Proposals that were not what the arm did."""
        return self.replaced + self.stopped

    @property
    def share(self) -> float:
        """Overruled proposals a proposal; NaN without any."""
        return self.overruled / self.proposals if self.proposals else float("nan")
