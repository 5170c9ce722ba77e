"""The robot never comes nearer to a hand than a given distance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from safety_harness.claims.properties.base import Evaluation, Unit, inconclusive, judged, times_begun
from safety_harness.claims.properties.entry import CatalogueEntry, quantity
from safety_harness.claims.properties.measured import reads
from safety_harness.claims.signals.hand_distance import (
    capsule_name,
    closest_approach,
    distance_moved_m,
    followed_hands,
    known_to,
)
from safety_harness.claims.signals.occasions import nearest_of, occasion_m
from safety_harness.claims.signals.true_motion import RESOLUTION_M, hand_paths, true_motion
from safety_harness.scenario.units import LENGTH
from safety_harness.trace.trace import Trace


def _ends(prop: HandDistance, trace: Trace, margin_m: float) -> tuple[float, float, bool]:
    """For ``reads``: the way of distance and joint bend, and the resolution of what is between ticks.

    From below at every moment, as closely as it is known there; from above by the distances at the ticks.
    """
    at_ticks_m, between_m = distance_moved_m(trace)
    off_m, surely_m = np.maximum(at_ticks_m, between_m), true_motion(trace).nearest_m + at_ticks_m
    low_m = margin_m - float(off_m.max())
    if off_m.min() < off_m.max():
        low_m = max(low_m, closest_approach(trace, hand_paths(trace), off_m).low_m - prop.minimum_m)
    nearest_m = float(surely_m.min())
    return low_m - RESOLUTION_M, nearest_m - prop.minimum_m, nearest_m < prop.near_m


@dataclass(frozen=True, kw_only=True)
class HandDistance:
    """min over time of d(t) - ``minimum_m``, d from any hand or forearm to any link, surface to surface.

    Between two ticks the margin is a guaranteed lower bound of the distance: hands turn where their
    moves or samples turn, and joints move linearly, from which it is at most 0.1 mm below; it is
    lower by what joints may leave the straight line while their speeds change (``joint_bend_m``),
    and hands while theirs do (``hand_bend_m``).  It is violated if the upper end of the least distance is
    below ``minimum_m`` too.

    Rationale: contact with a moving robot is the hazard itself; ISO/TS 15066 speaks of a
    protective separation distance, of which this is the constant form.  Exercised when a hand
    comes within ``near_m``, by default ``occasion_m``; a run in which none did says nothing.
    """

    minimum_m: float
    near_m: float
    unit: Unit = Unit.LENGTH

    @property
    def sentence(self) -> str:
        """As the catalogue writes it."""
        return f"hand distance never below {self.minimum_m * 1e3:g} mm"

    @reads(
        "joint_position_rad",
        "joint_velocity_radps",
        "transform_tcp_to_base",
        "hand_position_in_base_m",
        "elbow_position_in_base_m",
        "hand_distance_m",
        also=["hand_distance_capsule"],
        of_each_hand=True,
        ends=_ends,
    )
    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge the closest approach, between ticks too."""
        paths, why = followed_hands(trace)
        if paths is None:
            return inconclusive(self, why)
        found = known_to(self.minimum_m, closest_approach, trace, paths)
        nearest_m = true_motion(trace).nearest_m
        name = trace.scenario.hands[found.hand].name
        part = capsule_name(trace, int(np.argmin(trace.ticks["hand_distance_m"][:, found.hand])), found.hand)
        reason = f"{name}: {_words(found.low_m if found.low_m > -np.inf else found.high_m)} {part}"
        margin_m, times = found.low_m - self.minimum_m, times_begun(nearest_m < self.near_m)
        most_m = found.high_m - self.minimum_m

        def lacked() -> str:
            return nearest_of(trace, nearest_m, self.near_m, "hand", "the arm's surface")

        return judged(self, trace, margin_m, found.time_s, reason, times, lacked, most=most_m)


def _words(distance_m: float) -> str:
    if distance_m < 0.0:
        return f"{-distance_m * 1e3:.1f} mm inside"
    return f"{distance_m * 1e3:.1f} mm from"


def _at_least(minimum_m: float) -> HandDistance:
    return HandDistance(minimum_m=minimum_m, near_m=occasion_m(minimum_m))


HAND_DISTANCE = CatalogueEntry(
    prop=_at_least(0.05),
    pattern=r"hand distance never below (.+)",
    make=lambda match, _, place: _at_least(quantity(match[1], LENGTH, place)),
    rationale="contact with a moving robot is the hazard itself",
    source="the protective separation distance as a constant",
    margin="least distance, surface to surface, of any hand or forearm from any link, less the limit; a "
    "guaranteed bound between ticks",
    parameters="the limit; the hands' sizes of the settings",
    exercised="a hand comes within 400 mm of the arm's surface, or within twice a limit above 200 mm",
    inconclusive="a hand that is not where its scenario moves it",
    broken_by="an avoider that heads for the hand, behind a gate that passes everything",
)
