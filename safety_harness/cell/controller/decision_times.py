"""What the decisions of one run cost in simulated time, tick by tick: a table for the compiled loop."""

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
    """(n,) what a question of each tick costs [s]; the last stands for all later ones.

    Drawn by the inverse of the distribution function that is linear between the quantiles q_0 ... q_m, evenly
    spaced in probability: q_k + (x - k) (q_(k+1) - q_k), x = m u, k its integer part, u uniform.  NaN: what
    the answer takes on the wall's clock.  ``declared_s`` is the avoider's own.
    """
    if cost is DecisionCost.WALL_CLOCK:
        return ON_THE_CLOCK
    if not isinstance(cost, DecisionTimes):
        return np.array([declared_s])
    quantiles_s = np.array(cost.quantiles_s)
    if len(quantiles_s) == 1:
        return quantiles_s
    at = generator(root_seed, Branch.DECISION_TIME).random(ticks) * (len(quantiles_s) - 1)
    below = at.astype(np.int64)
    low_s, high_s = quantiles_s[below], quantiles_s[below + 1]
    times_s: NDArray[np.float64] = low_s + (at - below) * (high_s - low_s)
    return times_s


def recorded_times_s(recorded: Trace) -> NDArray[np.float64]:
    """As ``decision_times_s``, from the record of a run by the wall's clock.

    A question without a decision was never answered: the arm had stopped before that.
    """
    times_s = np.full(recorded.scenario.ticks + 1, np.inf)
    times_s[recorded.decisions["asked_tick"]] = recorded.decisions["decision_time_s"]
    return times_s


def recorded_late(recorded: Trace) -> list[str]:
    """How the decisions that came too late by the wall's clock, at no cost in simulated time, were recorded.

    Only old traces have such; empty for all others.
    """
    return [
        str(decision["fault"]) or "late"
        if int(decision["proposed_failed"]) & Check.LATE and decision["asked_tick"] == decision["tick"]
        else ""
        for decision in recorded.decisions
    ]
