"""What many properties ask of the same trace: where arm and hands truly were, at the ticks and between.

At a tick a trace says where a hand is.  Between two the scenario's own moves are followed again.  Within
a tick a recorded hand may have turned, at a sample: on the chord from tick to tick such a corner is lost,
by up to half the way of a tick (8 mm at 2 m/s and 8 ms).  Other hands have no corners, as their
acceleration is bounded, but leave the chord by what that bound lets them.

And whether a trace's truth agrees with itself: poses, speeds and distances follow from joints and hands.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from safety_harness.compiled import compiled
from safety_harness.exceptions import Place, TraceError
from safety_harness.robot.capsules import Arm, CapsuleSet, arm_with, load_capsules
from safety_harness.robot.description import load_arm
from safety_harness.scenario.model import MAX_HANDS, RecordedHand
from safety_harness.simulation.hand_motion import HAND, advance_hands, point_forearm
from safety_harness.simulation.hand_programs import hands_at_start
from safety_harness.simulation.truth import arm_record, cell_capsules, fill_truth
from safety_harness.trace.consistency import Inconsistency, at_first, first_inconsistency
from safety_harness.trace.records import COLUMNS, TICK, TICK_COMPILED, as_numbers
from safety_harness.trace.trace import Trace, history, once_a_trace

HANDS, ELBOWS = COLUMNS["hand_position_in_base_m"], COLUMNS["elbow_position_in_base_m"]
SAME_M = 1e-6  # a hand this far from where the scenario moves it is another hand
DERIVED = ("transform_tcp_to_base", "tcp_speed_mps", "hand_distance_m")
TOLERANCE = 1e-9  # metres, metres a second and entries of rotations: another machine's last digits
assert HANDS.stop == ELBOWS.start


@dataclass(frozen=True, eq=False)
class TrueMotion:
    """Of each of n ticks; positions in the base frame [m].  The arrays are read-only.

    ``joints_rad`` and ``rates_radps`` (n, 6), ``tcp_m`` (n, 3), ``hands_m`` (n, hands, 2, 3): hand and
    elbow, ``present`` (n, hands), ``nearest_m`` (n,): the least hand distance, surface to surface.
    """

    joints_rad: NDArray[np.float64]
    rates_radps: NDArray[np.float64]
    tcp_m: NDArray[np.float64]
    hands_m: NDArray[np.float64]
    present: NDArray[np.bool_]
    nearest_m: NDArray[np.float64]


@once_a_trace
def true_motion(trace: Trace) -> TrueMotion:
    """The true motion of arm and hands in a trace: views of its ticks, for copies would take longer."""
    ticks = trace.ticks
    hands_and_elbows = as_numbers(ticks)[:, HANDS.start : ELBOWS.stop].reshape(-1, 2, MAX_HANDS, 3)
    return TrueMotion(
        joints_rad=ticks["joint_position_rad"],
        rates_radps=ticks["joint_velocity_radps"],
        tcp_m=ticks["transform_tcp_to_base"][:, :3, 3],
        hands_m=hands_and_elbows.transpose(0, 2, 1, 3),
        present=ticks["hand_present"],
        nearest_m=history(trace, "hand_distance_m").min(axis=1),
    )


@once_a_trace
def nearest_hand_m(trace: Trace) -> NDArray[np.float64]:
    """(n,) distance of the nearest true hand's centre from the TCP; infinite without one."""
    true = true_motion(trace)
    return _nearest_m(true.tcp_m, true.hands_m, true.present)


@compiled
def _nearest_m(
    tcp_m: NDArray[np.float64],  # (n, 3)
    hands_m: NDArray[np.float64],  # (n, hands, 2, 3)
    present: NDArray[np.bool_],  # (n, hands)
) -> NDArray[np.float64]:
    """(n,) least over the hands that are there of |hand - tcp| [m]; NaN if one is."""
    nearest = np.full(tcp_m.shape[0], np.inf)
    for k in range(tcp_m.shape[0]):
        for hand in range(present.shape[1]):
            if not present[k, hand]:
                continue
            total = 0.0
            for i in range(3):
                total += (hands_m[k, hand, 0, i] - tcp_m[k, i]) ** 2
            if not sqrt(total) >= nearest[k]:
                nearest[k] = sqrt(total)
            if np.isnan(total):
                break
    return nearest


@once_a_trace
def capsules_of(trace: Trace) -> CapsuleSet:
    """The arm's and the camera's."""
    return cell_capsules(load_capsules(trace.scenario.robot.arm_name), trace.scenario.settings)


@once_a_trace
def arm_of(trace: Trace) -> Arm:
    """The arm of a trace with its capsules and the camera's, for compiled code."""
    return arm_with(load_arm(trace.scenario.robot.arm_name), capsules_of(trace))


@dataclass(frozen=True, eq=False)
class HandPaths:
    """What the scenario's hands do along the arm's true way.

    ``positions_in_base_m`` (n, hands, 2, 3): hand and elbow at each tick.  ``moving`` (n-1, hands):
    False where a hand rests from one tick to the next.  ``corner_hand`` and ``corner_at`` (m,):
    whose corner, and when, in ticks (3.25: a quarter of the way from tick 3 to 4), rising for each
    hand; ``corners_in_base_m`` (m, 2, 3): hand and elbow there.
    """

    positions_in_base_m: NDArray[np.float64]
    moving: NDArray[np.bool_]
    corner_hand: NDArray[np.int64]
    corner_at: NDArray[np.float64]
    corners_in_base_m: NDArray[np.float64]


@once_a_trace
def hand_paths(trace: Trace) -> HandPaths:
    """Follow the moves again; hands that head for the TCP see the trace's."""
    scenario, count = trace.scenario, len(trace.ticks)
    hands = hands_at_start(scenario)
    most = len(scenario.hands) * len(hands.samples) + 1
    positions = np.zeros((count, len(scenario.hands), 2, 3))
    moving = np.zeros((max(count - 1, 0), len(scenario.hands)), np.bool_)
    whose, at, corners = np.zeros(most, np.int64), np.zeros(most), np.zeros((most, 2, 3))
    found = _follow(
        hands.state,
        hands.moves,
        hands.samples,
        true_motion(trace).tcp_m,
        scenario.settings.clock.control_period_s,
        positions,
        moving,
        whose,
        at,
        corners,
    )
    return HandPaths(positions, moving, whose[:found], at[:found], corners[:found])


def first_stray(trace: Trace, paths: HandPaths) -> int | None:
    """The first tick at which a hand or elbow of the trace is not where its scenario moves it."""
    stray = _first_stray(true_motion(trace).hands_m, paths.positions_in_base_m)
    return stray if stray >= 0 else None


def hand_bend_m(trace: Trace, paths: HandPaths, hand: int) -> NDArray[np.float64]:
    """(n-1,) how far a hand or its elbow may leave its chord within each tick.

    A way whose second derivative is at most b leaves its chord by at most b dt^2/8.  For a hand that
    is its acceleration a, its tremor's included.  The elbow is a forearm's length L from the hand
    towards a fixed point; at the speed v, at least r away from that point, b is at most
    a (1 + L/r) + L (4/3)^(1/2) (v/r)^2.  A recorded hand, and its recorded elbow, go straight from
    corner to corner.
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
        hardest += leader.tremor.max_acceleration_mps2 if leader.tremor else 0.0
    towards = np.array(trajectory.elbow_towards_in_base_m)
    return _hand_bends(
        true_motion(trace).hands_m[:, hand, 0],
        towards,
        paths.moving[:, hand],
        fastest,
        hardest,
        scenario.settings.hand.forearm_length_m,
        period_s,
    )


@compiled
def _hand_bends(
    hand_m: NDArray[np.float64],  # (n, 3)
    towards_m: NDArray[np.float64],  # (3,) the point that the elbow is towards
    moving: NDArray[np.bool_],  # (n - 1,)
    fastest_mps: float,
    hardest_mps2: float,
    length_m: float,
    period_s: float,
) -> NDArray[np.float64]:
    """(n-1,) b dt^2/8 [m] with b = a (1 + L/r) + L (4/3)^(1/2) (v/r)^2, as ``hand_bend_m`` has it."""
    bends, after = np.zeros(moving.shape[0]), np.nan
    for k in range(hand_m.shape[0]):
        total = 0.0
        for i in range(3):
            total += (hand_m[k, i] - towards_m[i]) ** 2
        before, after = after, sqrt(total)
        if k == 0 or not moving[k - 1]:
            continue
        nearest = max(min(before, after) - fastest_mps * period_s, 1e-9)
        elbow = hardest_mps2 * (1.0 + length_m / nearest)
        elbow += length_m * sqrt(4.0 / 3.0) * (fastest_mps / nearest) ** 2
        # an elbow is never farther from where it was than the hand's way and twice the forearm
        bends[k - 1] = min(elbow * period_s**2 / 8.0, fastest_mps * period_s + 2.0 * length_m)
    return bends


@compiled
def _first_stray(
    stored_m: NDArray[np.float64],  # (n, hands or more, 2, 3)
    moved_m: NDArray[np.float64],  # (n, hands, 2, 3)
) -> int:
    """The first row in which two positions are not the same, NaN or not, or -1."""
    for k in range(moved_m.shape[0]):
        for hand in range(moved_m.shape[1]):
            for body in range(2):
                for i in range(3):
                    a, b = stored_m[k, hand, body, i], moved_m[k, hand, body, i]
                    same = a == b or abs(a - b) <= SAME_M or (np.isnan(a) and np.isnan(b))
                    if not same:
                        return k
    return -1


@compiled
def _follow(
    hands: NDArray[np.void],  # (MAX_HANDS,) HAND at the start
    moves: NDArray[np.void],  # (m,) MOVE
    samples: NDArray[np.float64],  # (s, 7)
    tcp_in_base_m: NDArray[np.float64],  # (n, 3)
    period_s: float,
    positions: NDArray[np.float64],  # (n, hands, 2, 3), written
    moving: NDArray[np.bool_],  # (n - 1, hands), written
    corner_hand: NDArray[np.int64],  # written, as the next two
    corner_at: NDArray[np.float64],  # (c,)
    corners: NDArray[np.float64],  # (c, 2, 3)
) -> int:
    """Positions at the ticks and corners between them; returns the number of corners.

    ``corner_hand`` (c,), as the next two.
    """
    found = 0
    before = hands.copy()
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
                    corner_hand[found], corner_at[found] = i, samples[row, 0] / period_s
                    for j in range(3):
                        corners[found, 0, j] = there[0].position_in_base_m[j]
                        corners[found, 1, j] = there[0].elbow_in_base_m[j]
                    found += 1
                row += 1
        for i in range(positions.shape[1]):
            before[i] = hands[i]
        advance_hands(hands, moves, samples, tcp_in_base_m[k], k * period_s, period_s)
        for i in range(positions.shape[1]):
            one = hands[i].leader if hands[i].leader >= 0 else i
            moves_on = hands[one].current != before[one].current or hands[one].tremor_m > 0.0
            for j in range(3):
                moves_on = moves_on or before[one].velocity_in_base_mps[j] != 0.0
                moves_on = moves_on or hands[one].velocity_in_base_mps[j] != 0.0
                moves_on = moves_on or hands[one].position_in_base_m[j] != before[one].position_in_base_m[j]
            moving[k, i] = moves_on
    return found


def refuse_contradictions(trace: Trace, file: Path | None = None) -> None:
    """TraceError with field and tick if no run can have written ``trace``; ``file`` is what it names."""
    wrong = first_inconsistency(trace) or first_untruth(trace)
    if wrong is not None:
        where = wrong.where if file is not None else f"trace of {trace.scenario.name}: {wrong.where}"
        raise TraceError(place=Place(file=file, field=where), expected=wrong.expected, got=wrong.got)


def first_untruth(trace: Trace) -> Inconsistency | None:
    """The first tick whose pose, speed or hand distances are not those of its joints and hands.

    What is NaN must be NaN because joints or hands are; whether that can be judged is for the
    properties to say.  The order of the fields counts before that of the ticks.
    """
    settings = trace.scenario.settings
    arm = load_arm(trace.scenario.robot.arm_name)
    capsules = capsules_of(trace)
    derived = np.zeros(len(trace.ticks), TICK)
    _derive(
        arm_record(arm, settings),
        capsules.records,
        np.empty((len(capsules.names), 2, 3)),
        np.zeros(MAX_HANDS, HAND),
        trace.ticks.copy().view(TICK_COMPILED),  # compiled code takes no array that is read-only
        derived.view(TICK_COMPILED),
    )
    for name in DERIVED:
        stored, true = trace.ticks[name], derived[name]
        same = np.isclose(stored, true, rtol=0.0, atol=TOLERANCE, equal_nan=True)
        for found in at_first(~same, name, "tick", "what joints and hands give", stored):
            return found
    part = trace.ticks["hand_distance_capsule"]
    expected = f"one of {len(capsules.names)} parts"
    for found in at_first(part >= len(capsules.names), "hand_distance_capsule", "tick", expected, part):
        return found
    stray = first_stray(trace, hand_paths(trace)) if len(trace.ticks) else None
    if stray is None:
        return None
    hands = trace.ticks["hand_position_in_base_m"][stray]
    expected = "hands and elbows where the scenario moves them"
    return Inconsistency("hand_position_in_base_m", "tick", stray, expected, str(hands.tolist()))


@compiled
def _derive(
    arms: NDArray[np.void],  # (1,) ARM
    capsules: NDArray[np.void],  # (n,) CAPSULE
    capsule_endpoints_in_base_m: NDArray[np.float64],  # (n, 2, 3), overwritten
    hands: NDArray[np.void],  # (MAX_HANDS,) HAND, overwritten
    stored: NDArray[np.void],  # (n,) TICK_COMPILED
    derived: NDArray[np.void],  # (n,) TICK_COMPILED, its truth written
) -> None:
    """The truth of every tick again, from its joints and hands."""
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
