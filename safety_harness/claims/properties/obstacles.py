"""Check that the arm keeps away from the boxes in its cell."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from safety_harness.cell.robot.obstacles import box_records, distances_m
from safety_harness.claims.properties.base import Evaluation, Unit, Worded, judged
from safety_harness.claims.properties.clear_ways import least_along
from safety_harness.claims.properties.entry import CatalogueEntry
from safety_harness.claims.properties.measured import reads, unexercised
from safety_harness.claims.signals.hand_distance import joint_bend_m
from safety_harness.claims.signals.true_motion import arm_of
from safety_harness.trace.trace import Trace


@dataclass(frozen=True, kw_only=True)
class ObstacleDistance(Worded):
    """The claim that no moving link comes nearer to an obstacle than ``minimum_m``.

    The margin is the least distance of any moving link from any obstacle, less ``minimum_m``. Between ticks,
    ``least_along`` returns bounds of the distance. The claim is violated only if the upper bound of the least
    distance is also below ``minimum_m``. Every tick of a scenario with an obstacle exercises the claim.
    """

    minimum_m: float
    unit: Unit = Unit.LENGTH
    wording: ClassVar[str] = "obstacle distance never below {minimum_m:mm}"

    @reads("joint_position_rad", "joint_velocity_radps")
    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge the distance at every tick and between the ticks."""
        obstacles = trace.scenario.obstacles
        if not obstacles:
            return unexercised(self, "obstacles = 0; a box in the cell exercises it")
        arm, boxes = arm_of(trace), box_records(obstacles)
        (low_m,), (high_m,), (worst,) = least_along(
            lambda q: distances_m(arm, boxes, np.ascontiguousarray(q))[:, None],
            trace.ticks["joint_position_rad"],
            arm.reach_m,
            joint_bend_m(trace),
            self.minimum_m,
        )
        parts, most = "the arm and an obstacle", float(high_m) - self.minimum_m
        return judged(
            self, trace, low_m - self.minimum_m, trace.time_s[worst], parts, len(trace.ticks), most=most
        )


OBSTACLE_DISTANCE = CatalogueEntry(
    prop=ObstacleDistance(minimum_m=0.02),
    rationale=(
        "an arm that runs into a fixture stops there or breaks the fixture, and crushes anything in between"
    ),
    source="the project's own; capsules as for the hand distance",
    margin=(
        "the least distance of the surface of any link, except the base, from the surface of "
        "any obstacle, minus the limit. Between ticks, it is a lower bound"
    ),
    parameters="the limit; the scenario's obstacles",
    exercised="the scenario has an obstacle",
    scenario="box-beside-the-way",
    broken_by="the visual servo, which ignores obstacles, with an obstacle on its path",
)
