"""Show that no arm could have kept a distance from the hands.

The proof is in docs/explanation/whose-fault.md. A *free arm* is an imaginary arm that knows the whole run
beforehand and obeys only one limit of the system. The TCP of a free arm starts where the run starts, and
never exceeds the controller's speed limit. If the system does not enforce this speed limit, the TCP's speed
follows from the speed limits of the joints. If no free arm keeps a claim, the claim stays violated after
every change of the system. Each of the three bounds is a necessary condition for keeping the claim. Therefore
a violation that meets all three conditions may still be unavoidable.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from safety_harness.admission.admit import Checked
from safety_harness.base.compiled import compiled
from safety_harness.base.elementary import cos, exp, length, product
from safety_harness.base.geometry.arrays import Array3, ArrayNx3
from safety_harness.base.settings import Hand
from safety_harness.cell.robot.capsules import CapsuleSet
from safety_harness.cell.robot.distance import chain_lengths, hand_distance
from safety_harness.cell.robot.kinematics import links_in_base
from safety_harness.cell.robot.robots import arm_capsules, drive_model
from safety_harness.cell.simulation.hand_motion import HandRecords, MoveRecords, advance_hands
from safety_harness.cell.simulation.hand_programs import hands_at_start
from safety_harness.cell.simulation.truth import cell_capsules
from safety_harness.claims.properties.base import Property
from safety_harness.claims.properties.hand_distance import HandDistance
from safety_harness.extensions.attribution.ingredients import fastest_tcp_mps
from safety_harness.scenario.faults import JointStuck
from safety_harness.scenario.model import HandTrajectory, MovingHand, Scenario
from safety_harness.scenario.moves import FollowTcp, ReachForTcp

SeeksTcp = ReachForTcp | FollowTcp
STEPS = 200  # of the path of a hand that brakes
LEAST = 1.05  # times the TCP's speed: a slower hand is not followed any longer
NOWHERE = np.zeros(3)  # a TCP for hands that do not depend on it


def why_unavoidable(checked: Checked, prop: Property) -> str:
    """Return the reason why no free arm could have kept ``prop`` in this scenario.

    The text is empty if no bound shows this.

    Args:
        checked: The admitted scenario with its arm.
        prop: The property of the claim. The bounds apply only to ``HandDistance``.

    """
    if not isinstance(prop, HandDistance) or not checked.scenario.hands:
        return ""
    free, radii = FreeArm.from_checked(checked), checked.scenario.settings.hand
    near_m = prop.minimum_m + radii.radius_m
    for number, hand in enumerate(checked.scenario.hands):
        path = HandPath.from_scenario(checked.scenario, number)
        why = (
            _at_what_cannot_move(free, path, prop.minimum_m, radii)
            or _before_it_can_leave(free, path, near_m)
            or _pursued(free, path, near_m, checked.scenario, hand)
        )
        if why:
            return f"{hand.name} {why}"
    return ""


@dataclass(frozen=True, eq=False)
class FreeArm:
    """The properties that all free arms of a scenario share, in the base frame.

    ``start_m`` (3,) is the TCP at the start. The distance of the TCP from the point ``centre_m`` (3,) never
    exceeds ``reach_m``. A ball with the radius ``tip_m`` and the TCP as its centre lies inside the arm.
    ``fastest_mps`` limits the speed of the TCP. ``body`` holds the capsules that no joint moves. The end
    points of their axes are ``ends_m`` (n, 2, 3).
    """

    start_m: Array3
    centre_m: Array3
    reach_m: float
    tip_m: float
    fastest_mps: float
    body: CapsuleSet
    ends_m: NDArray[np.float64]

    @classmethod
    def from_checked(cls, checked: Checked) -> FreeArm:
        """Return the free arm of an admitted scenario at the start of its run."""
        transforms = links_in_base(checked.arm, checked.joint_position_rad)
        places = transforms[:, :3, 3]
        settings = checked.scenario.settings
        capsules = cell_capsules(arm_capsules(checked.scenario.robot), settings)
        tcp, tip_m = places[-1], 0.0
        for k, link in enumerate(capsules.link_index):
            if link >= len(places) - 2:  # rigidly at the TCP
                start, end = (
                    product(transforms[link, :3, :3], ends[k]) + places[link]
                    for ends in (capsules.start_in_link, capsules.end_in_link)
                )
                tip_m = max(tip_m, float(capsules.radius_m[k]) - _off_segment_m(tcp, start, end))
        body, ends_m = _immovable(capsules, transforms, checked.arm.joint_axes[0])
        return cls(
            start_m=tcp.copy(),
            centre_m=places[1].copy(),
            reach_m=float(np.linalg.norm(np.diff(places[1:], axis=0), axis=1).sum()),
            tip_m=tip_m,
            fastest_mps=_fastest_mps(checked, capsules),
            body=body,
            ends_m=ends_m,
        )

    def farthest_m(self, from_m: ArrayNx3, time_s: NDArray[np.float64]) -> NDArray[np.float64]:  # (n,)
        """Return the greatest possible distance (n,) of the TCP from each point at the point's time.

        Args:
            from_m: The points, in the base frame.
            time_s: Their times since the start of the run.

        """
        run_m = np.linalg.norm(from_m - self.start_m, axis=1) + self.fastest_mps * time_s
        reached_m = np.linalg.norm(from_m - self.centre_m, axis=1) + self.reach_m
        return np.asarray(np.minimum(run_m, reached_m))


def _fastest_mps(checked: Checked, capsules: CapsuleSet) -> float:
    """Return an upper limit of the TCP's speed [m/s].

    It is the servo's limit if the drives follow the servo. Otherwise it is the sum of q'_j l_j, where q'_j is
    the speed limit of joint j and l_j is the length of the links behind this joint. A user's controller may
    command any joint speed. Lagging drives or a stuck joint may deviate from the servo's command.
    """
    scenario = checked.scenario
    stuck = any(isinstance(fault, JointStuck) for fault in scenario.faults)
    if not (scenario.driven or stuck or drive_model(scenario.robot)):
        return fastest_tcp_mps(scenario.settings)
    lengths_m = chain_lengths(checked.arm.chain, capsules.records)
    return float((checked.arm.velocity_limit_radps * lengths_m).sum())


def _off_segment_m(point: Array3, start: Array3, end: Array3) -> float:
    """Return the distance of a point from the segment between ``start`` and ``end``."""
    along_segment = end - start
    squared = float(product(along_segment, along_segment))
    part = (
        min(max(float(product(point - start, along_segment)) / squared, 0.0), 1.0) if squared > 0.0 else 0.0
    )
    return length(point - start - part * along_segment)


def _immovable(
    capsules: CapsuleSet,
    transforms: NDArray[np.float64],  # (n + 2, 4, 4)
    axis_in_link: Array3,
) -> tuple[CapsuleSet, NDArray[np.float64]]:
    """Return the capsules that no joint moves, and their axes' end points (n, 2, 3) in the base frame.

    These are the capsules of the base and, within the first link, balls about points on the first joint's
    axis. A ball whose centre has the distance r from the axis always contains a smaller ball. The centre of
    the smaller ball is the nearest point of the axis, and its radius is the radius of the first ball minus r.
    """
    parts: list[tuple[int, Array3, Array3, float]] = []
    axis = product(transforms[1, :3, :3], axis_in_link)
    for k, link in enumerate(capsules.link_index):
        start, end = capsules.start_in_link[k], capsules.end_in_link[k]
        if link == 0:
            parts.append((k, start, end, float(capsules.radius_m[k])))
        for inner in (start, end) if link == 1 else ():
            aside = product(transforms[1, :3, :3], inner)
            foot = product(aside, axis) * axis
            radius_m = float(capsules.radius_m[k] - length(aside - foot))
            if radius_m > 0.0:
                place = transforms[1, :3, 3] + foot
                parts.append((k, place, place, radius_m))
    rows, starts, ends, radii = zip(*parts, strict=True)
    body = CapsuleSet(
        names=tuple(capsules.names[k] for k in rows),
        link_index=np.zeros(len(rows), np.int64),
        start_in_link=np.array(starts),
        end_in_link=np.array(ends),
        radius_m=np.array(radii),
    )
    return body, np.stack([body.start_in_link, body.end_in_link], axis=1)


@dataclass(frozen=True, eq=False)
class HandPath:
    """The first part of a hand's path, which does not depend on the arm.

    ``time_s`` (n,), ``hand_m`` and ``elbow_m`` (n, 3) are in the base frame. ``then`` is the first move in
    which the hand heads for the TCP, or None if there is no such move. This move begins at most one control
    period before the end of the path. ``at_rest`` states whether the hand rests at the end of the path.
    ``steady_m`` (3,) is the hand's position at this time, without tremor.
    """

    time_s: NDArray[np.float64]
    hand_m: NDArray[np.float64]
    elbow_m: NDArray[np.float64]
    then: SeeksTcp | None
    at_rest: bool
    steady_m: Array3

    @classmethod
    def from_scenario(cls, scenario: Scenario, number: int) -> HandPath:
        """Return the path of hand ``number`` in ``scenario``.

        The path ends before the first move towards the TCP. This may be a move of the hand or of the hand's
        leader.
        """
        leader, settled = scenario.leader(scenario.hands[number]), scenario
        moves = leader.moves if isinstance(leader, MovingHand) else ()
        seeks = next((k for k, move in enumerate(moves) if isinstance(move, SeeksTcp)), None)
        if isinstance(leader, MovingHand) and seeks is not None:
            settled_leader = replace(leader, moves=moves[:seeks])
            settled = replace(
                scenario, hands=tuple(settled_leader if hand is leader else hand for hand in scenario.hands)
            )
        hands, count = hands_at_start(settled), scenario.ticks + 1
        who = scenario.hands.index(leader) if leader is not None else number
        own = hands.state[who]
        period_s = scenario.settings.clock.control_period_s
        ways_m = np.empty((count, 2, 3))
        ends = who if seeks is not None else -1
        ticks: int = _follow(hands.state, hands.moves, hands.samples, number, ends, period_s, ways_m)
        reached = seeks is not None and own["current"] >= own["count"]
        move = moves[seeks] if seeks is not None and reached else None
        return cls(
            time_s=np.arange(ticks, dtype=np.float64) * period_s,
            hand_m=ways_m[:ticks, 0].copy(),
            elbow_m=ways_m[:ticks, 1].copy(),
            then=move if isinstance(move, SeeksTcp) and leader is scenario.hands[number] else None,
            at_rest=not own["velocity_in_base_mps"].any(),
            steady_m=own["steady_in_base_m"].copy(),
        )


@compiled
def _follow(
    hands: HandRecords,
    moves: MoveRecords,
    samples: NDArray[np.float64],  # (s, 7)
    number: int,
    ends: int,
    period_s: float,
    ways_m: NDArray[np.float64],  # (n, 2, 3), written
) -> int:
    """Write hand ``number`` and its elbow at each tick to ``ways_m``, and return the number of ticks.

    The path ends when the moves of hand ``ends`` are over. If ``ends`` is -1, the path ends with the run.
    """
    for tick in range(ways_m.shape[0]):
        for i in range(3):
            ways_m[tick, 0, i] = hands[number].position_in_base_m[i]
            ways_m[tick, 1, i] = hands[number].elbow_in_base_m[i]
        if ends >= 0 and hands[ends].current >= hands[ends].count:
            return tick + 1
        advance_hands(hands, moves, samples, NOWHERE, tick * period_s, period_s)
    return len(ways_m)


def _at_what_cannot_move(free: FreeArm, path: HandPath, minimum_m: float, radii: Hand) -> str:
    """Describe the first time at which the hand is too near to a part that no joint moves.

    The text is empty if there is no such time.
    """
    sizes_m = radii.radius_m, radii.forearm_radius_m
    thick_m = max(sizes_m) + float(free.body.radius_m.max())
    thick_m += float(np.linalg.norm(free.ends_m - free.centre_m, axis=2).max())
    # A ball about hand and forearm shows cheaply at which ticks the exact distance is necessary.
    middle_m = (path.hand_m + path.elbow_m) / 2.0
    half_m = np.linalg.norm(path.hand_m - path.elbow_m, axis=1) / 2.0
    close = np.linalg.norm(middle_m - free.centre_m, axis=1) - half_m - thick_m < minimum_m
    for time_s, hand, elbow in zip(path.time_s[close], path.hand_m[close], path.elbow_m[close], strict=True):
        distance_m, index = hand_distance(free.body.records, free.ends_m, hand, elbow, *sizes_m)
        if distance_m < minimum_m:
            part = free.body.names[index].replace("_", " ")
            return f"is {distance_m * 1e3:.0f} mm from {part} at {time_s:.2f} s, which no joint moves"
    return ""


def _before_it_can_leave(free: FreeArm, path: HandPath, near_m: float) -> str:
    """Describe the first time at which every point that the TCP can reach is too near the hand.

    The text is empty if there is no such time. ``near_m`` is the least allowed distance from the hand's
    centre.
    """
    farthest_m = free.farthest_m(path.hand_m, path.time_s)
    late = np.flatnonzero(farthest_m < near_m + free.tip_m)
    if not len(late):
        return ""
    k = int(late[0])
    return f"is at most {farthest_m[k] * 1e3:.0f} mm from wherever the TCP can be at {path.time_s[k]:.2f} s"


def _pursued(free: FreeArm, path: HandPath, near_m: float, scenario: Scenario, hand: HandTrajectory) -> str:
    """Describe how a hand that is faster than the TCP catches the TCP.

    The text is empty if no bound shows this.
    """
    move = path.then
    if move is None or not path.at_rest or not isinstance(hand, MovingHand):
        return ""
    if isinstance(move, ReachForTcp) and move.hesitation is not None:
        return ""
    chase = Chase(
        speed_mps=move.speed_mps,
        acceleration_mps2=hand.max_acceleration_mps2,
        until_m=move.until_distance_m if isinstance(move, ReachForTcp) else move.distance_m,
        fleeing_mps=free.fastest_mps,
        period_s=scenario.settings.clock.control_period_s,
    )
    begins_s = float(path.time_s[-1])
    nearest_m = length(path.steady_m - free.start_m) - free.fastest_mps * begins_s
    farthest_m = float(free.farthest_m(path.steady_m[None], path.time_s[-1:])[0])
    caught = chase.caught(nearest_m, farthest_m)
    if caught is None:
        return ""
    heading_s, after_s, distance_m = caught
    tremor_m = hand.tremor.amplitude_m if hand.tremor is not None else 0.0
    patience_s = move.at_most_s if isinstance(move, ReachForTcp) else move.duration_s
    in_time = heading_s <= patience_s - chase.period_s
    in_time &= begins_s + heading_s + after_s <= scenario.ticks * chase.period_s
    if not in_time or not distance_m + tremor_m < near_m + free.tip_m:
        return ""
    return (
        f"heads for the TCP at {chase.speed_mps:.2g} m/s, which leaves at {free.fastest_mps:.2g} m/s at "
        f"most, and is within {distance_m * 1e3:.0f} mm of it {heading_s + after_s:.2f} s later at the latest"
    )


@dataclass(frozen=True)
class Chase:
    """A hand that starts from rest and heads for a TCP, with the motion that ``pursue`` computes.

    ``speed_mps`` and ``acceleration_mps2`` limit the hand, and ``fleeing_mps`` limits the TCP's speed. The
    hand stops at the distance ``until_m`` from the TCP.
    """

    speed_mps: float
    acceleration_mps2: float
    until_m: float
    fleeing_mps: float
    period_s: float

    def caught(self, nearest_m: float, farthest_m: float) -> tuple[float, float, float] | None:
        """Return three upper bounds for the pursuit.

        The first bound is for the time [s] during which the hand heads for the TCP. The second bound is for
        the further time [s], and the third is for the distance [m] after that time.

        Args:
            nearest_m: The least possible distance [m] between hand and TCP when the hand begins to head for
                the TCP.
            farthest_m: The greatest possible distance [m] between hand and TCP at that time.

        Returns:
            The three bounds, or None if there is no bound.

        """
        s, a, v, dt = self.speed_mps, self.acceleration_mps2, self.fleeing_mps, self.period_s
        # D_b of docs/explanation/whose-fault.md, increased by the motion of the hand and the TCP in a tick.
        ending_m = self.until_m + s * s / (2.0 * a) + s * dt + (s + v) * dt
        # The hand heads for the TCP's place at the last tick, so its direction is off by at most this angle.
        aside_rad = 2.0 * v * dt / ending_m
        closing_mps = s * cos(aside_rad) - v
        if closing_mps <= 0.0 or a <= 2.0 * s * v / ending_m:
            return None
        turned_s = self._turned_s(nearest_m, ending_m)
        if turned_s is None:
            return None
        heading_s = turned_s + max(farthest_m + v * turned_s - ending_m, 0.0) / closing_mps + dt
        # First bound: after D_b, the hand leaves the straight path by at most a q^2 / 2.  Any time q is
        # valid.
        flying_s = np.linspace(0.0, s / a, 101)
        left_m = (
            np.abs(ending_m - s * flying_s) + (v + s * aside_rad) * flying_s + a * flying_s * flying_s / 2.0
        )
        best = int(np.argmin(left_m))
        flown = heading_s, float(flying_s[best]), float(left_m[best]) + (s + v) * dt
        braking_s, braked_m = self._braked(ending_m)
        return flown if flown[2] <= braked_m else (heading_s + braking_s, 0.0, braked_m)

    def _braked(self, ending_m: float) -> tuple[float, float]:
        """Return upper bounds for the hand's braking in front of the TCP.

        The two bounds are for the time [s] and the distance [m].
        """
        a, v, dt = self.acceleration_mps2, self.fleeing_mps, self.period_s
        distance_m, took_s, turned, near_m = ending_m, 0.0, 0.0, ending_m
        # Second bound: in small steps of the distance, until one of the two conditions for closing in fails.
        step_m = (ending_m - self.until_m) / STEPS
        while distance_m - step_m > self.until_m:
            distance_m -= step_m
            gap_m = distance_m - self.until_m
            wanted_mps = min(self.speed_mps, sqrt(a * dt * a * dt + 2.0 * a * gap_m) - a * dt)
            if wanted_mps <= LEAST * v:
                break
            step_s = step_m / (wanted_mps - v)
            turned += (step_m + v * step_s) / distance_m
            lateral_mps = v * (exp(turned) - 1.0)
            if lateral_mps * (v + lateral_mps) / distance_m >= a * (1.0 - v / wanted_mps):
                break
            took_s += step_s
            near_m = min(near_m, distance_m + 2.0 * (wanted_mps + v) * dt)
        return took_s, near_m

    def _turned_s(self, nearest_m: float, ending_m: float) -> float | None:
        """Return the longest time [s] until the hand moves at full speed towards the TCP.

        The result is None if there is no bound. The time is the least fixed point of the inequalities in
        docs/explanation/whose-fault.md. The bound is valid while the TCP is at least ``ending_m`` away.
        """
        s, a, v = self.speed_mps, self.acceleration_mps2, self.fleeing_mps
        lateral_mps, least_m = 0.0, nearest_m
        # Iterate from the smallest lateral speed upwards, so that the first fixed point is the least one.
        for _ in range(100):
            if least_m < ending_m:
                return None
            rate_mps2 = a - s * (v + lateral_mps) / least_m
            # A slower turn gives no useful bound; a choice.
            if rate_mps2 <= 0.1 * a:
                return None
            turned_s = s / rate_mps2 + self.period_s
            way_m = s * s / (2.0 * a) + s * (turned_s - s / a)
            previous = lateral_mps, least_m
            least_m = nearest_m - way_m - v * turned_s
            if least_m < ending_m:
                return None
            lateral_mps = v * (exp(way_m / least_m) - 1.0)
            if abs(lateral_mps - previous[0]) < 1e-9 and abs(least_m - previous[1]) < 1e-9:
                never_back = (
                    a * s / sqrt(s * s + lateral_mps * lateral_mps)
                    > lateral_mps * (v + lateral_mps) / least_m
                )
                return turned_s if never_back else None
        return None
