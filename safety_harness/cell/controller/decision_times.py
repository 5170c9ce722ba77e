"""The cost of a run's decisions in simulated time, tick by tick: a table for the compiled loop."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.seeds import Branch, generator
from safety_harness.base.settings import DecisionCost, DecisionTimes
from safety_harness.trace.records import Check
from safety_harness.trace.trace import Trace

NOTHING = np.zeros(1)
ON_THE_CLOCK = np.full(1, np.nan)


def decision_times_s(
    cost: DecisionCost | DecisionTimes, declared_s: float, root_seed: int, ticks: int
) -> NDArray[np.float64]:
    """Return the cost of each tick's question [s], (n,); the last number is for all later ticks.

    The draws use the inverse of a distribution function that is linear between the quantiles q_0 ... q_m,
    evenly spaced in probability. This is q_k + (x - k) (q_(k+1) - q_k), x = m u, k its integer part, u
    uniform. NaN stands for the answer's time on the wall's clock. ``declared_s`` is the avoider's
    declaration.
    """
    if cost is DecisionCost.WALL_CLOCK:
        return ON_THE_CLOCK
    if not isinstance(cost, DecisionTimes):
        return np.array([declared_s])
    quantiles_s = np.array(cost.quantiles_s)
    if len(quantiles_s) == 1:
        return quantiles_s
    at = generator(root_seed, Branch.DECISION_TIME).random(ticks) * (len(quantiles_s) - 1)
    index = at.astype(np.int64)
    low_s, high_s = quantiles_s[index], quantiles_s[index + 1]
    times_s: NDArray[np.float64] = low_s + (at - index) * (high_s - low_s)
    return times_s


def recorded_times_s(recorded: Trace) -> NDArray[np.float64]:
    """Return the costs [s] as ``decision_times_s`` does, from the record of a run by the wall's clock.

    A question without a decision never had an answer: the arm had stopped before.
    """
    times_s = np.full(recorded.scenario.ticks + 1, np.inf)
    times_s[recorded.decisions["asked_tick"]] = recorded.decisions["decision_time_s"]
    return times_s


def recorded_late(recorded: Trace) -> list[str]:
    """Return the fault's text of each decision that was late by the wall's clock.

    These decisions had no cost in simulated time. Only old traces have them; any other decision has an empty
    text.
    """
    return [
        str(decision["fault"]) or "late"
        if int(decision["proposed_failed"]) & Check.LATE and decision["asked_tick"] == decision["tick"]
        else ""
        for decision in recorded.decisions
    ]
