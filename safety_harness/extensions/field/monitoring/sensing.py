"""From joints and hands at a tick to the signals, with bounds of what they can have been, as of a log.

What ``claims.signals`` computes of a whole trace, here of the latest ticks and of the ways between them,
for each tick and hand with the uncertainty that it has then, in compiled code: a cell that runs has 8 ms for
a tick.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isnan, nan
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import compiled, inlined
from safety_harness.cell.robot.capsules import Arm, arm_with, tcp_alone
from safety_harness.cell.robot.closest_approach import MAX_BISECTIONS, closest_approach_between
from safety_harness.cell.robot.distance import hand_distance as distance_between
from safety_harness.cell.robot.distance import place_capsules
from safety_harness.cell.robot.kinematics import forward_kinematics, tcp_velocity
from safety_harness.cell.robot.robots import arm_capsules
from safety_harness.cell.simulation.truth import cell_capsules
from safety_harness.claims.formulas.signals import (
    elapsed_time,
    hand_distance,
    joint_speed,
    nearest_hand_to_tcp,
    tcp_height,
    tcp_speed,
)
from safety_harness.claims.signals.occasions import MOVES
from safety_harness.claims.signals.true_motion import RESOLUTION_M
from safety_harness.extensions.field.monitoring.cell import WatchedCell
from safety_harness.extensions.field.monitoring.tracks import BodyTrack

MEASURED = (hand_distance, nearest_hand_to_tcp, tcp_speed, tcp_height, joint_speed, elapsed_time)
APART, NEAR, TCP_SPEED, HEIGHT, JOINT_SPEED, ELAPSED = range(6)  # in ``MEASURED``
# What is known of a signal at a tick: what was measured, NaN for nothing; the least and the largest that it
# can have been, there and from there to the next tick; and 1 if it certainly exercises a claim, else 0.
VALUE, LOW, HIGH, CELL_LOW, CELL_HIGH, TRIED = range(6)
Values = NDArray[np.float64]


@dataclass(eq=False)
class TickSeen:
    """A tick, and what is known of it now.

    Joints and their speeds (n,), what both may be off, NaN if nothing is known, hands and elbows (h, 2, 3)
    [m] in base and what these may be off (h, 2), NaN if that is not known; a hand without a forearm has its
    elbow where it is.  ``signals`` (signals, 6) follow.
    """

    tick: int
    elapsed_s: float
    joints_rad: Values
    rates_radps: Values
    off: tuple[float, float] = (nan, nan)
    bodies_m: Values | None = None
    bodies_off_m: Values | None = None
    signals: Values | None = None

    @property
    def lost(self) -> bool:
        """Is the arm or a hand not known?"""
        assert self.bodies_off_m is not None
        return isnan(self.off[0]) or bool(np.isnan(self.bodies_off_m[:, 0]).any())


class HandTracks(NamedTuple):
    """Of a hand and its elbow: the same track where it has no forearm, None where nobody measures it."""

    hand: BodyTrack
    elbow: BodyTrack | None


class Sensing:
    """The signals of one cell."""

    def __init__(self, cell: WatchedCell, hands: Sequence[HandTracks]) -> None:
        settings, self._hands = cell.scenario.settings, hands
        self._period_ns, self._nowhere = cell.period_ns, np.full((len(hands), 2), nan)
        self._arm = arm_with(cell.arm, cell_capsules(arm_capsules(cell.scenario.robot), settings))
        self._tcp = tcp_alone(cell.arm)
        count = len(self._arm.capsules)
        self._room = np.empty((MAX_BISECTIONS + 1, count, 2, 3))
        self._sizes = settings.hand.radius_m, settings.hand.forearm_radius_m, cell.period_s

    def see(
        self, moments: Sequence[TickSeen], fresh: int, off: Sequence[tuple[float, float] | None]
    ) -> Values:
        """(m, signals, 6) of moments in a row, of which those from ``fresh`` on are known better.

        Joints and their speeds are ``off`` by so much there, None: lost.
        """
        for moment, own in zip(moments[fresh:], off, strict=True):
            moment.off = own or (nan, nan)
            self._place_hands(moment)
        first = moments[0].tick
        found = np.empty((len(moments), len(MEASURED), 6))
        _sense(
            self._arm,
            self._tcp,
            self._room,
            np.array([one.elapsed_s for one in moments]),
            np.array([one.joints_rad for one in moments]),
            np.array([one.rates_radps for one in moments]),
            np.array([one.off for one in moments]),
            np.array([one.bodies_m for one in moments]),
            np.array([one.bodies_off_m for one in moments]),
            *self._corners(first, first + len(moments) - 1),
            *self._sizes,
            found,
        )
        for moment, signals in zip(moments, found, strict=True):
            moment.signals = signals
        return found

    def _place_hands(self, moment: TickSeen) -> None:
        moment.bodies_m, moment.bodies_off_m = np.zeros(self._nowhere.shape + (3,)), self._nowhere.copy()
        for k, (hand, elbow) in enumerate(self._hands):
            if (own := hand.at(moment.tick)) is None:
                continue
            other = own if elbow is hand else None if elbow is None else elbow.at(moment.tick)
            moment.bodies_m[k], moment.bodies_off_m[k, 0] = own[0], own[1]
            if other is not None:
                moment.bodies_m[k, 1], moment.bodies_off_m[k, 1] = other

    def _corners(self, first: int, last: int) -> tuple[NDArray[np.int64], Values, Values]:
        """The samples of hands between two ticks.

        Their ticks after ``first``, and hands (c, 2), parts of a period (c,), and places (c, 2, 3) of hand
        and elbow then.
        """
        found = []
        for k, (hand, elbow) in enumerate(self._hands):
            other, begin_ns, end_ns = elbow or hand, first * self._period_ns, last * self._period_ns
            times = hand.corners(begin_ns, end_ns)
            if other is not hand:
                times = sorted({*times, *other.corners(begin_ns, end_ns)})
            for time_ns in sorted(times):
                tick, since_ns = divmod(time_ns, self._period_ns)
                if since_ns:
                    places = hand.between(time_ns), other.between(time_ns)
                    found.append(((tick - first, k), since_ns / self._period_ns, places))
        if not found:
            return np.empty((0, 2), np.int64), np.empty(0), np.empty((0, 2, 3))
        which, share, places_m = zip(*found, strict=True)
        return np.array(which), np.array(share), np.array(places_m)


@compiled
def _sense(
    arm: Arm,
    tcp: Arm,
    room: NDArray[np.float64],  # (MAX_BISECTIONS + 1, c, 2, 3), overwritten
    elapsed_s: NDArray[np.float64],  # (m,)
    joints_rad: NDArray[np.float64],  # (m, n)
    rates_radps: NDArray[np.float64],  # (m, n)
    off: NDArray[np.float64],  # (m, 2)
    bodies_m: NDArray[np.float64],  # (m, h, 2, 3)
    bodies_off_m: NDArray[np.float64],  # (m, h, 2)
    corner: NDArray[np.int64],  # (c, 2)
    corner_at: NDArray[np.float64],  # (c,)
    corners_m: NDArray[np.float64],  # (c, 2, 3)
    radius_m: float,
    forearm_radius_m: float,
    period_s: float,
    found: NDArray[np.float64],  # (m, signals, 6), written
) -> None:
    """As ``Sensing.see``: the ticks, each as if the run ended there, then the ways from one to the next."""
    count, hands, n = joints_rad.shape[0], bodies_m.shape[1], joints_rad.shape[1]
    reach_m = arm.reach_m.sum()
    transforms = np.empty((n + 2, 4, 4))
    ends_m, tcp_room = np.empty((arm.capsules.shape[0], 2, 3)), np.empty((MAX_BISECTIONS + 1, 1, 2, 3))
    tcp_m, speed_mps = np.empty((count, 3)), np.empty(count)
    off_m, off_mps = off[:, 0] * reach_m, np.empty(count)
    to_tcp_m, apart_m = np.empty((count, hands)), np.full((count, hands), np.nan)
    for k in range(count):
        known = found[k]
        known[:, VALUE], known[:, TRIED] = np.nan, 0.0
        known[:, LOW], known[:, CELL_LOW] = -np.inf, -np.inf
        known[:, HIGH], known[:, CELL_HIGH] = np.inf, np.inf
        known[ELAPSED, :], known[ELAPSED, TRIED] = elapsed_s[k], 1.0
        if np.isnan(off[k, 0]):
            continue
        forward_kinematics(arm.chain[0], joints_rad[k], transforms)
        place_capsules(arm.capsules, transforms, ends_m)
        tcp_m[k] = transforms[n + 1, :3, 3]
        x, y, z = tcp_velocity(arm.chain[0].joint_axes, transforms, rates_radps[k])
        speed_mps[k] = np.sqrt(x * x + y * y + z * z)
        moved_mps, fastest_radps = 0.0, 0.0
        for j in range(n):
            moved_mps += abs(rates_radps[k, j]) * _farther_m(arm.reach_m, j)
            fastest_radps = max(fastest_radps, abs(rates_radps[k, j]))
        off_mps[k] = off[k, 1] * reach_m + off[k, 0] * moved_mps
        between_m = _place_between_m(off_m, off_mps, k, k, period_s)
        by_mps = _speed_between(off_mps, off_m, k, k, period_s)
        by_radps = _speed_between(off[:, 1], off[:, 0], k, k, period_s)
        _set_known(known[HEIGHT], tcp_m[k, 2], off_m[k], between_m, True)
        _set_known(known[TCP_SPEED], speed_mps[k], off_mps[k], by_mps, speed_mps[k] - MOVES > by_mps)
        _set_known(known[JOINT_SPEED], fastest_radps, off[k, 1], by_radps, fastest_radps - MOVES > by_radps)
        unseen, unmeasured = 0, 0
        for h in range(hands):
            hand_off_m, elbow_off_m = bodies_off_m[k, h, 0], bodies_off_m[k, h, 1]
            if np.isnan(hand_off_m):
                unseen, unmeasured = unseen + 1, unmeasured + 1
                continue
            to_tcp_m[k, h] = _distance_m(bodies_m[k, h, 0], tcp_m[k])
            more_m = between_m + 2.0 * hand_off_m
            _nearer(known[NEAR], to_tcp_m[k, h], off_m[k] + hand_off_m, more_m)
            if np.isnan(elbow_off_m):
                unmeasured += 1
                continue
            hand, elbow = bodies_m[k, h, 0], bodies_m[k, h, 1]
            apart_m[k, h], _ = distance_between(arm.capsules, ends_m, hand, elbow, radius_m, forearm_radius_m)
            moved_m = _moved_m(off_m[k], off[k, 1], bodies_off_m[k, h], reach_m, period_s)
            at_m = max(hand_off_m, elbow_off_m) + off_m[k]
            _nearer(known[APART], apart_m[k, h], at_m, moved_m)
        for signal in (APART, NEAR):
            if not np.isnan(known[signal, VALUE]) and (unmeasured if signal == APART else unseen) > 0:
                known[signal, LOW] = known[signal, CELL_LOW] = -np.inf
    for k in range(count - 1):
        known = found[k]
        known[ELAPSED, CELL_HIGH] = elapsed_s[k + 1]
        if np.isnan(off[k, 0]) or np.isnan(off[k + 1, 0]):
            known[:ELAPSED, CELL_LOW], known[:ELAPSED, CELL_HIGH] = -np.inf, np.inf
            continue
        between_m = _place_between_m(off_m, off_mps, k, k + 1, period_s)
        by_mps = _speed_between(off_mps, off_m, k, k + 1, period_s)
        by_radps = _speed_between(off[:, 1], off[:, 0], k, k + 1, period_s)
        step_m = _distance_m(tcp_m[k], tcp_m[k + 1])
        way_m, mean_mps = max(max(speed_mps[k], speed_mps[k + 1]) * period_s, step_m), step_m / period_s
        slowest, fastest, mean, bend_m, turned_m = 0.0, 0.0, 0.0, np.zeros(2), 0.0
        for j in range(n):
            step = abs(joints_rad[k + 1, j] - joints_rad[k, j])
            one, other = abs(rates_radps[k, j]), abs(rates_radps[k + 1, j])
            slowest = max(slowest, min(one, other, step / period_s))
            fastest, mean = max(fastest, one, other, step / period_s), max(mean, step / period_s)
            turned_m += step * arm.reach_m[j]
            bend_rad = abs(rates_radps[k + 1, j] - rates_radps[k, j]) * period_s / 4.0
            bend_m[APART] += bend_rad * arm.reach_m[j]
            bend_m[NEAR] += bend_rad * tcp.reach_m[j]
        _set_cell(known[JOINT_SPEED], slowest - by_radps, fastest + by_radps, mean - MOVES > by_radps)
        low, high = (
            min(speed_mps[k], speed_mps[k + 1], mean_mps),
            max(speed_mps[k], speed_mps[k + 1], mean_mps),
        )
        _set_cell(known[TCP_SPEED], low - by_mps, high + by_mps, mean_mps - MOVES > by_mps)
        low, high = _tent(tcp_m[k, 2], tcp_m[k + 1, 2], way_m)
        _set_cell(known[HEIGHT], low - between_m, high + between_m, False)
        least_m, most_m = np.full(2, np.inf), np.full(2, np.inf)
        for h in range(hands):
            if np.isnan(bodies_off_m[k, h, 0]) or np.isnan(bodies_off_m[k + 1, h, 0]):
                least_m[:] = -np.inf
                continue
            measured = not (np.isnan(apart_m[k, h]) or np.isnan(apart_m[k + 1, h]))
            bound_m, hand_m, elbow_m = np.full(2, np.inf), 0.0, 0.0
            before, begin = bodies_m[k, h], joints_rad[k]
            for c in range(corner.shape[0] + 1):
                if c == corner.shape[0]:
                    after, end = bodies_m[k + 1, h], joints_rad[k + 1]
                elif corner[c, 0] == k and corner[c, 1] == h:
                    after = corners_m[c]
                    end = joints_rad[k] + corner_at[c] * (joints_rad[k + 1] - joints_rad[k])
                else:
                    continue
                hand_m += _distance_m(before[0], after[0])
                elbow_m += _distance_m(before[1], after[1])
                for signal in (APART, NEAR):
                    near = signal == NEAR
                    if near or measured:
                        own_m, _, _, _ = closest_approach_between(
                            tcp if near else arm,
                            tcp_room if near else room,
                            begin,
                            end,
                            before[0],
                            after[0],
                            before[0 if near else 1],
                            after[0 if near else 1],
                            0.0 if near else radius_m,
                            0.0 if near else forearm_radius_m,
                            RESOLUTION_M,
                            np.inf,
                        )
                        bound_m[signal] = min(bound_m[signal], own_m - bend_m[signal])
                before, begin = after, end
            _, high = _tent(to_tcp_m[k, h], to_tcp_m[k + 1, h], way_m + hand_m)
            hand_off_m = max(bodies_off_m[k, h, 0], bodies_off_m[k + 1, h, 0])
            by_rad = max(off[k, 0], off[k + 1, 0]) + 0.5 * period_s * max(off[k, 1], off[k + 1, 1])
            by_m = max(off_m[k], off_m[k + 1], by_rad * tcp.reach_m.sum()) + hand_off_m
            least_m[NEAR] = min(least_m[NEAR], min(to_tcp_m[k, h], bound_m[NEAR]) - by_m)
            most_m[NEAR] = min(most_m[NEAR], high + between_m + 2.0 * hand_off_m)
            if not measured:
                least_m[APART] = -np.inf
                continue
            _, far_m = _tent(apart_m[k, h], apart_m[k + 1, h], turned_m + max(hand_m, elbow_m))
            moved_m, beside_m = 0.0, 0.0
            for at in (k, k + 1):
                own_m = _moved_m(off_m[at], off[at, 1], bodies_off_m[at, h], reach_m, period_s)
                moved_m = max(moved_m, own_m)
                beside_m = max(
                    beside_m, own_m + max(bodies_off_m[at, h, 0], bodies_off_m[at, h, 1]) + off_m[at]
                )
            low = min(apart_m[k, h], bound_m[APART]) - moved_m
            least_m[APART], most_m[APART] = (
                min(least_m[APART], low),
                min(most_m[APART], far_m + bend_m[APART] + beside_m),
            )
        if hands:
            for signal in (APART, NEAR):
                _set_cell(known[signal], least_m[signal], most_m[signal], False)


@inlined
def _farther_m(reach_m: NDArray[np.float64], joint: int) -> float:
    """How far what a joint turns reaches, link after link; ``reach_m`` (n,)."""
    total = 0.0
    for k in range(reach_m.shape[0]):
        total += reach_m[max(k, joint)]
    return total


@inlined
def _set_known(known: NDArray[np.float64], value: float, off: float, between: float, tried: bool) -> None:
    """Of a signal, ``known`` (6,), at a tick; from there to the next is the tick, as far as that is known."""
    known[VALUE], known[TRIED] = value, 1.0 if tried else 0.0
    known[LOW], known[HIGH] = value - off, value + off
    known[CELL_LOW], known[CELL_HIGH] = value - between, value + between


@inlined
def _set_cell(known: NDArray[np.float64], low: float, high: float, tried: bool) -> None:
    """Of a signal, ``known`` (6,), to the next tick; unknown if it is not known at the tick."""
    unknown = np.isnan(known[VALUE])
    known[CELL_LOW], known[CELL_HIGH] = -np.inf if unknown else low, np.inf if unknown else high
    if tried:
        known[TRIED] = 1.0


@inlined
def _nearer(known: NDArray[np.float64], value: float, off: float, more: float) -> None:
    """Of the nearest hand, ``known`` (6,), if another one may be it."""
    first = np.isnan(known[VALUE])
    known[VALUE] = value if first else min(known[VALUE], value)
    known[LOW] = value - off if first else min(known[LOW], value - off)
    known[CELL_LOW] = value - more if first else min(known[CELL_LOW], value - more)
    known[HIGH] = min(known[HIGH], value + off)
    known[CELL_HIGH] = min(known[CELL_HIGH], value + off + more)


@inlined
def _distance_m(one: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    """From ``one`` (3,) to the ``other`` (3,)."""
    x, y, z = other[0] - one[0], other[1] - one[1], other[2] - one[2]
    return float(np.sqrt(x * x + y * y + z * z))


@inlined
def _moved_m(
    off_m: float, rates_off_radps: float, body_off_m: NDArray[np.float64], reach_m: float, period_s: float
) -> float:
    """As ``distance_moved_m`` between the ticks; ``body_off_m`` (2,)."""
    own_m: float = max(body_off_m[0], body_off_m[1]) + off_m
    return own_m + period_s / 2.0 * rates_off_radps * reach_m


@inlined
def _place_between_m(
    off_m: NDArray[np.float64], off_mps: NDArray[np.float64], one: int, other: int, period_s: float
) -> float:
    """As ``claims.signals.uncertainty.of_place``; ``off_m`` and ``off_mps`` (m,)."""
    at = max(off_m[one], off_m[other])
    return float(at + 0.5 * max(max(off_mps[one], off_mps[other]) * period_s, 2.0 * at))


@inlined
def _speed_between(
    speed: NDArray[np.float64], place: NDArray[np.float64], one: int, other: int, period_s: float
) -> float:
    """As ``claims.signals.uncertainty.of_speed``; ``speed`` and ``place`` (m,)."""
    return float(max(speed[one], speed[other], 2.0 * max(place[one], place[other]) / period_s))


@inlined
def _tent(first: float, second: float, way: float) -> tuple[float, float]:
    """As ``claims.signals.signal.tent``."""
    low = min(0.5 * (first + second - way), min(first, second))
    return low, max(0.5 * (first + second + way), max(first, second))
