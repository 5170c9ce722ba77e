"""From joints and hands at a tick to the signals, with bounds of what they can have been, as of a log.

What ``formulas.signals`` and ``formulas.measured`` compute of a whole trace, here of one tick, and of the way
from one to the next, for each tick and hand with the uncertainty that it has then.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import inf, isnan, nan
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from safety_harness.compiled import compiled
from safety_harness.formulas.formula import Comparison, Relation, Truth
from safety_harness.formulas.semantics import LEAST
from safety_harness.formulas.signal import MOVING, Signal
from safety_harness.formulas.signals import (
    elapsed_time,
    hand_distance,
    joint_speed,
    nearest_hand_to_tcp,
    tcp_height,
    tcp_speed,
)
from safety_harness.monitoring.cell import WatchedCell
from safety_harness.monitoring.tracks import BodyTrack
from safety_harness.properties.hand_distance import RESOLUTION_M
from safety_harness.robot.capsules import Arm, arm_with
from safety_harness.robot.closest_approach import MAX_BISECTIONS, closest_approach_between
from safety_harness.robot.distance import hand_distance as distance_between
from safety_harness.robot.distance import place_capsules
from safety_harness.robot.kinematics import forward_kinematics, tcp_velocity
from safety_harness.robot.robots import arm_capsules
from safety_harness.simulation.truth import cell_capsules

MEASURED = (hand_distance, nearest_hand_to_tcp, tcp_speed, tcp_height, joint_speed, elapsed_time)
Values = NDArray[np.float64]


class Known(NamedTuple):
    """A signal at a tick, and from it to the next one: the least and the largest that it can have been.

    ``value`` is what was measured, NaN for nothing; ``tried`` says whether it certainly exercises a claim.
    """

    value: float
    low: float
    high: float
    cell_low: float
    cell_high: float
    tried: bool = True


UNKNOWN = Known(nan, -inf, inf, -inf, inf, False)
Signals = Mapping[Signal, Known]


class ArmAt(NamedTuple):
    """The arm at a tick: joints (n,), TCP and its speed, and what they, and points of the arm, may be off."""

    joints_rad: Values
    rates_radps: Values
    tcp_m: Values  # (3,)
    tcp_mps: float
    joints_off_rad: float
    rates_off_radps: float
    off_m: float
    off_mps: float


class HandAt(NamedTuple):
    """A hand that is seen: hand and elbow (2, 3) [m] in base, what they may be off, and its distances."""

    bodies_m: Values
    hand_off_m: float
    off_m: float  # of hand and elbow
    distance_m: float
    to_tcp_m: float


@dataclass(eq=False)
class TickSeen:
    """A tick, what is known of it now, and the signals that follow."""

    tick: int
    elapsed_s: float
    joints_rad: Values
    rates_radps: Values
    arm: ArmAt | None = None
    hands: tuple[HandAt | None, ...] = ()
    signals: dict[Signal, Known] = field(default_factory=dict)


class HandTracks(NamedTuple):
    """Of a hand and its elbow: the same track where it has no forearm, None where nobody measures it."""

    hand: BodyTrack
    elbow: BodyTrack | None


class Sensing:
    """The signals of one cell."""

    def __init__(self, cell: WatchedCell, hands: Sequence[HandTracks]) -> None:
        self._settings, self._hands = cell.scenario.settings, hands
        self._period_ns, self._period_s = cell.period_ns, cell.period_s
        self._arm = arm_with(cell.arm, cell_capsules(arm_capsules(cell.scenario.robot), self._settings))
        self._reach_m = np.asarray(self._arm.reach_m)
        joints = np.arange(len(self._reach_m))
        self._farther_m = np.array([self._reach_m[np.maximum(joints, j)].sum() for j in joints])
        self._ends = np.empty((len(self._arm.capsules), 2, 3))
        self._room = np.empty((MAX_BISECTIONS + 1, len(self._arm.capsules), 2, 3))

    def see(self, moment: TickSeen, off: tuple[float, float] | None) -> None:
        """What is known at a tick, by now; joints and their speeds are ``off`` by so much, None: lost."""
        moment.arm, moment.hands = None, ()
        if off is not None:
            tcp_m, reach_m = np.empty(3), float(self._reach_m.sum())
            speed = _arm_at(self._arm, moment.joints_rad, moment.rates_radps, self._ends, tcp_m)
            off_mps = off[1] * reach_m + off[0] * float(np.abs(moment.rates_radps) @ self._farther_m)
            position, rates = moment.joints_rad, moment.rates_radps
            moment.arm = ArmAt(position, rates, tcp_m, speed, *off, off[0] * reach_m, off_mps)
            moment.hands = tuple(self._hand(tracks, moment.tick, tcp_m) for tracks in self._hands)
        self._at_tick(moment)

    def _hand(self, tracks: HandTracks, tick: int, tcp_m: Values) -> HandAt | None:
        hand = tracks.hand.at(tick)
        if hand is None:
            return None
        elbow = None if tracks.elbow is None else tracks.elbow.at(tick)
        to_tcp_m = float(np.linalg.norm(hand[0] - tcp_m))
        if elbow is None:
            return HandAt(np.array([hand[0], hand[0]]), hand[1], nan, nan, to_tcp_m)
        size = self._settings.hand
        distance_m, _ = distance_between(
            self._arm.capsules, self._ends, hand[0], elbow[0], size.radius_m, size.forearm_radius_m
        )
        off_m = max(hand[1], elbow[1])
        return HandAt(np.array([hand[0], elbow[0]]), hand[1], off_m, distance_m, to_tcp_m)

    def _at_tick(self, moment: TickSeen) -> None:
        """As if the run ended there: from the tick to the next is the tick."""
        found = moment.signals
        found.update(dict.fromkeys(MEASURED, UNKNOWN))
        elapsed_s = moment.elapsed_s
        found[elapsed_time] = Known(elapsed_s, elapsed_s, elapsed_s, elapsed_s, elapsed_s)
        arm = moment.arm
        if arm is None:
            return
        between_m = self._place_between_m(arm, arm)
        found[tcp_height] = _known(float(arm.tcp_m[2]), arm.off_m, between_m, True)
        fastest = float(np.abs(arm.rates_radps).max())
        by_mps, by_radps = self._speeds_between(arm, arm)
        found[tcp_speed] = _known(arm.tcp_mps, arm.off_mps, by_mps, arm.tcp_mps - MOVING > by_mps)
        found[joint_speed] = _known(fastest, arm.rates_off_radps, by_radps, fastest - MOVING > by_radps)
        near = [
            (hand.to_tcp_m, arm.off_m + hand.hand_off_m, between_m + 2.0 * hand.hand_off_m)
            for hand in moment.hands
            if hand is not None
        ]
        apart = [
            (hand.distance_m, hand.off_m + arm.off_m, self._moved_m(arm, hand))
            for hand in moment.hands
            if hand is not None and not isnan(hand.distance_m)
        ]
        for signal, seen in ((nearest_hand_to_tcp, near), (hand_distance, apart)):
            if seen:
                lost = len(seen) < len(moment.hands)
                value = min(own for own, _, _ in seen)
                low, cell_low = (
                    -inf if lost else min(own - bounds[at] for own, *bounds in seen) for at in (0, 1)
                )
                high = min(own + off for own, off, _ in seen)
                beyond = min(own + off + more for own, off, more in seen)
                tried = self._settings.avoidance.critical_distance_m - high > 0.0
                found[signal] = Known(value, low, high, cell_low, beyond, tried)

    def between(self, before: TickSeen, now: TickSeen) -> None:
        """From one tick to the next: what ``before`` has of that."""
        found, one, other = before.signals, before.arm, now.arm
        for signal in (*MEASURED,):
            known = found[signal]
            if signal is elapsed_time:
                low, high = known.low, now.elapsed_s
            elif one is None or other is None:
                low, high = -inf, inf
            else:
                continue
            found[signal] = known._replace(cell_low=low, cell_high=high)
        if one is None or other is None:
            return
        period_s = self._period_s
        moved_m = float(np.linalg.norm(other.tcp_m - one.tcp_m))
        way_m = max(max(one.tcp_mps, other.tcp_mps) * period_s, moved_m)
        between_m, (by_mps, by_radps) = self._place_between_m(one, other), self._speeds_between(one, other)
        steps = np.abs(other.joints_rad - one.joints_rad) / period_s
        sides = np.abs(np.array([one.rates_radps, other.rates_radps]))
        least, most = np.minimum(sides.min(axis=0), steps), np.maximum(sides.max(axis=0), steps)
        self._set(found, joint_speed, float(least.max()) - by_radps, float(most.max()) + by_radps)
        found[joint_speed] = _trying(found[joint_speed], float(steps.max()) - MOVING > by_radps)
        speeds, mean = (one.tcp_mps, other.tcp_mps), moved_m / period_s
        self._set(found, tcp_speed, min(*speeds, mean) - by_mps, max(*speeds, mean) + by_mps)
        found[tcp_speed] = _trying(found[tcp_speed], mean - MOVING > by_mps)
        low, high = _tent(float(one.tcp_m[2]), float(other.tcp_m[2]), way_m)
        self._set(found, tcp_height, low - between_m, high + between_m)
        ways = [
            self._hand_between(index, before, now, way_m, between_m) for index in range(len(before.hands))
        ]
        for at, signal in enumerate((hand_distance, nearest_hand_to_tcp) if ways else ()):
            low, high = min(way[at][0] for way in ways), min(way[at][1] for way in ways)
            self._set(found, signal, low, high)

    def _set(self, found: dict[Signal, Known], signal: Signal, low: float, high: float) -> None:
        """Bounds from a tick to the next; what is not known at the tick is not known after it either."""
        known = found[signal]
        if isnan(known.value):
            low, high = -inf, inf
        found[signal] = known._replace(cell_low=low, cell_high=high)

    def _hand_between(
        self, index: int, before: TickSeen, now: TickSeen, way_m: float, between_m: float
    ) -> tuple[tuple[float, float], tuple[float, float]]:
        """Of one hand: bounds of its distance from the arm, and of its centre's from the TCP."""
        one, other, arm, later = before.hands[index], now.hands[index], before.arm, now.arm
        nothing = -inf, inf
        if one is None or other is None or arm is None or later is None:
            return nothing, nothing
        shares, bodies = self._corners(index, before.tick, one, other)
        steps_m = np.linalg.norm(np.diff(bodies, axis=0), axis=2).sum(axis=0)
        low, high = _tent(one.to_tcp_m, other.to_tcp_m, way_m + float(steps_m[0]))
        off_m = between_m + 2.0 * max(one.hand_off_m, other.hand_off_m)
        to_tcp = low - off_m, high + off_m
        if isnan(one.distance_m) or isnan(other.distance_m):
            return nothing, to_tcp
        size, turned = self._settings.hand, later.joints_rad - arm.joints_rad
        joints = [arm.joints_rad, *(arm.joints_rad + share * turned for share in shares), later.joints_rad]
        bound = inf
        for k in range(len(bodies) - 1):
            least, _, _ = closest_approach_between(
                self._arm,
                self._room,
                joints[k],
                joints[k + 1],
                bodies[k, 0],
                bodies[k + 1, 0],
                bodies[k, 1],
                bodies[k + 1, 1],
                size.radius_m,
                size.forearm_radius_m,
                RESOLUTION_M,
                inf,
            )
            bound = min(bound, least)
        bend_m = float(np.abs(later.rates_radps - arm.rates_radps) @ self._reach_m) * self._period_s / 4.0
        _, far_m = _tent(
            one.distance_m, other.distance_m, float(np.abs(turned) @ self._reach_m) + float(steps_m.max())
        )
        moved = [(self._moved_m(a, h), h.off_m + a.off_m) for a, h in ((arm, one), (later, other))]
        low = min(one.distance_m, bound - bend_m) - max(below for below, _ in moved)
        return (low, far_m + bend_m + max(below + at for below, at in moved)), to_tcp

    def _corners(self, index: int, tick: int, one: HandAt, other: HandAt) -> tuple[list[float], Values]:
        """When samples of a hand came between two ticks, in parts of a period; (m, 2, 3) all its places."""
        hand, elbow = self._hands[index]
        begin_ns, end_ns = tick * self._period_ns, (tick + 1) * self._period_ns
        times = sorted({*hand.corners(begin_ns, end_ns), *(elbow or hand).corners(begin_ns, end_ns)})
        places = [np.array([hand.between(t), (elbow or hand).between(t)]) for t in times]
        shares = [(t - begin_ns) / self._period_ns for t in times]
        return shares, np.array([one.bodies_m, *places, other.bodies_m])

    def _moved_m(self, arm: ArmAt, hand: HandAt) -> float:
        """As ``distance_moved_m`` between the ticks."""
        bend_m = self._period_s / 2.0 * arm.rates_off_radps * float(self._reach_m.sum())
        return hand.off_m + arm.off_m + bend_m

    def _place_between_m(self, one: ArmAt, other: ArmAt) -> float:
        """As ``formulas.measured.of_place``."""
        at, speed = max(one.off_m, other.off_m), max(one.off_mps, other.off_mps)
        return at + 0.5 * max(speed * self._period_s, 2.0 * at)

    def _speeds_between(self, one: ArmAt, other: ArmAt) -> tuple[float, float]:
        """As ``formulas.measured.of_speed``, of TCP and joints."""
        place, turned = max(one.off_m, other.off_m), max(one.joints_off_rad, other.joints_off_rad)
        speed, rate = max(one.off_mps, other.off_mps), max(one.rates_off_radps, other.rates_off_radps)
        return max(speed, 2.0 * place / self._period_s), max(rate, 2.0 * turned / self._period_s)


def _known(value: float, off: float, between: float, tried: bool) -> Known:
    return Known(value, value - off, value + off, value - between, value + between, tried)


def _trying(known: Known, tried: bool) -> Known:
    return known._replace(tried=known.tried or tried)


def _tent(first: float, second: float, way: float) -> tuple[float, float]:
    """As ``formulas.signal.tent``."""
    low = min(0.5 * (first + second - way), min(first, second))
    return low, max(0.5 * (first + second + way), max(first, second))


@compiled
def _arm_at(
    arm: Arm,
    joints_rad: NDArray[np.float64],  # (n,)
    rates_radps: NDArray[np.float64],  # (n,)
    ends_m: NDArray[np.float64],  # (c, 2, 3), written: the capsules' ends in base
    tcp_m: NDArray[np.float64],  # (3,), written
) -> float:
    """The TCP's speed [m/s]."""
    n = joints_rad.shape[0]
    transforms = np.empty((n + 2, 4, 4))
    forward_kinematics(arm.chain[0], joints_rad, transforms)
    place_capsules(arm.capsules, transforms, ends_m)
    for i in range(3):
        tcp_m[i] = transforms[n + 1, i, 3]
    x, y, z = tcp_velocity(arm.chain[0].joint_axes, transforms, rates_radps)
    return float(np.sqrt(x * x + y * y + z * z))


def margin_at(atom: Comparison | Truth, signals: Signals, *, cell: bool) -> tuple[float, float]:
    """The least and largest margin of a comparison, at the tick or from it to the next."""
    assert isinstance(atom, Comparison)
    known = signals[atom.signal]
    low, high = (known.cell_low, known.cell_high) if cell else (known.low, known.high)
    limit, relation = atom.limit.value, atom.relation
    above = relation in (Relation.ABOVE, Relation.AT_LEAST)
    at_limit = -LEAST if relation in (Relation.ABOVE, Relation.BELOW) else LEAST
    least, most = (low - limit, high - limit) if above else (limit - high, limit - low)
    return least or at_limit, most or at_limit
