"""Compute the table of a run's decision costs in simulated time, tick by tick, for the compiled loop."""

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
    """Return the cost [s] of a question at each tick, (n,); the last number is for all later ticks.

    A ``cost`` of quantiles q_0 ... q_m, evenly spaced in probability, means a distribution that is linear
    between them. The function draws from it by the inverse of the distribution function. A draw is q_k + (x -
    k) (q_(k+1) - q_k) with x = m u, u uniform in [0, 1), and k the integer part of x. NaN means that the
    wall's clock determines the cost. ``declared_s`` is the avoider's declaration.
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
    """Return the table of ``decision_times_s`` from a recorded run whose costs the wall's clock determined.

    A question without a decision has the cost infinity, because the arm stopped before the answer.
    """
    times_s = np.full(recorded.scenario.ticks + 1, np.inf)
    times_s[recorded.decisions["asked_tick"]] = recorded.decisions["decision_time_s"]
    return times_s


def recorded_late(recorded: Trace) -> list[str]:
    """Return a text for each decision: the fault's text if the decision was late by the wall's clock.

    Late decisions of this kind had no cost in simulated time, and only old traces have any. The text of any
    other decision is empty.
    """
    return [
        str(decision["fault"]) or "late"
        if int(decision["proposed_failed"]) & Check.LATE and decision["asked_tick"] == decision["tick"]
        else ""
        for decision in recorded.decisions
    ]
