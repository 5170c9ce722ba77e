"""From samples of a cell to its signals, tick by tick, with bounds of what they can have been.

A signal at a tick, and from there to the next tick, is what ``formulas.signals`` computes of a trace in which
hands move straight from tick to tick.  Here each sample has its age: a hand that moves at v at most is
within v x age of where it was seen, and within v dt/2 more of its chord between two ticks; a joint likewise, at
its limit of speed.  So everything is an interval, [-inf, inf] where a hand or the arm is lost.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
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
    predicted_hand_distance,
    tcp_height,
    tcp_speed,
)
from safety_harness.monitoring.sample import GIVEN
from safety_harness.properties.hand_distance import RESOLUTION_M
from safety_harness.robot.capsules import Arm, arm_with
from safety_harness.robot.closest_approach import MAX_BISECTIONS, closest_approach_between
from safety_harness.robot.distance import hand_distance as distance_between
from safety_harness.robot.distance import place_capsules
from safety_harness.robot.kinematics import forward_kinematics, tcp_velocity
from safety_harness.robot.robots import arm_capsules, arm_model
from safety_harness.scenario.model import REACHING_MPS, Scenario
from safety_harness.simulation.truth import cell_capsules

MEASURED = (hand_distance, nearest_hand_to_tcp, tcp_speed, tcp_height, joint_speed, elapsed_time)
Values = NDArray[np.float64]


class Known(NamedTuple):
    """A signal at a tick, and from it to the next one: the least and the largest that it can have been.

    ``value`` is what was measured, NaN for nothing; ``tried`` says whether it certainly puts a claim to the test.
    """

    value: float
    low: float
    high: float
    cell_low: float
    cell_high: float
    tried: bool = True

    @property
    def certain(self) -> bool:
        """Is it known, and exactly?"""
        return self.low == self.high


UNKNOWN = Known(nan, -inf, inf, -inf, inf, False)
Signals = Mapping[Signal, Known]


class HandAt(NamedTuple):
    """A hand at a tick: hand and elbow (2, 3) [m] in base, how old that is, and whether there is an elbow."""

    bodies: Values
    age_s: float
    with_elbow: bool = True


@dataclass(frozen=True, eq=False, kw_only=True)
class CellAt:
    """What is known of a cell at a tick: joints (n,) with the age of their sample, hands by name.

    A hand that is None is lost, or "absent".  Without ``rates_radps`` nothing is known of speeds.
    """

    elapsed_s: float
    joints_rad: Values | None = None
    rates_radps: Values | None = None
    age_s: float = 0.0
    hands: Mapping[str, HandAt | str | None]
    given: Mapping[str, float]


@dataclass(frozen=True, kw_only=True)
class Bodies:
    """How well hands are known: to within ``known_to_m`` when they are seen; how fast they are at most.

    ``straight``: they, and the joints, move straight from sample to sample, as in a simulated run.
    """

    known_to_m: float = 0.0
    at_most_mps: float = REACHING_MPS
    straight: bool = False


class _HandThere(NamedTuple):
    """A hand that is seen: its distance and its centre's from the TCP, how far it may be off, and below that."""

    at: HandAt
    distance_m: float
    to_tcp_m: float
    off_m: float
    below_m: float  # of the distance alone, for want of an elbow


class _Pose(NamedTuple):
    """A cell at a tick, with what follows from its joints.

    Of each hand _HandThere, None if it is lost, or "absent".
    """

    cell: CellAt
    joints_rad: Values
    tcp_m: Values  # (3,)
    tcp_mps: float
    off_m: float  # of any point of the arm
    hands: dict[str, _HandThere | str | None]


class Sensing:
    """The signals of one cell.  ``scenario`` says arm, sizes of hands, critical distance and control period."""

    def __init__(self, scenario: Scenario, bodies: Bodies) -> None:
        self._settings, self._bodies = scenario.settings, bodies
        self.period_s = scenario.settings.clock.control_period_s
        model = arm_model(scenario.robot)
        self.joints = len(model.joint_names)
        self._arm = arm_with(model, cell_capsules(arm_capsules(scenario.robot), scenario.settings))
        self._fastest_mps = float(self._arm.reach_m @ model.velocity_limit_radps)  # any point of the arm
        self._ends = np.empty((len(self._arm.capsules), 2, 3))
        self._room = np.empty((MAX_BISECTIONS + 1, len(self._arm.capsules), 2, 3))
        self._before: _Pose | None = None
        self._signals: Signals = {}

    def step(self, cell: CellAt) -> tuple[Signals, Signals]:
        """The signals at the next tick, and of the tick before what is known now; empty before the first."""
        before, pose = self._before, self._pose(cell)
        now = self._at_tick(cell, pose)
        cells = self._between(before, pose) if before is not None and pose is not None else {}
        revised = {
            signal: known._replace(cell_low=low, cell_high=high, tried=known.tried or tried)
            for signal, known in self._signals.items()
            for low, high, tried in (cells.get(signal, self._otherwise(signal, known, now[signal])),)
        }
        self._before, self._signals = pose, now
        return now, revised

    def _otherwise(self, signal: Signal, known: Known, later: Known) -> tuple[float, float, bool]:
        """What is held from tick to tick, and nothing of the others."""
        if signal is elapsed_time:
            return known.low, later.high, False
        held = signal in _HELD
        return (known.low, known.high, False) if held else (-inf, inf, False)

    def _pose(self, cell: CellAt) -> _Pose | None:
        if cell.joints_rad is None:
            return None
        hand, tcp_m = self._settings.hand, np.empty(3)
        rates = cell.rates_radps if cell.rates_radps is not None else np.zeros(self.joints)
        speed = _arm_at(self._arm, cell.joints_rad, rates, self._ends, tcp_m)
        hands: dict[str, _HandThere | str | None] = {}
        for name, at in cell.hands.items():
            if not isinstance(at, HandAt):
                hands[name] = at
                continue
            distance_m, _ = distance_between(
                self._arm.capsules, self._ends, *at.bodies, hand.radius_m, hand.forearm_radius_m
            )
            off_m = self._bodies.known_to_m + self._bodies.at_most_mps * at.age_s
            beyond_m = max(hand.forearm_length_m + hand.forearm_radius_m - hand.radius_m, 0.0)
            below_m = 0.0 if at.with_elbow else beyond_m
            to_tcp_m = float(np.linalg.norm(at.bodies[0] - tcp_m))
            hands[name] = _HandThere(at, distance_m, to_tcp_m, off_m, below_m)
        speed_known = speed if cell.rates_radps is not None else nan
        return _Pose(cell, cell.joints_rad, tcp_m, speed_known, self._fastest_mps * cell.age_s, hands)

    def _at_tick(self, cell: CellAt, pose: _Pose | None) -> Signals:
        found = dict.fromkeys(MEASURED, UNKNOWN)
        elapsed_s = cell.elapsed_s
        found[elapsed_time] = Known(elapsed_s, elapsed_s, elapsed_s, elapsed_s, elapsed_s)
        critical_m = self._settings.avoidance.critical_distance_m
        for words, signal in GIVEN.items():
            value = cell.given.get(words, nan)
            if isnan(value):
                found[signal] = UNKNOWN
            else:
                tried = signal is not predicted_hand_distance or value < critical_m
                found[signal] = Known(value, value, value, value, value, tried)
        if pose is None:
            return found
        found[tcp_height] = _known(float(pose.tcp_m[2]), pose.off_m)
        if cell.rates_radps is not None:
            fastest = float(np.abs(cell.rates_radps).max())
            for signal, speed in ((tcp_speed, pose.tcp_mps), (joint_speed, fastest)):
                found[signal] = Known(speed, speed, speed, speed, speed, speed > MOVING)
        for signal, of in ((hand_distance, _distance), (nearest_hand_to_tcp, _to_tcp)):
            low = high = value = inf if pose.hands else nan
            for hand in pose.hands.values():
                if isinstance(hand, _HandThere):
                    own, below = of(hand)
                    off_m = hand.off_m + pose.off_m
                    value, low, high = min(value, own), min(low, own - off_m - below), min(high, own + off_m)
                elif hand is None:
                    low = -inf
            if not isnan(value):
                lost = None in pose.hands.values()
                value = nan if lost and value == inf else value
                found[signal] = Known(value, low, high, low, high, high < critical_m)
        return found

    def _between(self, before: _Pose, now: _Pose) -> dict[Signal, tuple[float, float, bool]]:
        """From one tick to the next, (least, largest, certainly put to the test) of what moves."""
        period_s, found = self.period_s, {}
        rates = before.cell.rates_radps, now.cell.rates_radps
        moved_m = float(np.linalg.norm(now.tcp_m - before.tcp_m))
        off_m = max(before.off_m, now.off_m)
        bend_m, way_m = self._fastest_mps * period_s / 2.0, self._fastest_mps * period_s
        if rates[0] is not None and rates[1] is not None:
            bend_m = _bend(self._arm.reach_m, *rates, period_s)
            way_m = max(max(before.tcp_mps, now.tcp_mps) * period_s, moved_m)
            by = 2.0 * off_m / period_s
            steps = np.abs(now.joints_rad - before.joints_rad) / period_s
            sides = np.abs(np.array(rates))
            least, most = np.minimum(sides.min(axis=0), steps), np.maximum(sides.max(axis=0), steps)
            moves = float(steps.max()) - by > MOVING
            found[joint_speed] = float(least.max()) - by, float(most.max()) + by, moves
            speeds, mean = (before.tcp_mps, now.tcp_mps), moved_m / period_s
            found[tcp_speed] = min(*speeds, mean) - by, max(*speeds, mean) + by, mean - by > MOVING
        low, high = _tent(float(before.tcp_m[2]), float(now.tcp_m[2]), way_m)
        found[tcp_height] = low - off_m, high + off_m, False
        ways = [self._hand_between(before, now, name, bend_m, way_m) for name in {**before.hands, **now.hands}]
        for index, signal in enumerate((hand_distance, nearest_hand_to_tcp)):
            sides = [way[index] for way in ways] or [(-inf, inf)]
            found[signal] = min(low for low, _ in sides), min(high for _, high in sides), False
        return found

    def _hand_between(
        self, before: _Pose, now: _Pose, name: str, bend_m: float, way_m: float
    ) -> tuple[tuple[float, float], tuple[float, float]]:
        """Of one hand: bounds of its distance from the arm, and of its centre's from the TCP."""
        one, other = before.hands.get(name), now.hands.get(name)
        if one is None or other is None:
            return (-inf, inf), (-inf, inf)
        period_s, hand = self.period_s, self._settings.hand
        arm_m = max(before.off_m, now.off_m)
        if isinstance(one, str) or isinstance(other, str):
            there = one if isinstance(one, _HandThere) else other
            if isinstance(there, str):
                return (inf, inf), (inf, inf)
            came_m = there.off_m + arm_m + (self._bodies.at_most_mps + self._fastest_mps) * period_s
            return (there.distance_m - there.below_m - came_m, inf), (there.to_tcp_m - came_m, inf)
        off_m = max(one.off_m, other.off_m) + arm_m
        off_m += 0.0 if self._bodies.straight else self._bodies.at_most_mps * period_s / 2.0
        moved_m = np.linalg.norm(other.at.bodies - one.at.bodies, axis=1)
        bound, _, _ = closest_approach_between(
            self._arm,
            self._room,
            before.joints_rad,
            now.joints_rad,
            one.at.bodies[0],
            other.at.bodies[0],
            one.at.bodies[1],
            other.at.bodies[1],
            hand.radius_m,
            hand.forearm_radius_m,
            RESOLUTION_M,
            inf,
        )
        turned_m = float(np.abs(now.joints_rad - before.joints_rad) @ self._arm.reach_m)
        _, far_m = _tent(one.distance_m, other.distance_m, turned_m + float(moved_m.max()))
        below_m = max(one.below_m, other.below_m)
        distance = min(one.distance_m, bound - bend_m) - off_m - below_m, far_m + bend_m + off_m
        low, high = _tent(one.to_tcp_m, other.to_tcp_m, way_m + float(moved_m[0]))
        return distance, (low - off_m, high + off_m)


_HELD = frozenset(GIVEN.values())


def _distance(hand: _HandThere) -> tuple[float, float]:
    return hand.distance_m, hand.below_m


def _to_tcp(hand: _HandThere) -> tuple[float, float]:
    return hand.to_tcp_m, 0.0


def _known(value: float, off: float) -> Known:
    return Known(value, value - off, value + off, value - off, value + off)


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


@compiled
def _bend(
    reach_m: NDArray[np.float64],  # (n,)
    before_radps: NDArray[np.float64],  # (n,)
    after_radps: NDArray[np.float64],  # (n,)
    period_s: float,
) -> float:
    """As ``joint_bend_m`` has it [m]."""
    found = 0.0
    for joint in range(reach_m.shape[0]):
        found += abs(after_radps[joint] - before_radps[joint]) * reach_m[joint]
    return found * period_s / 4.0


def margin_at(atom: Comparison | Truth, signals: Signals, *, cell: bool) -> tuple[float, float]:
    """The least and largest margin of a comparison or truth, at the tick or from it to the next."""
    known = signals[atom.signal]
    low, high = (known.cell_low, known.cell_high) if cell else (known.low, known.high)
    if isinstance(atom, Truth):
        return (inf if low > 0.5 else -inf), (inf if high > 0.5 else -inf)
    limit, relation = atom.limit.value, atom.relation
    above = relation in (Relation.ABOVE, Relation.AT_LEAST)
    at_limit = -LEAST if relation in (Relation.ABOVE, Relation.BELOW) else LEAST
    least, most = (low - limit, high - limit) if above else (limit - high, limit - low)
    return least or at_limit, most or at_limit
