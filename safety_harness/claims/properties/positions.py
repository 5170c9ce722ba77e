"""Judge positions to retreat to: whether the arm can reach them, and whether it went there or stopped.

The functions do not trust the gate's own notes. They compute again the opposite pose, and whether a position
was usable. A claim of its own judges whether positions are reachable.
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

WAY_STEP_M = 0.005
STOP_SLACK_M = 0.002  # of way, and of time
STOP_GRACE_TICKS = 3  # the drives lag behind their ramp
START_COLUMNS = ("joint_position_rad", "transform_tcp_to_base")  # where the straight way to a position begins
BEYOND_M = 0.100  # how far beyond the position the search for reachable points goes


def opposite_position(trace: Trace, decision: np.void) -> NDArray[np.float64]:
    """Return (3,) the position a radius from the TCP, away from the nearest predicted hand; NaN if undefined.

    The settings give the radius.
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
    """Return the least reserve [m] of ``position_in_base_m`` (3,); negative if the arm cannot use it.

    It is the least of four reserves. The reach counts beyond the gate's 10 mm, and the height above the least
    height of a TCP. The way counts by its component that leads away from each predicted hand. The fourth
    reserve is the least clearance along the way, of the wrist from the body and of the arm from the cell's
    boxes. It counts beyond the gate's 20 mm or, if that is less, beyond its value at the start. The result is
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
    """Return the progress of the repulsion of decision ``number`` beside a reference towards a target.

    The reference heads for ``target_in_base_m`` (3,).  It begins ``after_ticks`` after the decision, with the
    TCP's place and velocity then.  The result is None if the repulsion was over by then.
    """
    last = last_tick(trace, number)
    decision = trace.decisions[number : number + 1].copy()
    decision["tick"] += after_ticks
    decision["chosen_position_in_base_m"] = target_in_base_m
    if int(decision["tick"][0]) >= last:
        return None
    return progress(trace, decision[0], last, None, shares)


def stopped_m(trace: Trace, tick: int) -> float:
    """Return how much longer [m] the way of a protective stop from ``tick`` may be than the TCP's way.

    The allowed way is v T_r + v T_s/2 at the speed v of that tick, plus a control period's way and 2 mm. The
    TCP's way counts during T_r + T_s, and as long as the controller reports a stop.
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
    """The claim that inverse kinematics can reach every repulsive position along the straight way there.

    The margin of a decision is how far the arm could go beyond the position, straight on along the line from
    the TCP. It must move continuously, within its joint limits and away from singularities; the search ends
    at 100 mm. If the arm cannot reach the position, the margin is minus the missing distance. With
    ``proposed``, the claim judges the avoider's proposal, and otherwise the system's choice after its checks.
    The way begins at the arm's true position.

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
        """Return the columns that the claim reads, with either the proposed or the chosen position."""
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
    """Return how far [m] the arm can go straight on beyond a position; minus the radius without a position.

    The way begins at the arm's true position at the decision, and leads through ``position_in_base_m`` (3,).
    Several claims share the results.
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
    """Return the trace's results of ``reach_m`` that are known so far, by tick and position."""
    return {}


def _beyond_m(trace: Trace, joints_rad: NDArray[np.float64], displacement: NDArray[np.float64]) -> float:
    """Return how far [m] the arm can go beyond the end of ``displacement`` (3,), negative if it stops short.

    The arm begins at ``joints_rad`` (6,). The result is at most 0.1 mm too small, but never below zero if the
    arm can reach the end.
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
    rationale="the arm cannot retreat to a position out of reach, but stops on the way, near the hand",
    source="the paper, table 4",
    margin="how far beyond the chosen position the straight way remains reachable within the joint "
    "limits and away from singularities (the search ends at 100 mm). If the position is out of reach, "
    "minus the missing part of the way",
    parameters="the least singular value in the settings",
    exercised="the controller chose a position",
    broken_by="an avoider that proposes a position two metres away, behind a gate that passes everything",
)
PROPOSED_POSES = replace(
    REPULSIVE_POSES,
    prop=RepulsivePosesReachable(proposed=True),
    pattern=r"proposed (?:repulsive|retreat) poses reachable",
    margin="the same for the position that the avoider proposed, before the gate",
    exercised="the controller made a decision",
    broken_by="an avoider that proposes a position two metres away",
)
