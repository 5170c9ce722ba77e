"""What is asked of the repulsive positions: they can be reached, and they lead away from the hands."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from safety_harness.properties.base import Evaluation, Unit, inconclusive, judged, unreadable
from safety_harness.robot.description import load_arm
from safety_harness.robot.inverse import InverseKinematics
from safety_harness.trace.records import Outcome
from safety_harness.trace.trace import Trace

BEYOND_M = 0.100  # how far beyond the position reachability is looked for


@lru_cache
def _kinematics() -> InverseKinematics:
    return InverseKinematics(load_arm())


@dataclass(frozen=True, kw_only=True)
class RepulsivePosesReachable:
    """Every repulsive position can be reached by inverse kinematics along the straight way there.

    Margin of one decision: how much farther along the line from the TCP through the position the
    arm could go, continuously, within its joint limits and away from singularities (at most
    100 mm is looked for); negative by what is missing to the position.  ``proposed`` judges what the
    avoider said, otherwise what the system chose after its checks.

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
        problem = unreadable(trace, ())
        if problem is not None:
            return inconclusive(self, problem)
        field = "proposed_position_in_base_m" if self.proposed else "chosen_position_in_base_m"
        worst, worst_time_s, count = np.inf, 0.0, 0
        for decision in trace.decisions:
            position_in_base_m = decision[field]
            if not self.proposed and decision["outcome"] == Outcome.STOP:
                continue  # nothing was chosen: the arm stops where it is
            count += 1
            if np.all(np.isfinite(position_in_base_m)):
                margin = reach_margin(
                    decision["joint_position_rad"],
                    decision["tcp_position_in_base_m"],
                    position_in_base_m,
                    trace.scenario.settings.motion.min_singular_value,
                )
            else:  # an avoider that proposes nothing usable has no reachable position
                margin = -trace.scenario.settings.avoidance.radius_m
            if margin < worst:
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


def reach_margin(
    joint_position_rad: NDArray[np.float64],
    tcp_position_in_base_m: NDArray[np.float64],
    position_in_base_m: NDArray[np.float64],
    min_singular_value: float,
) -> float:
    """How far beyond (or, negative, short of) ``position_in_base_m`` the straight way goes [m]."""
    way = position_in_base_m - tcp_position_in_base_m
    length_m = float(np.linalg.norm(way))
    if length_m == 0.0:
        return 0.0
    reach_m = _kinematics().reach_along(
        joint_position_rad, way / length_m, length_m + BEYOND_M, min_singular_value=min_singular_value
    )
    return reach_m - length_m


@dataclass(frozen=True, kw_only=True)
class MovesAway:
    """Giving way never brings the TCP nearer to any hand, along the whole way.

    Planned: the distance from a fixed point to a straight way is convex, so the way leads away
    from a hand everywhere if it does at its start; its margin is the component of the
    displacement away from the hand, (p - t) . (t - h)/|t - h|, least over all true hands.
    Executed: until the next decision or the arrival, the TCP must not come nearer to where the
    hand was by more than the unavoidable, v^2/(2 a) + v dt for the speed v towards the hand that
    it had when the decision was made; if it does, the excess is the (negative) margin.

    Source: section 4.1 of the paper ("a quarter of a sphere will lead the robot to move away").
    """

    unit: Unit = Unit.LENGTH

    @property
    def sentence(self) -> str:
        """As the catalogue writes it."""
        return "repulsion moves away from every hand"

    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge each decision's planned and executed way."""
        problem = unreadable(trace, ("transform_tcp_to_base", "hand_position_in_base_m"))
        if problem is not None:
            return inconclusive(self, problem)
        worst, worst_time_s, count, what = np.inf, 0.0, 0, ""
        for number, decision in enumerate(trace.decisions):
            if decision["outcome"] == Outcome.STOP:
                continue
            count += 1
            last = self._last_tick(trace, number)
            for hand in np.flatnonzero(trace.ticks["hand_present"][decision["tick"]]):
                planned, executed = away_margins(trace, decision, int(hand), last)
                margin, kind = min((planned, "planned"), (executed, "executed"))
                if executed >= 0.0:
                    margin, kind = planned, "planned"
                if not margin >= worst:
                    worst, worst_time_s = margin, float(decision["time_s"])
                    what = f"{kind} way, {trace.scenario.hands[hand].name}"
        if count == 0:
            return inconclusive(self, "never exercised: the arm never gave way")
        return judged(
            self,
            trace,
            margin=worst,
            worst_time_s=worst_time_s,
            reason=f"{what}, worst of {count}" if count > 1 else what,
            exercised=count,
        )

    def _last_tick(self, trace: Trace, number: int) -> int:
        """The last tick of the repulsion that decision ``number`` began."""
        first = int(trace.decisions[number]["tick"])
        following = trace.decisions["tick"][number + 1 :]
        end = int(following[0]) if len(following) else len(trace.ticks) - 1
        modes = trace.ticks["mode"][first : end + 1]
        moved_on = np.flatnonzero(modes != modes[0])
        return first + int(moved_on[0]) if len(moved_on) else end


def away_margins(trace: Trace, decision: np.void, hand: int, last: int) -> tuple[float, float]:
    """(planned, executed) margins [m] of one decision against one hand, held where it was."""
    first = int(decision["tick"])
    settings = trace.scenario.settings
    hand_in_base = trace.ticks["hand_position_in_base_m"][first, hand]
    tcp_in_base = trace.ticks["transform_tcp_to_base"][first : last + 1, :3, 3]  # (n, 3)
    apart = tcp_in_base[0] - hand_in_base
    distance = float(np.linalg.norm(apart))
    if distance == 0.0:
        return np.inf, np.inf  # every way leads away from a hand that is at the TCP
    away = apart / distance
    planned = float((decision["chosen_position_in_base_m"] - tcp_in_base[0]) @ away)
    dt_s = settings.clock.control_period_s
    before = trace.ticks["transform_tcp_to_base"][max(first - 1, 0), :3, 3]
    towards_mps = max(0.0, -float((tcp_in_base[0] - before) @ away) / dt_s)
    unavoidable_m = (
        towards_mps**2 / (2.0 * settings.avoidance.repulsion_acceleration_mps2) + 2.0 * towards_mps * dt_s
    )
    dip_m = float(np.min(np.linalg.norm(tcp_in_base - hand_in_base, axis=1)) - distance)
    return planned, dip_m + unavoidable_m + 1e-4
