"""Which avoider a scenario's reference means."""

from __future__ import annotations

from difflib import get_close_matches

from safety_harness.avoidance.avoider import Avoider
from safety_harness.avoidance.nearest_candidate import NearestCandidate
from safety_harness.avoidance.opposite import OppositePose
from safety_harness.exceptions import InadmissibleError
from safety_harness.scenario.model import Scenario

NAMES = ("opposite pose", "nearest candidate")


def avoider_of(scenario: Scenario) -> Avoider:
    """The avoider that ``scenario.avoider`` names; InadmissibleError with the list of known ones."""
    if scenario.avoider == "opposite pose":
        return OppositePose(scenario.settings.avoidance.radius_m)
    if scenario.avoider == "nearest candidate":
        return NearestCandidate.of(scenario.settings)
    near = get_close_matches(scenario.avoider, NAMES, n=1)
    raise InadmissibleError(
        place=scenario.place("avoider"),
        expected="one of: " + ", ".join(NAMES),
        got=repr(scenario.avoider),
        hint=f"did you mean {near[0]!r}?" if near else "",
    )
