"""A repulsion leads into nothing else: not into the table, the object or the robot itself."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from safety_harness.properties.base import Evaluation, Unit, inconclusive, is_somewhere, judged, unreadable
from safety_harness.properties.clearance import OBSTACLES, clearances_m
from safety_harness.properties.entry import CatalogueEntry
from safety_harness.properties.giving_way import last_tick
from safety_harness.properties.true_motion import joint_reach_m
from safety_harness.robot.description import load_arm
from safety_harness.robot.straight_way import straight_way
from safety_harness.trace.records import DecisionOutcome
from safety_harness.trace.trace import Trace

STEP_M = 0.0025  # between two samples of a planned way
READS = ("joint_position_rad", "joint_velocity_radps", "transform_tcp_to_base")


@dataclass(frozen=True)
class Way:
    """The least clearance from each obstacle (3,) [m] along one way, and when it was [s] (3,)."""

    words: str
    least_m: NDArray[np.float64]
    time_s: NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class ClearWays:
    """Least clearance of any link from table, object and the robot itself along every repulsion.

    Planned: the straight way from where the arm truly was to the chosen position, as far as the arm
    can follow it.  Executed: the true joints from the decision to the end of the repulsion.  Between
    two samples the clearance is a lower bound: a point moves by no more than each joint's turn times
    the length of the chain of links behind it.

    ``parts`` says it of each obstacle.  Exercised by every way that was chosen.
    """

    unit: Unit = Unit.LENGTH
    sentence: str = "repulsive ways clear of table, object and robot"

    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge every repulsion's planned and executed way."""
        problem = unreadable(trace, READS)
        if problem is not None:
            return inconclusive(self, problem)
        ways: list[Way] = []
        reach_m = joint_reach_m(trace)
        for number, decision in enumerate(trace.decisions):
            if decision["outcome"] == DecisionOutcome.STOP:
                continue
            if not is_somewhere(decision["chosen_position_in_base_m"]):
                return inconclusive(self, f"the position chosen at {decision['time_s']:.3f} s is not finite")
            ways += [planned(trace, number, reach_m), executed(trace, number, reach_m)]
        if not ways:
            return inconclusive(self, "never exercised: no repulsive position was chosen")
        parts = tuple(self._part(trace, ways, obstacle) for obstacle in range(len(OBSTACLES)))
        unknown = next((part for part in parts if part.margin is None), None)
        worst = unknown or min(parts, key=lambda part: part.margin or 0.0)
        return replace(worst, sentence=self.sentence, parts=parts)

    def _part(self, trace: Trace, ways: list[Way], obstacle: int) -> Evaluation:
        least_m = np.array([way.least_m[obstacle] for way in ways])
        worst = ways[int(np.argmin(least_m))]  # the first NaN, if there is one
        evaluation = judged(
            self,
            trace,
            margin=float(worst.least_m[obstacle]),
            worst_time_s=float(worst.time_s[obstacle]),
            reason=f"{OBSTACLES[obstacle]}: {worst.words}",
            exercised=len(ways) // 2,
        )
        return replace(evaluation, sentence=f"repulsive ways clear of the {OBSTACLES[obstacle]}")


def planned(trace: Trace, number: int, reach_m: NDArray[np.float64]) -> Way:
    """The straight way to the position that decision ``number`` chose."""
    decision = trace.decisions[number]
    joints_rad = straight_way(
        load_arm(trace.scenario.robot.arm_name),
        trace.ticks["joint_position_rad"][decision["tick"]],
        decision["chosen_position_in_base_m"],
        step_m=STEP_M,
    )
    moved_m = np.abs(np.diff(joints_rad, axis=0)) @ reach_m
    least_m, _ = _least(clearances_m(trace, joints_rad), moved_m)
    return Way(f"planned way of decision {number}", least_m, np.full(3, decision["time_s"]))


def executed(trace: Trace, number: int, reach_m: NDArray[np.float64]) -> Way:
    """The true way from decision ``number`` to the end of its repulsion."""
    first = int(trace.decisions[number]["tick"])
    window = slice(first, last_tick(trace, number) + 1)
    joints_rad = trace.ticks["joint_position_rad"][window]
    speed_radps = np.abs(trace.ticks["joint_velocity_radps"][window])
    period_s = trace.scenario.settings.clock.control_period_s
    turned = np.abs(np.diff(joints_rad, axis=0))
    turned = np.maximum(turned, period_s * np.maximum(speed_radps[:-1], speed_radps[1:]))
    least_m, at = _least(clearances_m(trace, joints_rad), turned @ reach_m)
    return Way(f"executed way of decision {number}", least_m, trace.time_s[first + at])


def _least(
    clearance_m: NDArray[np.float64], moved_m: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """(3,) least of (n, 3) and the sample at or before it, nothing having moved more than (n-1,) between."""
    bound = clearance_m.copy()
    between = 0.5 * (clearance_m[:-1] + clearance_m[1:] - moved_m[:, None])
    bound[:-1] = np.minimum(bound[:-1], between)
    at = bound.argmin(axis=0)
    return bound[at, np.arange(3)], at


CLEAR_WAYS = CatalogueEntry(
    example="repulsive ways clear of table, object and robot",
    pattern="repulsive ways clear of table, object and robot",
    make=lambda *_: ClearWays(),
    unit=Unit.LENGTH,
    rationale="an arm that gives way to a hand and runs into the table, the workpiece or itself stops there, "
    "and what is held is crushed",
    source="the project's own; capsules as for the hand distance",
    margin="least clearance of any link along the planned and the executed way, a lower bound between "
    "samples; each obstacle apart",
    parameters="table height and object of the settings",
    exercised="a position was chosen",
    inconclusive="a chosen position that is not finite",
    scenario="hand-visits-and-leaves",
    broken_by="an avoider that proposes a position below the table, behind a gate that passes everything",
)
