"""Decisions as traces of the format before this one have them: without when the avoider was asked."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from safety_harness.scenario.faults import AvoiderLate, AvoiderSilent, Fault
from safety_harness.trace.records import DECISION

NEW = ("asked_tick", "decision_time_s")
DECISION_3 = np.dtype(
    [(name, field[0]) for name, field in (DECISION.fields or {}).items() if name not in NEW], align=True
)


def as_now(decisions: NDArray[np.void], ticks: NDArray[np.void], faults: Sequence[Fault]) -> NDArray[np.void]:
    """(m,) DECISION_3 as (m,) DECISION.  No decision cost anything then but by a fault of the scenario."""
    now = np.zeros(len(decisions), DECISION)
    for name in DECISION_3.names or ():
        now[name] = decisions[name]
    now["asked_tick"] = _asked(decisions["tick"], ticks["faults"], faults)
    return now


def _asked(made: NDArray[np.int64], acted: NDArray[np.int64], faults: Sequence[Fault]) -> NDArray[np.int64]:
    """(m,) the tick of each question: a fault that delays its answer is marked from there to the decision."""
    slow = sum(1 << k for k, fault in enumerate(faults) if isinstance(fault, AvoiderLate | AvoiderSilent))
    waiting = (acted & slow) != 0
    if len(made) == 0 or made.min() < 0 or made.max() >= len(waiting):
        return made  # refused later, in words
    begun = np.maximum.accumulate(np.where(waiting, -1, np.arange(len(waiting)))) + 1
    after_the_one_before = np.concatenate([[0], made[:-1] + 1])
    return np.where(waiting[made], np.maximum(begun[made], after_the_one_before), made)
