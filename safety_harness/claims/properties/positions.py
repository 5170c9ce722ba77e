"""Judge retreat positions.

The functions find out whether the arm can reach a position, whether the arm went there, and whether it
stopped instead. The functions do not rely on the gate's own records. They compute again the opposite pose and
whether a position was usable. A separate claim judges whether positions are reachable.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from math import ceil

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.elementary import length, product
from safety_harness.cell.avoidance.gate import OWN_CLEARANCE_M, REACH_MARGIN_M
from safety_harness.cell.robot.inverse import REACH_RESOLUTION_M, straight_way
from safety_harness.cell.robot.obstacles import box_records, distances_m
from safety_harness.cell.robot.robots import arm_model, inverse_kinematics
from safety_harness.claims.properties.base import Evaluation, Unit, is_somewhere, judged
from safety_harness.claims.properties.clear_ways import clearances_m
from safety_harness.claims.properties.entry import CatalogueEntry
from safety_harness.claims.properties.giving_way import MODEST, RepulsionProgress, Shares, last_tick, progress
from safety_harness.claims.properties.measured import reads, unexercised
from safety_harness.claims.signals.occasions import no_position
from safety_harness.claims.signals.true_motion import arm_of
from safety_harness.trace.known import OF_DECISIONS
from safety_harness.trace.records import DecisionOutcome, Mode
from safety_harness.trace.trace import Trace, once_a_trace

# A choice, five times finer than the gate's own step.
WAY_STEP_M = 0.005
STOP_SLACK_M = 0.002  # of way, and of time
STOP_GRACE_TICKS = 3  # the drives lag behind their ramp
START_COLUMNS = ("joint_position_rad", "transform_tcp_to_base")  # where the straight way to a position begins
BEYOND_M = 0.100  # how far beyond the position the search for reachable points goes


def opposite_position(trace: Trace, decision: np.void) -> NDArray[np.float64]:
    """Return the position (3,) a radius away from the TCP, opposite to the nearest predicted hand.

    The position is NaN if it is undefined. The settings give the radius.
    """
    tick = trace.ticks[decision["tick"]]
    tcp_in_base = tick["transform_tcp_to_base"][:3, 3]
    hands = tick["predicted_hand_in_base_m"][tick["track_valid"]]
    if len(hands) == 0:  # it has gone while the avoider was thinking
        hands = decision["hand_position_in_base_m"][None]
    if not all(is_somewhere(hand) for hand in hands):
        return np.full(3, np.nan)
    distances_m = np.linalg.norm(hands - tcp_in_base, axis=1)
    nearest = int(np.argmin(distances_m))
    if not distances_m[nearest] > 0.0:
        return np.full(3, np.nan)
    share = trace.scenario.settings.avoidance.radius_m / distances_m[nearest]
    return np.asarray(tcp_in_base + share * (tcp_in_base - hands[nearest]))


def spare_m(trace: Trace, decision: np.void, position_in_base_m: NDArray[np.float64]) -> float:
    """Return the reserve [m] of ``position_in_base_m`` (3,), which is negative if the arm cannot use it.

    The result is the least of four reserves. The first is the distance that the arm could go beyond the
    position, minus the gate's reserve of 10 mm. The second is the height above the least height of a TCP. The
    third is the component of the way that leads away from a predicted hand. The fourth is the least clearance
    along the way: of the wrist from the body, and of the arm from the cell's boxes. This clearance is reduced
    by 20 mm, as in the gate, or by the clearance at the start of the way, whichever is less. The result is
    NaN if a prediction is not finite.
    """
    settings, tick = trace.scenario.settings, trace.ticks[decision["tick"]]
    spare = reach_m(trace, decision, position_in_base_m) - REACH_MARGIN_M
    if not is_somewhere(position_in_base_m):
        return spare
    lowest_m = settings.cell.table_height_m + settings.avoidance.table_clearance_m
    tcp_in_base = tick["transform_tcp_to_base"][:3, 3]
    spare = min(spare, float(position_in_base_m[2]) - lowest_m)
    for hand in tick["predicted_hand_in_base_m"][tick["track_valid"]]:
        if not is_somewhere(hand):
            return np.nan
        distance_m = length(tcp_in_base - hand)
        away = float(product(position_in_base_m - tcp_in_base, tcp_in_base - hand))
        spare = min(spare, away / distance_m if distance_m > 0.0 else spare)
    if spare < 0.0:
        return spare
    arm = arm_model(trace.scenario.robot)
    joints_rad = straight_way(arm, tick["joint_position_rad"], position_in_base_m, step_m=WAY_STEP_M)
    clear = [clearances_m(trace, joints_rad)[:, 2]]
    if trace.scenario.obstacles:
        clear.append(distances_m(arm_of(trace), box_records(trace.scenario.obstacles), joints_rad))
    return min(spare, *(float(way_m.min() - min(OWN_CLEARANCE_M, way_m[0])) for way_m in clear))


def gone_towards(
    trace: Trace,
    number: int,
    target_in_base_m: NDArray[np.float64],
    after_ticks: int,
    shares: Shares = MODEST,
) -> RepulsionProgress | None:
    """Return the progress of the repulsion of decision ``number``, compared with a new reference.

    The reference heads for the target ``target_in_base_m`` (3,). The reference begins ``after_ticks`` after
    the decision, with the position and the velocity that the TCP then has. The result is None if the
    repulsion was over at that time.
    """
    last = last_tick(trace, number)
    decision = trace.decisions[number : number + 1].copy()
    decision["tick"] += after_ticks
    decision["chosen_position_in_base_m"] = target_in_base_m
    if int(decision["tick"][0]) >= last:
        return None
    return progress(trace, decision[0], last, None, shares)


def stopped_m(trace: Trace, tick: int) -> float:
    """Return the allowed travel [m] of the TCP in a protective stop from ``tick``, minus its actual travel.

    The allowed distance is v T_r + v T_s/2 for the speed v at that tick, plus one control period's distance
    and 2 mm. The TCP's motion is measured during T_r + T_s, and for as long as the controller reports a stop.
    """
    braking, period_s = trace.scenario.settings.braking, trace.scenario.settings.clock.control_period_s
    speed_mps = float(trace.ticks["tcp_speed_mps"][tick])
    stop_s = braking.stop_time_base_s + braking.stop_time_per_speed_s2pm * speed_mps
    last = tick + ceil((braking.reaction_time_s + stop_s) / period_s) + STOP_GRACE_TICKS
    released = np.flatnonzero(trace.ticks["mode"][last:] != Mode.PROTECTIVE_STOP)
    last += int(released[0]) if len(released) else len(trace.ticks)
    tcp_in_base = trace.ticks["transform_tcp_to_base"][tick : last + 1, :3, 3]
    way_m = float(np.linalg.norm(np.diff(tcp_in_base, axis=0), axis=1).sum())
    allowed_s = braking.reaction_time_s + 0.5 * stop_s + period_s
    return speed_mps * allowed_s + STOP_SLACK_M - way_m


@dataclass(frozen=True, kw_only=True)
class RepulsivePosesReachable:
    """The claim that the arm can reach every repulsive position along the straight way from the TCP.

    The margin of a decision is how far the arm could go beyond the position, along the straight line from the
    TCP. The arm must move continuously, within its joint limits and away from singularities. The search ends
    at 100 mm. If the arm cannot reach the position, the margin is minus the missing distance. If ``proposed``
    is True, the claim judges the avoider's proposal. Otherwise it judges the system's choice after its
    checks. The way begins at the true position of the TCP, computed from the true joints.

    Source: table 4 of the paper, which counts positions "out of the reach range of the robot".
    """

    proposed: bool
    unit: Unit = Unit.LENGTH

    @property
    def sentence(self) -> str:
        """Return the sentence of the catalogue."""
        return "proposed repulsive poses reachable" if self.proposed else "repulsive poses reachable"

    @property
    def reads(self) -> tuple[str, ...]:
        """Return the columns that the claim reads, including the proposed or the chosen position."""
        positions = (
            ("proposed_position_in_base_m",) if self.proposed else ("chosen_position_in_base_m", "outcome")
        )
        return (*START_COLUMNS, *(f"{OF_DECISIONS}{name}" for name in ("tick", "time_s", *positions)))

    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge every decision's position."""
        return _judging(self.reads)(self, trace)

    def _worst(self, trace: Trace) -> Evaluation:
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
            return unexercised(self, no_position(trace))
        reason = f"worst of {count}" if count > 1 else "one position"
        return judged(self, trace, worst, worst_time_s, reason, exercised=count)


@lru_cache(maxsize=2)
def _judging(names: tuple[str, ...]) -> Callable[[RepulsivePosesReachable, Trace], Evaluation]:
    return reads(*START_COLUMNS, also=names)(RepulsivePosesReachable._worst)


def reach_m(trace: Trace, decision: np.void, position_in_base_m: NDArray[np.float64]) -> float:
    """Return how far [m] the arm can continue in a straight line beyond a position.

    If there is no position, the result is minus the radius of the retreat. The way begins at the arm's true
    position at the decision, and leads through ``position_in_base_m`` (3,). The results are stored, because
    several claims need them.
    """
    if not is_somewhere(position_in_base_m):
        return -trace.scenario.settings.avoidance.radius_m
    known, key = _reaches_m(trace), (int(decision["tick"]), position_in_base_m.tobytes())
    if key not in known:
        tick = trace.ticks[decision["tick"]]
        displacement = position_in_base_m - tick["transform_tcp_to_base"][:3, 3]
        known[key] = _beyond_m(trace, tick["joint_position_rad"], displacement)
    return known[key]


@once_a_trace
def _reaches_m(_: Trace) -> dict[tuple[int, bytes], float]:
    """Return the stored results of ``reach_m`` for the trace, by tick and position."""
    return {}


def _beyond_m(trace: Trace, joints_rad: NDArray[np.float64], displacement: NDArray[np.float64]) -> float:
    """Return how far [m] the arm can go beyond the end of ``displacement`` (3,).

    The result is negative if the arm cannot reach the end. The arm begins at ``joints_rad`` (6,). The result
    is at most 0.1 mm too small, but never below zero if the arm can reach the end.
    """
    length_m = length(displacement)
    if length_m == 0.0:
        return 0.0
    least = trace.scenario.settings.motion.min_singular_value
    kinematics = inverse_kinematics(trace.scenario.robot)

    def beyond_m(far_m: float) -> float:
        gone_m = kinematics.reach_along(joints_rad, displacement / length_m, far_m, min_singular_value=least)
        return gone_m - length_m

    found_m = beyond_m(length_m + BEYOND_M)
    # The search may stop just before a boundary at the end, by its resolution: then the end itself is tried.
    return max(found_m, beyond_m(length_m)) if -REACH_RESOLUTION_M <= found_m < 0.0 else found_m


REPULSIVE_POSES = CatalogueEntry(
    prop=RepulsivePosesReachable(proposed=False),
    pattern=r"(?:repulsive|retreat) poses reachable",
    rationale="an arm that retreats to a position out of reach stops on the way, near the hand",
    source="the paper, table 4",
    margin=(
        "the distance beyond the chosen position over which the straight path remains "
        "reachable, within the joint limits and away from singularities (at most 100 mm). If "
        "the position is out of reach, the margin is minus the missing part of the path"
    ),
    parameters="the least singular value in the settings",
    exercised="the controller chose a position",
    broken_by=(
        "an avoider that proposes a position two metres away, behind a gate that accepts every proposal"
    ),
)
PROPOSED_POSES = replace(
    REPULSIVE_POSES,
    prop=RepulsivePosesReachable(proposed=True),
    pattern=r"proposed (?:repulsive|retreat) poses reachable",
    margin="the same distance, but for the position that the avoider proposed, before the gate",
    exercised="the controller made a decision",
    broken_by="an avoider that proposes a position two metres away",
)
