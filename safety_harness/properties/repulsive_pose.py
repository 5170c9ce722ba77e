"""What is asked of the repulsive positions: they can be reached."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from safety_harness.properties.base import Evaluation, Unit, inconclusive, is_somewhere, judged, unreadable
from safety_harness.properties.entry import CatalogueEntry
from safety_harness.robot.description import load_arm
from safety_harness.robot.inverse import InverseKinematics
from safety_harness.trace.records import DecisionOutcome
from safety_harness.trace.trace import Trace, once_a_trace

BEYOND_M = 0.100  # how far beyond the position reachability is looked for


@lru_cache
def _kinematics(arm_name: str) -> InverseKinematics:
    return InverseKinematics(load_arm(arm_name))


@dataclass(frozen=True, kw_only=True)
class RepulsivePosesReachable:
    """Every repulsive position can be reached by inverse kinematics along the straight way there.

    Margin of one decision: how much farther along the line from the TCP through the position the
    arm could go, continuously, within its joint limits and away from singularities (at most
    100 mm is looked for); negative by what is missing to the position.  ``proposed`` judges what the
    avoider said, otherwise what the system chose after its checks.  The way begins where the arm
    truly was.

    Source: table 4 of the paper, which counts positions "out of the reach range of the robot".
    """

    proposed: bool
    unit: Unit = Unit.LENGTH

    @property
    def sentence(self) -> str:
        """As the catalogue writes it."""
        return "proposed repulsive poses reachable" if self.proposed else "repulsive poses reachable"

    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge every decision's position."""
        problem = unreadable(trace, ("joint_position_rad", "transform_tcp_to_base"))
        if problem is not None:
            return inconclusive(self, problem)
        field = "proposed_position_in_base_m" if self.proposed else "chosen_position_in_base_m"
        worst, worst_time_s, count = np.inf, 0.0, 0
        for decision in trace.decisions:
            position_in_base_m = decision[field]
            if not self.proposed and decision["outcome"] == DecisionOutcome.STOP:
                continue  # nothing was chosen: the arm stops where it is
            count += 1
            margin = reach_m(trace, decision, position_in_base_m)
            if not margin >= worst:
                worst, worst_time_s = margin, float(decision["time_s"])
        if count == 0:
            return inconclusive(self, "never exercised: no repulsive position was asked for")
        return judged(
            self,
            trace,
            margin=worst,
            worst_time_s=worst_time_s,
            reason=f"worst of {count}" if count > 1 else "one position",
            exercised=count,
        )


def reach_m(trace: Trace, decision: np.void, position_in_base_m: NDArray[np.float64]) -> float:
    """How much farther than a position the straight way there goes; minus the radius for no position.

    The way begins where the arm truly was at the decision.  Several claims ask for the same ways.
    """
    if not is_somewhere(position_in_base_m):
        return -trace.scenario.settings.avoidance.radius_m
    known, key = _reaches_m(trace), (int(decision["tick"]), position_in_base_m.tobytes())
    if key not in known:
        tick = trace.ticks[decision["tick"]]
        known[key] = reach_margin(
            tick["joint_position_rad"],
            tick["transform_tcp_to_base"][:3, 3],
            position_in_base_m,
            trace.scenario.settings.motion.min_singular_value,
            trace.scenario.robot.arm_name,
        )
    return known[key]


@once_a_trace
def _reaches_m(_: Trace) -> dict[tuple[int, bytes], float]:
    """By tick and position, those that somebody has asked for."""
    return {}


def reach_margin(
    joint_position_rad: NDArray[np.float64],
    tcp_position_in_base_m: NDArray[np.float64],
    position_in_base_m: NDArray[np.float64],
    min_singular_value: float,
    arm_name: str = "ur10",
) -> float:
    """How far beyond (or, negative, short of) ``position_in_base_m`` the straight way goes [m]."""
    way = position_in_base_m - tcp_position_in_base_m
    length_m = float(np.linalg.norm(way))
    if length_m == 0.0:
        return 0.0
    reach_m = _kinematics(arm_name).reach_along(
        joint_position_rad,
        way / length_m,
        length_m + BEYOND_M,
        min_singular_value=min_singular_value,
    )
    return reach_m - length_m


def _entry(*, proposed: bool) -> CatalogueEntry:
    prop = RepulsivePosesReachable(proposed=proposed)
    return CatalogueEntry(
        example=prop.sentence,
        pattern=prop.sentence,
        make=lambda *_: prop,
        unit=prop.unit,
        rationale="a position out of reach is none to give way to: the arm stops short of it, near the hand",
        source="the paper, table 4",
        margin="the same for what the avoider proposed, before the gate"
        if proposed
        else "how far beyond the chosen position the straight way goes on being reachable within the joint "
        "limits and away from singularities (at most 100 mm is looked for), or what is missing to it",
        parameters="the least singular value of the settings",
        exercised="a decision was made" if proposed else "a position was chosen",
        inconclusive="-",
        scenario="hand-visits-and-leaves",
        broken_by="an avoider that proposes a position two metres away"
        + ("" if proposed else ", behind a gate that passes everything"),
    )


REPULSIVE_POSES = _entry(proposed=False)
PROPOSED_POSES = _entry(proposed=True)
