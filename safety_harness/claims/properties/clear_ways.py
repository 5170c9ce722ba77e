"""Check that a repulsion does not lead into the table, the object or the robot itself.

The module also computes the clearances along a sequence of joint positions.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import compiled
from safety_harness.base.elementary import product
from safety_harness.base.geometry.segments import segment_segment_distance
from safety_harness.cell.avoidance.own_body import body_and_wrist, wrist_distance
from safety_harness.cell.robot.capsules import Arm
from safety_harness.cell.robot.distance import place_capsules
from safety_harness.cell.robot.inverse import straight_way
from safety_harness.cell.robot.kinematics import forward_kinematics
from safety_harness.cell.robot.robots import arm_model
from safety_harness.cell.simulation.cameras import object_polygon_in_base
from safety_harness.claims.properties.base import Evaluation, Unit, inconclusive, is_somewhere, judged
from safety_harness.claims.properties.entry import CatalogueEntry
from safety_harness.claims.properties.giving_way import last_tick
from safety_harness.claims.properties.measured import reads, unexercised
from safety_harness.claims.signals.hand_distance import joint_bend_m
from safety_harness.claims.signals.occasions import no_position
from safety_harness.claims.signals.true_motion import PARTS, RESOLUTION_M, arm_of, capsules_of
from safety_harness.trace.records import DecisionOutcome
from safety_harness.trace.trace import Trace

Floats = NDArray[np.float64]
STEP_M = 0.0025  # between two samples of a planned way
OBSTACLES = ("table", "object", "robot itself")


@dataclass(frozen=True)
class Way:
    """The least clearance from each obstacle along one path.

    The fields are lower bounds (3,) [m], upper bounds (3,) [m], and times (3,) [s].
    """

    words: str
    least_m: NDArray[np.float64]
    most_m: NDArray[np.float64]
    time_s: NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class ClearWays:
    """The claim that repulsions stay clear of the table, the object and the robot itself.

    The margin is the least clearance of any link from these obstacles along every repulsion. The planned path
    leads straight from the arm's true position to the chosen position, as far as the arm can follow it. The
    executed path consists of the true joint positions from the decision to the end of the repulsion. Between
    two samples, ``least_along`` computes lower and upper bounds of the clearance.

    ``parts`` has an evaluation for each obstacle. Every repulsion exercises the claim.
    """

    unit: Unit = Unit.LENGTH
    sentence: str = "repulsive ways clear of table, object and robot"

    @reads(
        "joint_position_rad",
        "joint_velocity_radps",
        "transform_tcp_to_base",
        also=[
            "mode",
            "decision.tick",
            "decision.time_s",
            "decision.chosen_position_in_base_m",
            "decision.outcome",
        ],
    )
    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge the planned and the executed path of every repulsion."""
        repulsions: list[Way] = []
        reach_m = arm_of(trace).reach_m
        for number, decision in enumerate(trace.decisions):
            if decision["outcome"] == DecisionOutcome.STOP:
                continue
            if not is_somewhere(decision["chosen_position_in_base_m"]):
                return inconclusive(self, f"the position chosen at {decision['time_s']:.3f} s is not finite")
            repulsions += [planned(trace, number, reach_m), executed(trace, number, reach_m)]
        if not repulsions:
            return unexercised(self, no_position(trace))
        parts = tuple(self._part(trace, repulsions, obstacle) for obstacle in range(len(OBSTACLES)))
        unknown = next((part for part in parts if part.margin is None), None)
        worst = min(parts, key=lambda part: part.margin or 0.0) if unknown is None else unknown
        return replace(worst, sentence=self.sentence, parts=parts)

    def _part(self, trace: Trace, repulsions: list[Way], obstacle: int) -> Evaluation:
        least_m = np.array([repulsion.least_m[obstacle] for repulsion in repulsions])
        worst = repulsions[int(np.argmin(least_m))]  # the first NaN, if there is one
        margin, time_s, name = worst.least_m[obstacle], worst.time_s[obstacle], OBSTACLES[obstacle]
        most = min(float(repulsion.most_m[obstacle]) for repulsion in repulsions)
        evaluation = judged(
            self, trace, margin, time_s, f"{name}: {worst.words}", len(repulsions) // 2, most=most
        )
        return replace(evaluation, sentence=f"repulsive ways clear of the {name}")


def planned(trace: Trace, number: int, reach_m: NDArray[np.float64]) -> Way:
    """Return the planned path to the position that decision ``number`` chose.

    ``reach_m`` has the shape (joints,).
    """
    decision = trace.decisions[number]
    arm = arm_model(trace.scenario.robot)
    start_rad = trace.ticks["joint_position_rad"][decision["tick"]]
    joints_rad = straight_way(arm, start_rad, decision["chosen_position_in_base_m"], step_m=STEP_M)
    least_m, most_m, _ = least_along(lambda q: clearances_m(trace, q), joints_rad, reach_m)
    return Way(f"planned way of decision {number}", least_m, most_m, np.full(3, decision["time_s"]))


def executed(trace: Trace, number: int, reach_m: NDArray[np.float64]) -> Way:
    """Return the path that the arm executed from decision ``number`` to the end of its repulsion.

    ``reach_m`` has the shape (joints,).
    """
    first = int(trace.decisions[number]["tick"])
    window = slice(first, last_tick(trace, number) + 1)
    joints_rad = trace.ticks["joint_position_rad"][window]
    slack_m = joint_bend_m(trace)[first : first + len(joints_rad) - 1]
    least_m, most_m, at = least_along(lambda q: clearances_m(trace, q), joints_rad, reach_m, slack_m)
    return Way(f"executed way of decision {number}", least_m, most_m, trace.time_s[first + at])


def least_along(
    clearance_m: Callable[[Floats], Floats],
    joints_rad: Floats,  # (n, joints)
    reach_m: Floats,  # (joints,)
    slack_m: Floats | float = 0.0,
    limit_m: float = 0.0,
) -> tuple[Floats, Floats, NDArray[np.int64]]:
    """Return bounds of the least clearance while the joints move linearly from sample to sample.

    The results are the lower bound (c,), the upper bound (c,), and the index (c,) of the last sample before
    the least clearance. ``clearance_m`` returns clearances (n, c) at joints (n, joints). Between two samples,
    no point moves farther than a bound: the sum over the joints of each joint's angle times the length of the
    chain of links that it moves. The true motion differs from the linear motion by at most ``slack_m``
    (n - 1,). Steps that may decide whether the clearance is below ``limit_m`` are divided into PARTS if
    ``limit_m`` lies between the bounds.
    """
    at_samples = clearance_m(joints_rad)
    moved_m = product(np.abs(np.diff(joints_rad, axis=0)), reach_m)
    slack_m = np.broadcast_to(slack_m, moved_m.shape)
    bound, high = at_samples.copy(), at_samples.min(axis=0)
    # From either sample, a clearance falls by at most the way between them. Where both bounds are equal, each
    # is half of the two clearances less the way.
    least_between = 0.5 * (at_samples[:-1] + at_samples[1:] - moved_m[:, None]) - slack_m[:, None]
    unsure = ((least_between < limit_m) & (high >= limit_m)).any(axis=1)
    # Divide only the steps that can decide, because each costs PARTS more samples.
    for k in np.flatnonzero(unsure & (slack_m < np.inf) & (moved_m > 2.0 * RESOLUTION_M)):
        share = np.linspace(0.0, 1.0, PARTS + 1)[:, None]
        finer = clearance_m(joints_rad[k] + share * (joints_rad[k + 1] - joints_rad[k]))
        least_between[k] = (0.5 * (finer[:-1] + finer[1:] - moved_m[k] / PARTS)).min(axis=0) - slack_m[k]
        high = np.minimum(high, finer.min(axis=0) + slack_m[k])
    bound[:-1] = np.minimum(bound[:-1], least_between)
    at = bound.argmin(axis=0)
    return np.take_along_axis(bound, at[None], axis=0)[0], high, at


CLEAR_WAYS = CatalogueEntry(
    prop=ClearWays(),
    rationale=(
        "if an arm that retreats from a hand runs into the table, the workpiece or itself, it "
        "stops there and crushes anything in between"
    ),
    source="the project's own; capsules as for the hand distance",
    margin=(
        "the least clearance between any link and any obstacle, along the planned and the "
        "executed path. Between samples, it is a lower bound"
    ),
    parameters="the table's height and the object in the settings",
    exercised="the controller chose a position",
    inconclusive="a chosen position that is not finite",
    broken_by=(
        "an avoider that proposes a position below the table, behind a gate that accepts every proposal"
    ),
)


def clearances_m(trace: Trace, joints_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the clearances [m] from table, object and robot itself, shape (n, 3).

    The joints are ``joints_rad`` (n, joints). Capsules enclose the links and the camera, so that no clearance
    exceeds the true clearance. A clearance is negative in penetration. The clearance from a flat object is
    never less than minus the capsule's radius. The table is an infinite plane. Only forearm, wrist and camera
    have clearances from the table and the object. Base, shoulder and upper arm are left out, because the base
    stands on the table and the upper arm ends where the forearm begins. The clearance from the robot itself
    is the distance of wrist and camera from base, shoulder and upper arm.
    """
    settings, joints_rad = trace.scenario.settings, np.ascontiguousarray(joints_rad)
    table_m, polygon = settings.cell.table_height_m, object_polygon_in_base(settings)
    body, wrist = body_and_wrist(arm_model(trace.scenario.robot), capsules_of(trace))
    return _clearances(arm_of(trace), body, wrist, joints_rad, table_m, polygon)


@compiled
def _clearances(
    arm: Arm,
    body: int,
    wrist: int,
    joints_rad: NDArray[np.float64],  # (n, joints)
    table_m: float,
    polygon: NDArray[np.float64],  # (m, 3)
) -> NDArray[np.float64]:
    """Return the three clearances [m] at each sample of ``joints_rad``, shape (n, 3).

    They are the clearances from the table plane, from the polygon and from the robot itself. A capsule with
    the axis c and the radius r has the clearances c_z - r - table and |c, polygon| - r. The first two results
    are the least of these over all capsules. The third result is ``wrist_distance``.
    """
    clearances = np.full((joints_rad.shape[0], 3), np.inf)
    frames = arm.chain[0].joint_axes.shape[0] + 2
    transforms, ends = np.empty((frames, 4, 4)), np.empty((arm.capsules.shape[0], 2, 3))
    for k in range(joints_rad.shape[0]):
        forward_kinematics(arm.chain[0], joints_rad[k], transforms)
        place_capsules(arm.capsules, transforms, ends)
        if np.isnan(joints_rad[k].sum()):
            clearances[k] = np.nan
            continue
        for capsule in range(arm.capsules.shape[0] - 1, -1, -1):  # the hand end first: usually the nearest
            if arm.capsules[capsule].link_index <= body:
                continue
            start, end, radius = ends[capsule, 0], ends[capsule, 1], arm.capsules[capsule].radius_m
            clearances[k, 0] = min(clearances[k, 0], min(start[2], end[2]) - radius - table_m)
            if min(start[2], end[2]) - polygon[0, 2] - radius < clearances[k, 1]:  # it may be nearer
                clearances[k, 1] = min(clearances[k, 1], above_polygon(start, end, polygon) - radius)
        clearances[k, 2] = wrist_distance(arm.capsules, body, wrist, ends)
    return clearances


@compiled
def above_polygon(
    start: NDArray[np.float64],  # (3,)
    end: NDArray[np.float64],  # (3,), may be the start
    polygon: NDArray[np.float64],  # (m, 3) corners, one after another, all at one height
) -> float:
    """Return the distance [m] between a segment and a level ``polygon``.

    The distance is 0 if the segment passes through the polygon.
    """
    height = polygon[0, 2]
    first, last = start[2] - height, end[2] - height
    least = np.inf
    for k in range(polygon.shape[0]):
        # The nearest points are on an edge, at an end of the segment above the polygon, or where the segment
        # passes through it.
        following = polygon[(k + 1) % polygon.shape[0]]
        least = min(least, segment_segment_distance(start, end, polygon[k], following))
    if _is_above(start[0], start[1], polygon):
        least = min(least, abs(first))
    if _is_above(end[0], end[1], polygon):
        least = min(least, abs(last))
    if first * last < 0.0:
        share = first / (first - last)
        if _is_above(start[0] + share * (end[0] - start[0]), start[1] + share * (end[1] - start[1]), polygon):
            least = 0.0
    return float(least)


@compiled
def _is_above(x: float, y: float, polygon: NDArray[np.float64]) -> bool:
    """Return whether a point, seen from above, is inside ``polygon`` (m, 3) by the even-odd rule."""
    odd = False
    n = polygon.shape[0]
    for k in range(n):
        a, b = polygon[k], polygon[(k + 1) % n]
        if (a[1] > y) != (b[1] > y) and x < a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0]):
            odd = not odd
    return odd
