"""Compute the signals at the latest ticks from joints and hands.

The bounds of the signals are computed as for a log, with one difference. This module calls the functions of
``claims.signals.bounds`` in compiled code, since a live cell has a tick every 8 ms. It uses the separate
uncertainty of each tick and of each hand. For some signals of a log, the largest uncertainty in the run is
used instead.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isnan, nan
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import compiled
from safety_harness.cell.robot.capsules import Arm, arm_with, tcp_alone
from safety_harness.cell.robot.closest_approach import MAX_BISECTIONS
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
from safety_harness.claims.signals.bounds import (
    apart_between,
    cells,
    or_next,
    place_between,
    speed_between,
    speed_cell,
    velocity_off,
)
from safety_harness.claims.signals.hand_distance import POINT, between_ticks, distance_m
from safety_harness.claims.signals.occasions import MOVES
from safety_harness.claims.signals.true_motion import RESOLUTION_M
from safety_harness.extensions.field.monitoring.cell import WatchedCell
from safety_harness.extensions.field.monitoring.tracks import BodyTrack

MEASURED = (hand_distance, nearest_hand_to_tcp, tcp_speed, tcp_height, joint_speed, elapsed_time)
HAND_DISTANCE, TCP_DISTANCE, TCP_SPEED, HEIGHT, JOINT_SPEED, ELAPSED = range(6)  # in ``MEASURED``
# The columns for a signal at a tick: the measured value (NaN: none), the least and the largest possible value
# at the tick, the same from there to the next tick, and 1 if the signal certainly exercises a claim, else 0.
VALUE, LOW, HIGH, CELL_LOW, CELL_HIGH, EXERCISED = range(6)
Values = NDArray[np.float64]


@dataclass(eq=False)
class TickSeen:
    """The measurements at a tick and their errors, as known at present.

    ``joints_rad`` and ``rates_radps`` are of shape (n,). ``joint_errors`` contains one error for all joint
    positions, and one for all joint speeds. ``bodies_m`` (h, 2, 3) are the positions of hands and elbows [m]
    in base, with the errors ``body_errors_m`` (h, 2). An unknown number is NaN. If a hand has no forearm, its
    elbow has the same position as the hand. ``Sensing.see`` sets ``signals`` (signals, 6).
    """

    tick: int
    elapsed_s: float
    joints_rad: Values
    rates_radps: Values
    joint_errors: tuple[float, float] = (nan, nan)
    bodies_m: Values | None = None
    body_errors_m: Values | None = None
    signals: Values | None = None

    @property
    def lost(self) -> bool:
        """Return whether the arm's joints or the position of a hand are unknown."""
        assert self.body_errors_m is not None
        return isnan(self.joint_errors[0]) or bool(np.isnan(self.body_errors_m[:, 0]).any())


class HandTracks(NamedTuple):
    """The tracks of a hand and of its elbow.

    ``elbow`` is None if the elbow is not measured. If the hand has no forearm, ``elbow`` is the hand's own
    track.
    """

    hand: BodyTrack
    elbow: BodyTrack | None


class _Cell(NamedTuple):
    """The values of a cell that the compiled code needs."""

    arm: Arm
    tcp: Arm
    space: Values  # (MAX_BISECTIONS + 1, capsules, 2, 3), overwritten
    tcp_space: Values  # (MAX_BISECTIONS + 1, 1, 2, 3), overwritten
    radii_m: tuple[float, float]  # of hand and forearm
    period_s: float


class _Seen(NamedTuple):
    """The measurements of n joints and h hands at m ticks, and c samples of hands between ticks."""

    elapsed_s: Values  # (m,)
    joints_rad: Values  # (m, n)
    rates_radps: Values  # (m, n)
    joint_errors: Values  # (m, 2) errors of joints and of their speeds, NaN where the arm is lost
    bodies_m: Values  # (m, h, 2, 3) hands and elbows, NaN where they are not known
    body_errors_m: Values  # (m, h, 2) their errors
    corner_hand: NDArray[np.int64]  # (c,) rising
    corner_at: Values  # (c,) ticks since the first, rising for each hand
    corners_m: Values  # (c, 2, 3) hand and elbow there


class Sensing:
    """The computation of the signals of one cell from its joints and hands."""

    def __init__(self, cell: WatchedCell, hands: Sequence[HandTracks]) -> None:
        settings, self._hands = cell.scenario.settings, hands
        self._period_ns, self._nowhere = cell.period_ns, np.full((len(hands), 2), nan)
        arm = arm_with(cell.arm, cell_capsules(arm_capsules(cell.scenario.robot), settings))
        radii_m = settings.hand.radius_m, settings.hand.forearm_radius_m
        workspace = np.empty((MAX_BISECTIONS + 1, len(arm.capsules), 2, 3))
        tcp = tcp_alone(cell.arm), workspace, workspace[:, :1].copy()
        self._cell = _Cell(arm, *tcp, radii_m, cell.period_s)

    def see(
        self, moments: Sequence[TickSeen], fresh: int, errors: Sequence[tuple[float, float] | None]
    ) -> Values:
        """Return the signals (m, signals, 6) of m consecutive ticks.

        Args:
            moments: The ticks. The method sets their ``signals``.
            fresh: The index of the first tick on which new samples give more information.
            errors: The errors of joint positions and of joint speeds from ``fresh`` on; None where the arm is
                lost.

        """
        for moment, own in zip(moments[fresh:], errors, strict=True):
            moment.joint_errors = own or (nan, nan)
            self._place_hands(moment)
        first, values = moments[0].tick, np.empty((len(moments), len(MEASURED), 6))
        names = ("elapsed_s", "joints_rad", "rates_radps", "joint_errors", "bodies_m", "body_errors_m")
        columns = (np.array([getattr(moment, name) for moment in moments]) for name in names)
        _sense(self._cell, _Seen._make([*columns, *self._corners(first, first + len(moments) - 1)]), values)
        for moment, signals in zip(moments, values, strict=True):
            moment.signals = signals
        return values

    def _place_hands(self, moment: TickSeen) -> None:
        moment.bodies_m, moment.body_errors_m = np.full((*self._nowhere.shape, 3), nan), self._nowhere.copy()
        for k, (hand, elbow) in enumerate(self._hands):
            if (own := hand.at(moment.tick)) is None:
                continue
            elbow_place = own if elbow is hand else None if elbow is None else elbow.at(moment.tick)
            moment.bodies_m[k], moment.body_errors_m[k, 0] = own[0], own[1]
            if elbow_place is not None:
                moment.bodies_m[k, 1], moment.body_errors_m[k, 1] = elbow_place

    def _corners(self, first: int, last: int) -> tuple[NDArray[np.int64], Values, Values]:
        """Return the samples of hands between the ticks ``first`` and ``last``.

        The three arrays are the index of the hand (c,), the time (c,) in ticks after ``first``, and the
        places (c, 2, 3) of hand and elbow.
        """
        corners = []
        for k, (hand, elbow) in enumerate(self._hands):
            partner, begin_ns, end_ns = elbow or hand, first * self._period_ns, last * self._period_ns
            times = hand.corners(begin_ns, end_ns)
            if partner is not hand:
                times = sorted({*times, *partner.corners(begin_ns, end_ns)})
            for time_ns in sorted(times):
                if time_ns % self._period_ns:
                    places = hand.place_at(time_ns), partner.place_at(time_ns)
                    corners.append((k, (time_ns - begin_ns) / self._period_ns, places))
        if not corners:
            return np.empty(0, np.int64), np.empty(0), np.empty((0, 2, 3))
        bodies, at, places_m = zip(*corners, strict=True)
        return np.array(bodies), np.array(at), np.array(places_m)


@compiled
def _sense(cell: _Cell, seen: _Seen, out: Values) -> None:
    """Write to ``out`` (m, signals, 6) the signals at each tick, and their bounds until the next tick.

    The last tick is treated as the end of the run.
    """
    arm, tcp, period_s, joints_rad = cell.arm, cell.tcp, cell.period_s, seen.joints_rad
    count, hands, n = seen.bodies_m.shape[0], seen.bodies_m.shape[1], joints_rad.shape[1]
    turned_rad, faster_radps, reach_m = seen.joint_errors[:, 0], seen.joint_errors[:, 1], arm.reach_m.sum()
    # Each joint may err by ``turned_rad``, which moves a point by at most this joint's part of the reach.
    off_m = turned_rad * reach_m
    off_mps = velocity_off(arm.reach_m, turned_rad, faster_radps, seen.rates_radps)
    transforms, ends_m = np.empty((n + 2, 4, 4)), np.empty((arm.capsules.shape[0], 2, 3))
    tcp_m, speed_mps = np.full((count, 3), np.nan), np.full((count, 1), np.nan)
    to_tcp_m, apart_m = np.full((hands, count), np.nan), np.full((hands, count), np.nan)
    for k in range(count):
        if np.isnan(turned_rad[k]):
            continue
        forward_kinematics(arm.chain[0], joints_rad[k], transforms)
        place_capsules(arm.capsules, transforms, ends_m)
        tcp_m[k] = transforms[n + 1, :3, 3]
        x, y, z = tcp_velocity(arm.chain[0].joint_axes, transforms, seen.rates_radps[k])
        speed_mps[k] = np.sqrt(x * x + y * y + z * z)
        for h in range(hands):
            hand, elbow = seen.bodies_m[k, h]
            to_tcp_m[h, k] = distance_m(hand, tcp_m[k])
            apart_m[h, k], _ = distance_between(arm.capsules, ends_m, hand, elbow, *cell.radii_m)
    # Begin with unknown values.  ``_put`` takes minima, so that the nearest hand determines the bounds.
    out[:], out[:, :, LOW], out[:, :, CELL_LOW], out[:, :, EXERCISED] = (np.nan, np.inf, np.inf, 0.0)
    exact, later_s = np.zeros(count), np.append(seen.elapsed_s[1:], seen.elapsed_s[-1:])
    _put(out[:, ELAPSED], seen.elapsed_s, exact, seen.elapsed_s, later_s, exact, exact)
    out[:, ELAPSED, EXERCISED] = 1.0
    step_m = np.sqrt(((tcp_m[1:] - tcp_m[:-1]) ** 2).sum(axis=1))
    step_rad = np.abs(joints_rad[1:] - joints_rad[:-1])
    _put_speed(out[:, TCP_SPEED], speed_mps, step_m.reshape(-1, 1) / period_s, off_mps, off_m, period_s)
    rates_radps = np.abs(seen.rates_radps)
    _put_speed(out[:, JOINT_SPEED], rates_radps, step_rad / period_s, faster_radps, turned_rad, period_s)
    # Between two ticks, the TCP moves at most as far as the faster of their speeds allows.
    way_m = np.maximum(np.maximum(speed_mps[:-1, 0], speed_mps[1:, 0]) * period_s, step_m)
    between_m = place_between(or_next(off_m), or_next(off_mps), period_s)
    low_m, high_m = cells(tcp_m[:, 2], way_m, exact[1:])
    _put(out[:, HEIGHT], tcp_m[:, 2], off_m, low_m, high_m, between_m, between_m)
    out[:, HEIGHT, EXERCISED] = ~np.isnan(off_m)
    # A change of speed moves a joint off the straight line by at most a quarter of the period times the
    # change.
    bend_rad = np.abs(seen.rates_radps[1:] - seen.rates_radps[:-1]) * period_s / 4.0
    bend_m, tcp_bend_m = (bend_rad * arm.reach_m).sum(axis=1), (bend_rad * tcp.reach_m).sum(axis=1)
    turned_m = (step_rad * arm.reach_m).sum(axis=1)
    by_rad = or_next(turned_rad) + 0.5 * period_s * or_next(faster_radps)
    for h in range(hands):
        own, bodies_m = seen.corner_hand == h, seen.bodies_m[:, h].copy()
        corner_at, corners_m = seen.corner_at[own], seen.corners_m[own]
        # For the distance from the TCP, the forearm has no length: only the hand's centre counts.
        hands_m, turns_m = bodies_m.copy(), corners_m.copy()
        hands_m[:, 1], turns_m[:, 1] = bodies_m[:, 0], corners_m[:, 0]
        hand_m, elbow_m = seen.body_errors_m[:, h, 0], seen.body_errors_m[:, h, 1]
        ends_m, ways_m = between_ticks(
            tcp, cell.tcp_space, joints_rad, hands_m, corner_at, turns_m, tcp_bend_m, POINT, RESOLUTION_M
        )
        at_m, low_m = off_m + hand_m, to_tcp_m[h].copy()
        low_m[:-1] = np.minimum(low_m[:-1], ends_m[0])
        _, high_m = cells(to_tcp_m[h], way_m + ways_m[0], exact[1:])
        above_m = between_m + 2.0 * or_next(hand_m)
        below_m = np.maximum(or_next(off_m), by_rad * tcp.reach_m.sum()) + or_next(hand_m)
        _put(out[:, TCP_DISTANCE], to_tcp_m[h], at_m, low_m, high_m, below_m, above_m)
        at_m, low_m = np.maximum(hand_m, elbow_m) + off_m, apart_m[h].copy()
        ends_m, ways_m = between_ticks(
            arm, cell.space, joints_rad, bodies_m, corner_at, corners_m, bend_m, cell.radii_m, RESOLUTION_M
        )
        low_m[:-1] = np.minimum(low_m[:-1], ends_m[0])
        _, high_m = cells(apart_m[h], turned_m + np.maximum(ways_m[0], ways_m[1]), bend_m)
        moved_m = apart_between(hand_m, elbow_m, off_m, faster_radps * reach_m, period_s)
        below_m, above_m = or_next(moved_m), or_next(moved_m + at_m)
        _put(out[:, HAND_DISTANCE], apart_m[h], at_m, low_m, high_m, below_m, above_m)
    _open_unknown(out)


@compiled
def _open_unknown(known: Values) -> None:
    """Replace the unknown bounds in ``known`` (m, signals, 6) by infinite bounds."""
    # A loop, because expressions of whole arrays take longer to compile.
    for k in range(known.shape[0]):
        # NaN fails the first comparison, and infinity is the initial value of a lower bound.
        for signal in range(known.shape[1]):
            for side in (LOW, CELL_LOW):
                if not known[k, signal, side] < np.inf:
                    known[k, signal, side] = -np.inf
            for side in (HIGH, CELL_HIGH):
                if np.isnan(known[k, signal, side]):
                    known[k, signal, side] = np.inf


@compiled
def _put_speed(
    known: Values, at_ticks: Values, mean: Values, speed_error: Values, place: Values, period_s: float
) -> None:
    """Write bounds of the TCP's speed or of the fastest joint's speed to ``known`` (m, 6).

    The speeds at the ticks are ``at_ticks`` (m, joints), and the mean speeds between ticks are ``mean``
    (m - 1, joints). A speed has the error ``speed_error`` (m,), and a position has the error ``place`` (m,).
    """
    count = at_ticks.shape[0]
    value, low, high, mean_error = np.empty(count), np.empty(count), np.empty(count), np.empty(count)
    for k in range(count):  # as ``speed_cells`` does for whole arrays
        value[k], low[k], high[k], means, later = -np.inf, -np.inf, -np.inf, -np.inf, min(k + 1, count - 1)
        for joint in range(at_ticks.shape[1]):
            now = at_ticks[k, joint]
            least, most = now, now
            if later > k:
                least, most = speed_cell(now, at_ticks[later, joint], mean[k, joint])
                means = np.maximum(means, mean[k, joint])
            value[k], low[k], high[k] = (
                np.maximum(value[k], now),
                np.maximum(low[k], least),
                np.maximum(high[k], most),
            )
        errors = np.maximum(speed_error[k], speed_error[later]), np.maximum(place[k], place[later])
        mean_error[k] = speed_between(errors[0], errors[1], period_s)
        at_tick = value[k] - MOVES > speed_between(speed_error[k], place[k], period_s)
        known[k, EXERCISED] = at_tick or means - MOVES > mean_error[k]
    _put(known, value, speed_error, low, high, mean_error, mean_error)


@compiled
def _put(
    known: Values, value: Values, at: Values, low: Values, high: Values, below: Values, above: Values
) -> None:
    """Write the bounds of a signal to ``known`` (m, 6).

    If ``known`` already has the distance bounds of other hands, the function combines them with the bounds of
    this hand. At a tick, the signal is ``value`` (m,) with an error of at most ``at`` (m,). Until the next
    tick, its lower limit is ``low`` (m,) minus ``below`` (m,), and its upper limit is ``high`` (m,) plus
    ``above`` (m,). NaN stands for unknown. If the distance of one hand is unknown, the lower bound for the
    nearest hand is unknown too. The upper bound is still known, because it follows from the hands whose
    distance is known.
    """
    for k in range(known.shape[0]):  # expressions of whole arrays take fifteen times as long to compile
        tick, now = known[k], np.nan if np.isnan(at[k]) else value[k]
        tick[VALUE] = np.fmin(tick[VALUE], now)
        tick[LOW], tick[HIGH] = np.minimum(tick[LOW], now - at[k]), np.fmin(tick[HIGH], now + at[k])
        tick[CELL_LOW] = np.minimum(tick[CELL_LOW], low[k] - below[k])
        tick[CELL_HIGH] = np.fmin(tick[CELL_HIGH], high[k] + above[k])
