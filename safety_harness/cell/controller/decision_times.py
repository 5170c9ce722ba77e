"""Compute a table for the compiled loop: the simulated time that a decision costs at each tick."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.seeds import Branch, generator
from safety_harness.base.settings import DecisionCost, DecisionTimes
from safety_harness.trace.records import Check
from safety_harness.trace.trace import Trace

NOTHING = np.zeros(1)  # a decision costs no simulated time
ON_THE_CLOCK = np.full(1, np.nan)  # ``answer_after`` reads NaN as a cost that is not yet known


def decision_times_s(
    cost: DecisionCost | DecisionTimes, declared_s: float, root_seed: int, ticks: int
) -> NDArray[np.float64]:
    """Return the simulated time [s] that a question costs at each tick, shape (n,).

    The last number applies to all later ticks. If ``cost`` has quantiles q_0 ... q_m, they are evenly spaced
    in probability, and the distribution is linear between them. The function draws by the inverse of the
    distribution function. A draw is q_k + (x - k) (q_(k+1) - q_k). Here x = m u, u is uniform in [0, 1), and
    k is the integer part of x. NaN means that the cost is the wall-clock time of the answer. ``declared_s``
    is the time that the avoider declares.
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
    """Return the table of ``decision_times_s`` from a recorded run.

    In this run, the costs were wall-clock times. A question without a decision has an infinite cost, because
    the arm stopped before the answer.
    """
    times_s = np.full(recorded.scenario.ticks + 1, np.inf)
    times_s[recorded.decisions["asked_tick"]] = recorded.decisions["decision_time_s"]
    return times_s


def recorded_late(recorded: Trace) -> list[str]:
    """Return the text of the fault for each decision whose answer exceeded a limit of wall-clock time.

    Such a decision had no cost in simulated time. Only old traces contain such decisions. The text of any
    other decision is empty.
    """
    return [
        str(decision["fault"]) or "late"
        if int(decision["proposed_failed"]) & Check.LATE and decision["asked_tick"] == decision["tick"]
        else ""
        for decision in recorded.decisions
    ]
