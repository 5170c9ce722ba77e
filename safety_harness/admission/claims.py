"""From a claim's sentence to its property: the catalogue as people write it."""

from __future__ import annotations

import re
from collections.abc import Callable
from difflib import get_close_matches

from safety_harness.exceptions import InadmissibleError, Place
from safety_harness.properties.base import Property
from safety_harness.properties.giving_way import MovesAway
from safety_harness.properties.hand_distance import HandDistance
from safety_harness.properties.limits import JointLimits, JointSpeedLimits, TcpSpeedLimit
from safety_harness.properties.repulsive_pose import RepulsivePosesReachable
from safety_harness.properties.servoing import Converged, GainSwitchReached
from safety_harness.scenario.model import Claim, Scenario
from safety_harness.scenario.units import LENGTH, SPEED, TIME, Dimension, parse_quantity

_LARGEST = {LENGTH.name: 10.0, SPEED.name: 10.0, TIME.name: 3600.0}  # in SI

Maker = Callable[[re.Match[str], Scenario, Place], Property]


def _quantity(text: str, dimension: Dimension, place: Place) -> float:
    """A quantity above zero: a limit of zero or less would be kept by anything, or by nothing."""
    value = parse_quantity(text, dimension, place)
    most = _LARGEST[dimension.name]
    if not 0.0 < value <= most:
        expected = f"{dimension.expected}, above zero and at most {most:g} {dimension.si}"
        raise InadmissibleError(place=place, expected=expected, got=repr(text))
    return value


def _hand_distance(match: re.Match[str], scenario: Scenario, place: Place) -> Property:
    minimum_m = _quantity(match[1], LENGTH, place)
    return HandDistance(minimum_m=minimum_m, near_m=scenario.settings.avoidance.critical_distance_m)


def _tcp_speed(match: re.Match[str], scenario: Scenario, place: Place) -> Property:
    return TcpSpeedLimit(maximum_mps=_quantity(match[1], SPEED, place))


def _gain_switch(match: re.Match[str], scenario: Scenario, place: Place) -> Property:
    return GainSwitchReached(within_s=_quantity(match[1], TIME, place))


CATALOGUE: tuple[tuple[str, str, Maker], ...] = (
    ("hand distance never below 50 mm", r"hand distance never below (.+)", _hand_distance),
    (
        "repulsive poses reachable",
        r"repulsive poses reachable",
        lambda *_: RepulsivePosesReachable(proposed=False),
    ),
    (
        "proposed repulsive poses reachable",
        r"proposed repulsive poses reachable",
        lambda *_: RepulsivePosesReachable(proposed=True),
    ),
    ("repulsion moves away from every hand", r"repulsion moves away from every hand", lambda *_: MovesAway()),
    ("joint positions within limits", r"joint positions within limits", lambda *_: JointLimits()),
    ("joint speeds within limits", r"joint speeds within limits", lambda *_: JointSpeedLimits()),
    ("TCP speed never above 250 mm/s", r"TCP speed never above (.+)", _tcp_speed),
    ("gain switch reached", r"gain switch reached", lambda *_: GainSwitchReached()),
    ("gain switch reached within 5 s", r"gain switch reached within (.+)", _gain_switch),
    ("converged to the desired pose", r"converged to the desired pose", lambda *_: Converged()),
)


def property_of(claim: Claim, scenario: Scenario) -> Property:
    """The property that a claim's sentence names; InadmissibleError with the catalogue otherwise."""
    for _, pattern, make in CATALOGUE:
        match = re.fullmatch(pattern, claim.sentence.strip(), re.IGNORECASE)
        if match:
            return make(match, scenario, claim.place)
    examples = [example for example, _, _ in CATALOGUE]
    near = get_close_matches(claim.sentence, examples, n=1, cutoff=0.5)
    raise InadmissibleError(
        place=claim.place,
        expected="a claim of the catalogue: " + "; ".join(examples),
        got=repr(claim.sentence),
        hint=f"did you mean {near[0]!r}?" if near else "",
    )
