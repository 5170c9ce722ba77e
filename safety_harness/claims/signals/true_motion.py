"""Provide the true motion of arm and hands in a trace, at the ticks and between them.

A trace stores the place of a hand at each tick only. Between two ticks, this module follows the scenario's
own moves again. A recorded hand may turn at a sample between two ticks. The chord between the ticks misses
such a corner by up to half a tick's way (8 mm at 2 m/s and 8 ms). Other hands have bounded accelerations, so
they leave the chord without corners. ``finer_paths`` follows them in parts of a tick, so that they leave the
shorter chords by less.

It also checks that poses, speeds and distances of a trace follow from its joints and hands.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import sqrt
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import compiled, njit_no_nrt
from safety_harness.base.exceptions import Place, TraceError
from safety_harness.cell.robot.capsules import Arm, CapsuleSet, arm_with, tcp_alone
from safety_harness.cell.robot.robots import arm_capsules, arm_model
from safety_harness.cell.simulation.hand_motion import HAND, REACH_FOR_TCP, advance_hands, point_forearm
from safety_harness.cell.simulation.hand_programs import hands_at_start
from safety_harness.cell.simulation.truth import arm_record, cell_capsules, fill_truth
from safety_harness.claims.signals.bounds import velocity_off
from safety_harness.scenario.model import MovingHand, RecordedHand
from safety_harness.scenario.moves import FollowTcp, ReachForTcp
from safety_harness.trace.consistency import Inconsistency, at_first, first_inconsistency
from safety_harness.trace.known import PRESENCE
from safety_harness.trace.records import as_compiled, as_numbers, columns
from safety_harness.trace.trace import Trace, once_a_trace

RESOLUTION_M = 1e-4
SAME_M = 1e-6  # a hand farther than this from where the scenario moves it is not the scenario's hand
JOINTS = ("joint_position_rad", "joint_velocity_radps")
BODIES = ("hand_position_in_base_m", "elbow_position_in_base_m")
DERIVED = {  # from what
    "transform_tcp_to_base": JOINTS[:1],
    "tcp_speed_mps": JOINTS,
    "hand_distance_m": (JOINTS[0], *BODIES, PRESENCE),
}
PARTS = 16  # of a tick: in one part of 8 ms / 16, 90 m/s2 bends a path by 3 um
TOLERANCE = 1e-9  # of metres, m/s and entries of rotations, for the last digits of another machine


class TrueMotion:
    """The motion at each of n ticks, with positions in the base frame [m].

    Each array is made on first use, so that a property reads only the columns that it states.  It is a
    contiguous copy, because machine code for strided arrays would be compiled in addition.
    """

    def __init__(self, ticks: NDArray[np.void]) -> None:
        self._ticks = ticks

    @cached_property
    def joints_rad(self) -> NDArray[np.float64]:
        """(n, joints)."""
        return np.array(self._ticks["joint_position_rad"], order="C")

    @cached_property
    def rates_radps(self) -> NDArray[np.float64]:
        """(n, joints)."""
        return np.array(self._ticks["joint_velocity_radps"], order="C")

    @cached_property
    def tcp_m(self) -> NDArray[np.float64]:
        """(n, 3)."""
        return np.array(self._ticks["transform_tcp_to_base"][:, :3, 3], order="C")

    @cached_property
    def hands_m(self) -> NDArray[np.float64]:
        """(n, hands, 2, 3): hand and elbow."""
        hands, elbows = (columns(self._ticks.dtype)[body] for body in BODIES)
        assert hands.stop == elbows.start
        both = as_numbers(self._ticks)[:, hands.start : elbows.stop]
        return np.array(both.reshape(len(both), 2, -1, 3).transpose(0, 2, 1, 3), order="C")

    @cached_property
    def present(self) -> NDArray[np.bool_]:
        """(n, hands)."""
        return self._ticks["hand_present"]

    @cached_property
    def nearest_m(self) -> NDArray[np.float64]:
        """(n,): the least distance of a present hand, surface to surface; infinite without a hand."""
        distance_m = np.where(self.present, self._ticks["hand_distance_m"], np.inf)
        nearest: NDArray[np.float64] = np.array(distance_m, order="F").min(axis=1)
        return nearest


@once_a_trace
def true_motion(trace: Trace) -> TrueMotion:
    """Return the true motion of arm and hands in a trace."""
    return TrueMotion(trace.ticks)


@once_a_trace
def nearest_hand_m(trace: Trace) -> NDArray[np.float64]:
    """Return (n,) the distance of the nearest true hand's centre from the TCP; infinite without a hand."""
    true = true_motion(trace)
    apart_m = np.linalg.norm(np.ascontiguousarray(true.hands_m[:, :, 0]) - true.tcp_m[:, None], axis=2)
    return np.asarray(np.where(true.present, apart_m, np.inf).min(axis=1))


@once_a_trace
def capsules_of(trace: Trace) -> CapsuleSet:
    """Return the capsules of the trace's arm and camera."""
    return cell_capsules(arm_capsules(trace.scenario.robot), trace.scenario.settings)


@once_a_trace
def arm_of(trace: Trace) -> Arm:
    """Return the arm of a trace with the capsules of arm and camera, for compiled code."""
    return arm_with(arm_model(trace.scenario.robot), capsules_of(trace))


def tcp_of(trace: Trace) -> Arm:
    """Return the arm of a trace reduced to its TCP, for compiled code."""
    return tcp_alone(arm_model(trace.scenario.robot))


@dataclass(frozen=True, eq=False)
class HandPaths:
    """The paths of the scenario's hands along the arm's true way.

    ``positions_in_base_m`` (n, hands, 2, 3) are hand and elbow at each tick. ``moving`` (n-1, hands) is False
    where a hand rests from one tick to the next. ``corner_hand`` (m,) is the hand of each corner.
    ``corner_at`` (m,) is the corner's time in ticks, rising for each hand (3.25: a quarter of the way from
    tick 3 to 4). ``corners_in_base_m`` (m, 2, 3) are hand and elbow there. ``parts`` (n-1, hands) is the
    number of parts into which corners divide a tick of a hand with moves. ``resolution_m`` is that of least
    distances between two instants.
    """

    positions_in_base_m: NDArray[np.float64]
    moving: NDArray[np.bool_]
    corner_hand: NDArray[np.int64]
    corner_at: NDArray[np.float64]
    corners_in_base_m: NDArray[np.float64]
    parts: NDArray[np.int64]
    resolution_m: float


@once_a_trace
def hand_paths(trace: Trace) -> HandPaths:
    """Return the hands' paths by their moves again; hands that head for the TCP see the trace's TCP."""
    return _paths(trace, 1)


@once_a_trace
def finer_paths(trace: Trace) -> HandPaths:
    """Return the hands' paths by following their moves in PARTS of each tick, for closer bounds."""
    return _paths(trace, PARTS)


def _paths(trace: Trace, most_parts: int) -> HandPaths:
    scenario, count = trace.scenario, len(trace.ticks)
    hands = hands_at_start(scenario)
    most = len(scenario.hands) * (len(hands.samples) + count * (most_parts - 1)) + 1
    parts = np.full((max(count - 1, 0), len(scenario.hands)), most_parts)
    positions = np.zeros((count, len(scenario.hands), 2, 3))
    moving = np.zeros((max(count - 1, 0), len(scenario.hands)), np.bool_)
    owners, at, corners = np.zeros(most, np.int64), np.zeros(most), np.zeros((most, 2, 3))
    n = _follow(
        hands.state,
        hands.moves,
        hands.samples,
        true_motion(trace).tcp_m,
        scenario.settings.clock.control_period_s,
        positions,
        moving,
        owners,
        at,
        corners,
        parts,
    )
    resolution_m = RESOLUTION_M if most_parts == 1 else 0.5 * RESOLUTION_M
    return HandPaths(positions, moving, owners[:n], at[:n], corners[:n], parts, resolution_m)


@once_a_trace
def first_stray(trace: Trace) -> int | None:
    """Return the first tick at which a hand or elbow is not where its scenario moves it, or None.

    Only measured positions are compared, to within their uncertainty. No hand is compared if a hand heads for
    a TCP that is not wholly known.
    """
    moved_m, known = hand_paths(trace).positions_in_base_m, trace.known
    stored_m = true_motion(trace).hands_m[:, : moved_m.shape[1]].copy()
    if not known.whole:
        if follows_unknown(trace):
            return None
        for body, name in enumerate(BODIES):
            off_m = np.linalg.norm(stored_m[:, :, body] - moved_m[:, :, body], axis=2)
            same = ~known.measured(name, trace.ticks)[:, : off_m.shape[1]]
            same |= off_m <= known.column(name).uncertainty + SAME_M
            stored_m[:, :, body][same] = moved_m[:, :, body][same]
    stray = ~np.isclose(stored_m, moved_m, rtol=0.0, atol=SAME_M, equal_nan=True)
    return int(np.argmax(stray.any(axis=(1, 2, 3)))) if stray.any() else None


def follows_unknown(trace: Trace) -> bool:
    """Return whether a hand heads for a TCP that was not measured everywhere and exactly."""
    moves = [move for hand in trace.scenario.hands if isinstance(hand, MovingHand) for move in hand.moves]
    seeks = any(isinstance(move, ReachForTcp | FollowTcp) for move in moves)
    return seeks and trace.known.column("transform_tcp_to_base").limited


def apart_moved_m(trace: Trace) -> NDArray[np.float64]:
    """Return (n,) the error [m] of hands' distances from the arm, by the uncertainty of hands and joints."""
    known, count = trace.known, len(trace.ticks)
    hands, elbows = (known.uncertainty_of(name, count) for name in BODIES)
    return np.maximum(hands, elbows) + known.uncertainty_of(JOINTS[0], count) * float(
        arm_of(trace).reach_m.sum()
    )


def tcp_velocity_moved_mps(trace: Trace) -> NDArray[np.float64]:
    """Return (n,) the error [m/s] of the TCP's velocity at each tick, from the uncertainty of the joints."""
    turned_rad, faster_radps = (trace.known.uncertainty_of(name, len(trace.ticks)) for name in JOINTS)
    rates_radps = np.nan_to_num(true_motion(trace).rates_radps, nan=0.0, posinf=0.0, neginf=0.0)
    return np.asarray(velocity_off(arm_of(trace).reach_m, turned_rad, faster_radps, rates_radps))


def hand_bend_m(trace: Trace, paths: HandPaths, hand: int, *, centre: bool = False) -> NDArray[np.float64]:
    """Return (n-1,) how far [m] ``hand`` or its elbow may leave its chord between two ticks.

    With ``centre``, only the hand's centre counts. A path whose second derivative is at most b leaves its
    chord by at most b dt^2/8. For a hand, b is its acceleration a, including that of its tremor. The elbow
    lies a forearm's length L from the hand, towards a fixed point. For an elbow, b is at most a (1 + L/r) + L
    (4/3)^(1/2) (v/r)^2, if the hand has the speed v and stays r away from that point. However the forearm
    turns, its axis stays within L of the hand's centre. So a distance is wrong by at most L plus the
    forearm's radius less the hand's, beyond the error by the hand's bend. If corners divide a tick, dt is the
    time from one corner to the next. A recorded hand and its elbow move straight from corner to corner.
    """
    scenario = trace.scenario
    trajectory, period_s = scenario.hands[hand], scenario.settings.clock.control_period_s
    if isinstance(trajectory, RecordedHand):
        return np.zeros(len(paths.moving))
    leader = scenario.leader(trajectory)
    if leader is None:
        return np.full(len(paths.moving), np.inf)
    if isinstance(leader, RecordedHand):
        fastest, hardest = leader.motion.max_speed_mps, 0.0
    else:
        fastest, hardest = leader.max_speed_mps, leader.max_acceleration_mps2
        if leader.tremor:
            fastest += leader.tremor.max_speed_mps
            hardest += leader.tremor.max_acceleration_mps2
    towards, size = np.array(trajectory.elbow_towards_in_base_m), scenario.settings.hand
    length_m = 0.0 if centre else size.forearm_length_m
    return _hand_bends(
        paths.positions_in_base_m[:, hand, 0],
        towards,
        paths.moving[:, hand],
        paths.parts[:, hand],
        fastest,
        hardest,
        length_m,
        0.0 if centre else max(length_m + size.forearm_radius_m - size.radius_m, 0.0),
        period_s,
    )


@compiled
def _hand_bends(
    hand_m: NDArray[np.float64],  # (n, 3)
    towards_m: NDArray[np.float64],  # (3,) the point that the elbow is towards
    moving: NDArray[np.bool_],  # (n - 1,)
    parts: NDArray[np.int64],  # (n - 1,)
    fastest_mps: float,
    hardest_mps2: float,
    length_m: float,
    turned_m: float,
    period_s: float,
) -> NDArray[np.float64]:
    """Return (n-1,) b dt^2/8 [m] with b = a (1 + L/r) + L (4/3)^(1/2) (v/r)^2, as for ``hand_bend_m``.

    dt is the period divided by the parts. ``turned_m`` plus the hand's bend is a bound for an elbow that
    turns anywhere.
    """
    bends, speed_after = np.zeros(moving.shape[0]), np.nan
    for k in range(hand_m.shape[0]):
        total = 0.0
        for i in range(3):
            total += (hand_m[k, i] - towards_m[i]) ** 2
        speed_before, speed_after = speed_after, sqrt(total)
        if k == 0 or not moving[k - 1]:
            continue
        nearest = max(min(speed_before, speed_after) - 0.5 * fastest_mps * period_s, 1e-9)
        elbow = hardest_mps2 * (1.0 + length_m / nearest)
        elbow += length_m * sqrt(4.0 / 3.0) * (fastest_mps / nearest) ** 2
        part_s = period_s / parts[k - 1]
        bends[k - 1] = min(elbow * part_s**2 / 8.0, hardest_mps2 * part_s**2 / 8.0 + turned_m)
    return bends


@compiled
def _follow(
    hands: NDArray[np.void],  # (slots,) HAND at the start
    moves: NDArray[np.void],  # (m,) MOVE
    samples: NDArray[np.float64],  # (s, 7)
    tcp_in_base_m: NDArray[np.float64],  # (n, 3)
    period_s: float,
    positions: NDArray[np.float64],  # (n, hands, 2, 3), written
    moving: NDArray[np.bool_],  # (n - 1, hands), written
    corner_hand: NDArray[np.int64],  # (c,), written, as the next two
    corner_at: NDArray[np.float64],  # (c,)
    corners: NDArray[np.float64],  # (c, 2, 3)
    parts: NDArray[np.int64],  # (n - 1, hands) wanted; 1 is written where the way is not known in parts
) -> int:
    """Write ``positions`` at the ticks and ``corners`` between them, and return the number of corners."""
    count = 0
    hands_before, even = hands.copy(), np.zeros(positions.shape[1], np.bool_)
    for k in range(positions.shape[0]):
        for i in range(positions.shape[1]):
            for j in range(3):
                positions[k, i, 0, j] = hands[i].position_in_base_m[j]
                positions[k, i, 1, j] = hands[i].elbow_in_base_m[j]
        if k == positions.shape[0] - 1:
            break
        for i in range(positions.shape[1]):
            leader = hands[i].leader if hands[i].leader >= 0 else i
            if not hands[leader].recorded:
                continue
            row = hands[leader].first + hands[leader].current + 1
            while row < hands[leader].first + hands[leader].count and samples[row, 0] < (k + 1) * period_s:
                if samples[row, 0] > k * period_s:
                    there = hands[i : i + 1].copy()
                    for j in range(3):
                        there[0].position_in_base_m[j] = samples[row, 1 + j] + there[0].apart_in_base_m[j]
                        there[0].elbow_in_base_m[j] = samples[row, 4 + j]
                    if leader != i:
                        point_forearm(there, 0)
                    corner_hand[count], corner_at[count] = i, samples[row, 0] / period_s
                    for j in range(3):
                        corners[count, 0, j] = there[0].position_in_base_m[j]
                        corners[count, 1, j] = there[0].elbow_in_base_m[j]
                    count += 1
                row += 1
        for i in range(positions.shape[1]):
            hands_before[i] = hands[i]
        finest = 1
        advance_hands(hands, moves, samples, tcp_in_base_m[k], k * period_s, period_s)
        for i in range(positions.shape[1]):
            guide = hands[i].leader if hands[i].leader >= 0 else i
            moves_on = hands[guide].current != hands_before[guide].current or hands[guide].tremor_m > 0.0
            for j in range(3):
                moves_on = moves_on or hands_before[guide].velocity_in_base_mps[j] != 0.0
                moves_on = moves_on or hands[guide].velocity_in_base_mps[j] != 0.0
                moves_on = (
                    moves_on
                    or hands[guide].position_in_base_m[j] != hands_before[guide].position_in_base_m[j]
                )
            moving[k, i] = moves_on
            even[i] = _evenly(hands_before[guide], hands[guide], period_s)
            heads = not even[i] and _heads_for_tcp(hands_before[guide], hands[guide], moves)
            if not moves_on or heads or hands[guide].recorded:
                parts[k, i] = 1  # it rests, or its way is known only at the ticks
            finest = max(finest, parts[k, i])
        for part in range(1, finest):
            there, gone_s = hands_before.copy(), part * period_s / finest
            advance_hands(there, moves, samples, tcp_in_base_m[k], k * period_s, gone_s)
            for i in range(positions.shape[1]):
                for j in range(3):
                    if there[i].leader >= 0:
                        leader_m = there[there[i].leader].position_in_base_m[j]
                        there[i].position_in_base_m[j] = leader_m + there[i].apart_in_base_m[j]
                    elif even[i]:
                        mps = hands_before[i].velocity_in_base_mps[j]
                        mps += 0.5 * (hands[i].velocity_in_base_mps[j] - mps) * gone_s / period_s
                        trembles = there[i].position_in_base_m[j] - there[i].steady_in_base_m[j]
                        there[i].position_in_base_m[j] = (
                            hands_before[i].steady_in_base_m[j] + mps * gone_s + trembles
                        )
                if parts[k, i] > 1:
                    point_forearm(there, i)
                    corner_hand[count], corner_at[count] = i, k + part / parts[k, i]
                    for j in range(3):
                        corners[count, 0, j] = there[i].position_in_base_m[j]
                        corners[count, 1, j] = there[i].elbow_in_base_m[j]
                    count += 1
    return count


@njit_no_nrt
def _evenly(earlier: Any, later: Any, period_s: float) -> bool:
    """Return whether a hand's velocity changes evenly between two ticks."""
    even = True
    for j in range(3):
        mean_mps = 0.5 * (earlier.velocity_in_base_mps[j] + later.velocity_in_base_mps[j])
        way_m = later.steady_in_base_m[j] - earlier.steady_in_base_m[j]
        even = even and abs(way_m - mean_mps * period_s) < 1e-12
    return even


@njit_no_nrt
def _heads_for_tcp(earlier: Any, later: Any, moves: Any) -> bool:
    """Return whether a hand heads for the TCP between two ticks, so that its way is known at ticks alone."""
    heads = False
    for row in range(earlier.current, min(later.current + 1, later.count)):
        heads = heads or moves[earlier.first + row].kind >= REACH_FOR_TCP
    return heads


def refuse_contradictions(trace: Trace, file: Path | None = None) -> None:
    """Raise TraceError with ``file``, field and tick if no run can have written ``trace``."""
    problem = first_inconsistency(trace) or first_untruth(trace)
    if problem is not None:
        where = problem.where if file is not None else f"trace of {trace.scenario.name}: {problem.where}"
        raise TraceError(place=Place(file=file, field=where), expected=problem.expected, got=problem.got)


def first_untruth(trace: Trace) -> Inconsistency | None:
    """Return the first field and tick whose value does not follow from the tick's joints and hands.

    A NaN must follow from a NaN of joints or hands, and each property decides whether it can judge that.
    Measured values are compared to within their uncertainty, and no others. Of several fields, the first in
    order is reported, at its first tick.
    """
    recomputed, known = derived(trace), trace.known
    for name, inputs in DERIVED.items():
        stored, true = trace.ticks[name], recomputed[name]
        alike = (-1, *[1] * (stored.ndim - 1))
        tolerance = TOLERANCE + (0.0 if known.whole else _moved(trace, name).reshape(alike))
        same = np.isclose(stored, true, rtol=0.0, atol=tolerance, equal_nan=True)
        for column in () if known.whole else (name, *inputs):
            measured = known.measured(column, trace.ticks)
            same |= ~measured.reshape(*measured.shape, *[1] * (stored.ndim - measured.ndim))
        for untruth in at_first(~same, name, "tick", "what joints and hands give", stored):
            return untruth
    part, parts = trace.ticks["hand_distance_capsule"], len(capsules_of(trace).names)
    too_large = (part >= parts) & known.measured("hand_distance_capsule", trace.ticks)
    for untruth in at_first(too_large, "hand_distance_capsule", "tick", f"one of {parts} parts", part):
        return untruth
    stray = first_stray(trace) if len(trace.ticks) else None
    if stray is None:
        return None
    hands = trace.ticks["hand_position_in_base_m"][stray]
    expected = "hands and elbows where the scenario moves them"
    return Inconsistency("hand_position_in_base_m", "tick", stray, expected, str(hands.tolist()))


def _moved(trace: Trace, name: str) -> NDArray[np.float64]:
    """Return (n,) the largest error of the derived field ``name`` by the uncertainty of all its columns."""
    error = trace.known.uncertainty_of(name, len(trace.ticks))
    if name == "tcp_speed_mps":
        return error + tcp_velocity_moved_mps(trace)
    if name == "hand_distance_m":
        return error + apart_moved_m(trace)
    turned_rad = trace.known.uncertainty_of(JOINTS[0], len(trace.ticks))
    return error + turned_rad * (
        float(arm_of(trace).reach_m.sum()) + 6.0
    )  # an entry of a rotation: 6 at most


def derived(trace: Trace) -> NDArray[np.void]:
    """Return (n,) ticks whose derived fields are computed again from joints and hands."""
    capsules = capsules_of(trace)
    ticks = np.zeros(len(trace.ticks), trace.ticks.dtype)
    _derive(
        arm_record(arm_model(trace.scenario.robot), trace.scenario.settings),
        capsules.records,
        np.empty((len(capsules.names), 2, 3)),
        np.zeros(trace.ticks["hand_present"].shape[1], HAND),
        as_compiled(trace.ticks.copy()),  # compiled code takes no array that is read-only
        as_compiled(ticks),
    )
    return ticks


@compiled
def _derive(
    arms: NDArray[np.void],  # (1,) ARM
    capsules: NDArray[np.void],  # (n,) CAPSULE
    capsule_endpoints_in_base_m: NDArray[np.float64],  # (n, 2, 3), overwritten
    hands: NDArray[np.void],  # (slots,) HAND, overwritten
    stored: NDArray[np.void],  # (n,) ``as_compiled``
    derived: NDArray[np.void],  # (n,) ``as_compiled``, its truth written
) -> None:
    """Write the fields of every tick of ``derived`` that follow from its joints and hands."""
    for k in range(stored.shape[0]):
        tick = stored[k]
        for i in range(hands.shape[0]):
            hands[i].present = tick.hand_present[i] != 0
            for j in range(3):
                hands[i].position_in_base_m[j] = tick.hand_position_in_base_m[i, j]
                hands[i].elbow_in_base_m[j] = tick.elbow_position_in_base_m[i, j]
        fill_truth(
            arms,
            derived[k : k + 1],
            hands,
            capsules,
            capsule_endpoints_in_base_m,
            tick.joint_position_rad,
            tick.joint_velocity_radps,
            tick.time_s,
        )
