"""What a decision costs in simulated time, as far as it depends on who decides."""

from __future__ import annotations

import shlex

from safety_harness.avoidance.avoider import Avoider, decision_time_of
from safety_harness.exceptions import AvoiderError, InadmissibleError
from safety_harness.scenario.model import Scenario
from safety_harness.settings import DecisionTimes


def check_decision_time(scenario: Scenario, avoider: Avoider, own: str) -> None:
    """InadmissibleError for a profile of another avoider, and for one that declares what is no time.

    ``own`` is the hash of the avoider's file; empty for one without.
    """
    try:
        decision_time_of(avoider)
    except AvoiderError as error:
        raise InadmissibleError(
            place=scenario.place("avoider"), expected="an avoider that declares a time", got=str(error)
        ) from None
    cost = scenario.settings.avoidance.decision_time
    measured = cost.measured if isinstance(cost, DecisionTimes) else None
    if measured is None:
        return
    if measured.sha256 != own or (not own and measured.avoider != scenario.avoider):
        raise InadmissibleError(
            place=scenario.place("settings.avoidance.decision time"),
            expected=f"a profile of the avoider {scenario.avoider}, as its file is now",
            got=f"one of {measured.avoider}" + (f", sha256 {measured.sha256[:12]}..." if own else ""),
            hint=f"safety-harness time {shlex.quote(scenario.avoider)} --out FILE.json",
        )
