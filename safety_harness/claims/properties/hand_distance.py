"""Check that the robot never comes nearer to a hand than a given distance."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import numpy as np

from safety_harness.claims.properties.base import (
    OF_HANDS,
    Evaluation,
    Property,
    Unit,
    Worded,
    inconclusive,
    judged,
    times_begun,
)
from safety_harness.claims.properties.entry import CatalogueEntry
from safety_harness.claims.properties.measured import reads
from safety_harness.claims.signals.hand_distance import (
    Nearest,
    capsule_name,
    closest_approach,
    distance_moved_m,
    followed_hands,
    known_to,
)
from safety_harness.claims.signals.occasions import nearest_of, occasion_m
from safety_harness.claims.signals.true_motion import JOINTS, RESOLUTION_M, hand_paths, true_motion
from safety_harness.trace.trace import Trace

OF_DISTANCES = (*JOINTS, "transform_tcp_to_base", *OF_HANDS)


def _ends(prop: HandDistance, trace: Trace, margin_m: float) -> tuple[float, float, bool]:
    """Return the bounds of the margin for ``reads``.

    The bounds allow for the errors of the distances, for joints that do not move linearly, and for the
    resolution. The lower bound covers every moment, and the upper bound uses only the distances at the ticks.
    """
    at_ticks_m, between_m = distance_moved_m(trace)
    off_m, surely_m = np.maximum(at_ticks_m, between_m), true_motion(trace).nearest_m + at_ticks_m
    low_m = margin_m - float(off_m.max())
    if off_m.min() < off_m.max():
        low_m = max(low_m, closest_approach(trace, hand_paths(trace), off_m).low_m - prop.minimum_m)
    nearest_m = float(surely_m.min())
    return low_m - RESOLUTION_M, nearest_m - prop.minimum_m, nearest_m < prop.occasion_m


@dataclass(frozen=True, kw_only=True)
class HandDistance(Worded):
    """The claim that every hand and forearm stays at least ``minimum_m`` away from every link.

    The margin is the least value of d(t) - ``minimum_m`` during the run, where d is the least distance
    between a hand or forearm and a link. Distances are from surface to surface. Between two ticks, the margin
    uses a guaranteed lower bound of the distance. This bound is at most 0.1 mm too small if the joints move
    linearly and the hands turn only where their moves or samples turn. The margin is also reduced by the
    possible deviation from straight motion while speeds change: ``joint_bend_m`` for the joints and
    ``hand_bend_m`` for the hands. The property is violated only if the upper bound of the least distance is
    also below ``minimum_m``.

    Rationale: contact with a moving robot is the hazard itself. The limit is a constant that replaces the
    protective separation distance of ISO/TS 15066. A run exercises the property if a hand comes within
    ``near_m``, whose default is ``occasion_m``.
    """

    minimum_m: float
    near_m: float | None = None
    unit: Unit = Unit.LENGTH
    wording: ClassVar[str] = "hand distance never below {minimum_m:mm}"

    @property
    def occasion_m(self) -> float:
        """Return how near [m] a hand must come to exercise the property."""
        return occasion_m(self.minimum_m) if self.near_m is None else self.near_m

    @reads(*OF_DISTANCES, also=["hand_distance_capsule"], of_each_hand=True, ends=_ends)
    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge the closest approach of any hand, at the ticks and between them."""
        paths, why = followed_hands(trace)
        if paths is None:
            return inconclusive(self, why)
        closest = known_to(self.minimum_m, closest_approach, trace, paths)
        part = capsule_name(
            trace, int(np.argmin(trace.ticks["hand_distance_m"][:, closest.hand])), closest.hand
        )
        return judged_nearest(self, trace, closest, self.minimum_m, self.occasion_m, part)


def judged_nearest(
    prop: Property, trace: Trace, nearest: Nearest, limit_m: float, near_m: float, part: str
) -> Evaluation:
    """Judge the least distance between any hand and ``part``, which describes the arm or a part of the arm.

    A hand within ``near_m`` exercises the property.
    """
    nearest_m = true_motion(trace).nearest_m
    distance_m = nearest.low_m if nearest.low_m > -np.inf else nearest.high_m
    side = f"{-distance_m * 1e3:.1f} mm inside" if distance_m < 0.0 else f"{distance_m * 1e3:.1f} mm from"
    return judged(
        prop,
        trace,
        nearest.low_m - limit_m,
        nearest.time_s,
        f"{trace.scenario.hands[nearest.hand].name}: {side} {part}",
        times_begun(nearest_m < near_m),
        partial(nearest_of, trace, nearest_m, near_m, "hand", "the arm's surface"),
        most=nearest.high_m - limit_m,
    )


def nearest_hand(trace: Trace) -> Evaluation:
    """Judge the least distance of any hand from the arm; contact with a hand violates the property."""
    return HandDistance(minimum_m=0.0, near_m=np.inf).evaluate(trace)


HAND_DISTANCE = CatalogueEntry(
    prop=HandDistance(minimum_m=0.05),
    formula="always hand distance >= {}",
    rationale="contact with a moving robot is itself the hazard",
    source="the protective separation distance as a constant",
    margin=(
        "the least distance of the surface of any hand or forearm from the surface of any "
        "link, minus the limit. Between ticks, it is a guaranteed lower bound"
    ),
    parameters="the limit; the sizes of the hands in the settings",
    exercised="a hand comes within 400 mm of the arm's surface, or within twice a limit above 200 mm",
    inconclusive="a hand deviates from the motion in its scenario",
    broken_by="an avoider that moves towards the hand, behind a gate that accepts every proposal",
)
