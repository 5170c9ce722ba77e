"""Provide the true motion of arm and hands in a trace, at the ticks and between them.

A trace stores the positions of hands only at the ticks. Between two ticks, this module computes the hands'
positions again from the scenario's moves. A recorded hand may change its direction at a sample between two
ticks. The straight line between the ticks misses this corner by up to half of the distance of a tick (8 mm at
2 m/s and 8 ms). Other hands have bounded accelerations, so their paths have no corners, but deviate from
straight lines. ``finer_paths`` divides each tick into parts, which makes this deviation smaller.

The module also checks that poses, speeds and distances of a trace follow from its joints and hands.
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

# A choice: the tolerance of distances between two instants, a tenth of a millimetre.
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

    Each array is computed on first use, so that a property reads only the columns that it states. The arrays
    are contiguous copies, because separate machine code would have to be compiled for strided arrays.
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
        """The positions of hand and elbow, shape (n, hands, 2, 3)."""
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
        """The least distance of a present hand from surface to surface, shape (n,).

        It is infinite if no hand is present.
        """
        distance_m = np.where(self.present, self._ticks["hand_distance_m"], np.inf)
        nearest: NDArray[np.float64] = np.array(distance_m, order="F").min(axis=1)
        return nearest


@once_a_trace
def true_motion(trace: Trace) -> TrueMotion:
    """Return the true motion of arm and hands in a trace."""
    return TrueMotion(trace.ticks)


@once_a_trace
def nearest_hand_m(trace: Trace) -> NDArray[np.float64]:
    """Return the distance of the nearest true hand's centre from the TCP, shape (n,).

    It is infinite if no hand is present.
    """
    true = true_motion(trace)
    apart_m = np.linalg.norm(np.ascontiguousarray(true.hands_m[:, :, 0]) - true.tcp_m[:, None], axis=2)
    return np.asarray(np.where(true.present, apart_m, np.inf).min(axis=1))


@once_a_trace
def capsules_of(trace: Trace) -> CapsuleSet:
    """Return the capsules of the trace's arm and camera."""
    return cell_capsules(arm_capsules(trace.scenario.robot), trace.scenario.settings)


@once_a_trace
def arm_of(trace: Trace) -> Arm:
    """Return the arm of a trace for compiled code, with the capsules of arm and camera."""
    return arm_with(arm_model(trace.scenario.robot), capsules_of(trace))


def tcp_of(trace: Trace) -> Arm:
    """Return the arm of a trace for compiled code, reduced to its TCP."""
    return tcp_alone(arm_model(trace.scenario.robot))


@dataclass(frozen=True, eq=False)
class HandPaths:
    """The paths of the scenario's hands, for the arm's true motion.

    ``positions_in_base_m`` (n, hands, 2, 3) has the positions of hand and elbow at each tick. ``moving``
    (n-1, hands) is False if a hand rests from a tick to the next. ``corner_hand`` (m,) is the hand to which
    each corner belongs. ``corner_at`` (m,) is the time of each corner in ticks. For example, 3.25 is a
    quarter of the way from tick 3 to tick 4. The times increase for each hand. ``corners_in_base_m``
    (m, 2, 3) has the positions of hand and elbow at each corner. ``parts`` (n-1, hands) is the number of
    parts into which each tick is divided, for hands with moves. ``resolution_m`` is the resolution of the
    search for the least distance between two instants.
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
    """Return the hands' paths, computed again from their moves.

    Hands that head for the TCP follow the TCP in the trace.
    """
    return _paths(trace, 1)


@once_a_trace
def finer_paths(trace: Trace) -> HandPaths:
    """Return the hands' paths with each tick divided into PARTS, which gives closer bounds."""
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
    """Return the first tick at which a hand or an elbow deviates from the motion in the scenario.

    The result is None if there is no such tick. Only measured positions are compared, and differences within
    their uncertainty are allowed. If a hand heads for the TCP and the TCP's position is not completely known,
    the function compares no hand.
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
    """Return whether a hand heads for the TCP although the TCP was not measured exactly at all ticks."""
    moves = [move for hand in trace.scenario.hands if isinstance(hand, MovingHand) for move in hand.moves]
    seeks = any(isinstance(move, ReachForTcp | FollowTcp) for move in moves)
    return seeks and trace.known.column("transform_tcp_to_base").limited


def apart_moved_m(trace: Trace) -> NDArray[np.float64]:
    """Return the error [m] of the hands' distances from the arm, shape (n,).

    It follows from the uncertainty of hands and joints.
    """
    known, count = trace.known, len(trace.ticks)
    hands, elbows = (known.uncertainty_of(name, count) for name in BODIES)
    return np.maximum(hands, elbows) + known.uncertainty_of(JOINTS[0], count) * float(
        arm_of(trace).reach_m.sum()
    )


def tcp_velocity_moved_mps(trace: Trace) -> NDArray[np.float64]:
    """Return the error [m/s] of the TCP's velocity at each tick, shape (n,).

    It follows from the uncertainty of the joints' positions and speeds.
    """
    turned_rad, faster_radps = (trace.known.uncertainty_of(name, len(trace.ticks)) for name in JOINTS)
    rates_radps = np.nan_to_num(true_motion(trace).rates_radps, nan=0.0, posinf=0.0, neginf=0.0)
    return np.asarray(velocity_off(arm_of(trace).reach_m, turned_rad, faster_radps, rates_radps))


def hand_bend_m(trace: Trace, paths: HandPaths, hand: int, *, centre: bool = False) -> NDArray[np.float64]:
    """Return how far [m] ``hand`` or its elbow may deviate from a straight line between ticks, (n-1,).

    If ``centre`` is True, only the hand's centre is considered. A path whose second derivative is at most b
    deviates from its chord by at most b dt^2/8. For a hand, b is its acceleration a, which includes the
    acceleration of its tremor. The distance between the elbow and the hand is L, the length of a forearm. It
    lies on the line from the hand to a fixed point. For an elbow, b is at most a (1 + L/r) + L (4/3)^(1/2)
    (v/r)^2. Here v is the hand's speed, and r is the hand's least distance from the fixed point. The
    forearm's axis stays within L of the hand's centre, however the forearm turns. So the distance error from
    the elbow exceeds the deviation of the hand by at most L + r_f - r_h, with the radii r_f of the forearm
    and r_h of the hand. If corners divide a tick, dt is the time from one corner to the next. A recorded hand
    and its elbow move straight from corner to corner.
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
    """Return the deviation [m] b dt^2/8, shape (n-1,).

    The bound b is a (1 + L/r) + L (4/3)^(1/2) (v/r)^2. The symbols are those of ``hand_bend_m``. Here dt is
    the period divided by the parts. The result is at most ``turned_m`` plus the hand's deviation, which is a
    bound for any motion of the elbow.
    """
    bends, distance_after = np.zeros(moving.shape[0]), np.nan
    for k in range(hand_m.shape[0]):
        total = 0.0
        for i in range(3):
            total += (hand_m[k, i] - towards_m[i]) ** 2
        # The distances from the fixed point at two successive ticks.
        distance_before, distance_after = distance_after, sqrt(total)
        if k == 0 or not moving[k - 1]:
            continue
        # Within the period the hand can come nearer by at most half its way. 1e-9 prevents a division by 0.
        nearest = max(min(distance_before, distance_after) - 0.5 * fastest_mps * period_s, 1e-9)
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
    """Write the hands' positions at the ticks into ``positions``.

    The positions at the corners between the ticks are written into ``corners``. The result is the number of
    corners.
    """
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
            # A recorded path bends at its samples, so each sample between the ticks is a corner.
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
        # Advance copies from the beginning of the tick, so that the positions at the ticks remain those of
        # the simulation.
        for part in range(1, finest):
            there, gone_s = hands_before.copy(), part * period_s / finest
            advance_hands(there, moves, samples, tcp_in_base_m[k], k * period_s, gone_s)
            for i in range(positions.shape[1]):
                for j in range(3):
                    if there[i].leader >= 0:
                        leader_m = there[there[i].leader].position_in_base_m[j]
                        there[i].position_in_base_m[j] = leader_m + there[i].apart_in_base_m[j]
                    # At a constant acceleration, the position within the tick has a closed form.
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
    """Return whether a hand's velocity changes at a constant rate between two ticks."""
    even = True
    for j in range(3):
        mean_mps = 0.5 * (earlier.velocity_in_base_mps[j] + later.velocity_in_base_mps[j])
        way_m = later.steady_in_base_m[j] - earlier.steady_in_base_m[j]
        even = even and abs(way_m - mean_mps * period_s) < 1e-12
    return even


@njit_no_nrt
def _heads_for_tcp(earlier: Any, later: Any, moves: Any) -> bool:
    """Return whether a hand heads for the TCP between two ticks.

    Its path is then known only at the ticks.
    """
    heads = False
    for row in range(earlier.current, min(later.current + 1, later.count)):
        heads = heads or moves[earlier.first + row].kind >= REACH_FOR_TCP
    return heads


def refuse_contradictions(trace: Trace, file: Path | None = None) -> None:
    """Raise TraceError if no run can have written ``trace``.

    The error states ``file``, the field and the tick.
    """
    problem = first_inconsistency(trace) or first_untruth(trace)
    if problem is not None:
        where = problem.where if file is not None else f"trace of {trace.scenario.name}: {problem.where}"
        raise TraceError(place=Place(file=file, field=where), expected=problem.expected, got=problem.got)


def first_untruth(trace: Trace) -> Inconsistency | None:
    """Return the first stored field that contradicts the joints and hands.

    The tick of the contradiction is part of the result. A NaN is accepted if the joints or hands have a NaN.
    Each property decides whether it can judge such values. Only measured values are compared, and differences
    within their uncertainty are allowed. If several fields are wrong, the function reports the field that
    comes first in ``DERIVED``, at the first tick at which this field is wrong.
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
    """Return the largest error of the derived field ``name`` at each tick, shape (n,).

    It follows from the uncertainty of all columns that determine the field.
    """
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
    """Return ticks (n,) with derived fields.

    The fields are computed again from the joints and the hands.
    """
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
    """Compute the derived fields of every tick from its joints and hands, and write them into ``derived``."""
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
