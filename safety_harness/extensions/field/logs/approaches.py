"""Find the moves of hands in a log.

For each approach to the TCP, measure the speed, the acceleration, the start, and the time of rest afterwards.
A hand moves while its mean speed over a tenth of a second is at least 100 mm/s. A path shorter than 50 mm is
not a move, and a rest below 100 ms does not separate two moves. An approach is a move that ends at least 100
mm nearer to the TCP than it began. It also ends at most 600 mm from the TCP.

A separate count is an upper bound on the number of approaches. It includes every motion of at least 100 mm
towards the TCP within a move, even if the hand turns back without a rest. It also includes each move that is
interrupted by a gap. It also includes each gap if the hand is nearer to the TCP after the gap than before it.
The observed time is the time during which the log shows at least one hand.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.elementary import length
from safety_harness.cell.robot.description import ArmModel
from safety_harness.cell.robot.kinematics import links_in_base
from safety_harness.cell.robot.robots import arm_model
from safety_harness.extensions.field.logs.model import CellLog
from safety_harness.extensions.field.logs.streams import NS, LogSamples

Floats = NDArray[np.float64]
WINDOW_S, MOVES_MPS, LEAST_WAY_M, LEAST_STAND_S = 0.1, 0.1, 0.05, 0.1  # these define a move
NEARER_M, NEAR_M = 0.1, 0.6  # these define an approach
SHARE = 0.9  # of the greatest speed, at which the measurement of the acceleration ends


@dataclass(frozen=True, kw_only=True)
class Approach:
    """One approach with its greatest speed and its mean acceleration.

    The mean acceleration is measured until the hand has reached nine tenths of the greatest speed.
    ``start_from_tcp_m`` (3,) is the hand's position relative to the TCP at the start, in the base frame.
    ``end_distance_m`` is the hand's distance from the TCP at the end. ``dwell_s`` is the time for which the
    hand rests after the approach, or None if the log does not show this time. ``pause_s`` is the time for
    which the hand rests before the approach. It is None if the log does not show this time, or if the
    previous move was also an approach.
    """

    speed_mps: float
    acceleration_mps2: float
    start_from_tcp_m: tuple[float, float, float]
    end_distance_m: float
    dwell_s: float | None
    pause_s: float | None


@dataclass(eq=False)
class Watched:
    """The approaches of hands in a log, the numbers of moves and of gaps, and the observed time.

    ``counted`` is an upper bound on the number of approaches.
    """

    approaches: list[Approach] = field(default_factory=list)
    counted: int = 0
    seconds: float = 0.0
    moves: int = 0
    cut: int = 0  # moves whose beginning or end was not seen
    gaps: int = 0
    fastest_mps: float = 0.0  # the largest of the hands' speed limits in the LOG.yaml files

    def add(self, more: Watched) -> None:
        """Add the approaches and counts of another log."""
        self.approaches += more.approaches
        self.counted += more.counted
        self.seconds, self.moves = self.seconds + more.seconds, self.moves + more.moves
        self.cut, self.gaps = self.cut + more.cut, self.gaps + more.gaps
        self.fastest_mps = max(self.fastest_mps, more.fastest_mps)


def approaches_of(log: CellLog) -> Watched:
    """Return the approaches of all hands in ``log``.

    A gap that is longer than allowed divides the log into two pieces, which are searched separately.
    """
    watched, facts = Watched(), log.hand_facts
    if facts is None:
        return watched
    watched.fastest_mps = facts.moves_at_most_mps
    arm, seen_s = arm_model(log.robot), list[tuple[float, float]]()
    for body in log.hands:
        hand = body.hand.measured
        time_s = log.seconds(hand, of_hands=True)
        breaks = np.flatnonzero(np.diff(time_s) > facts.longest_gap_s) + 1
        watched.gaps += len(breaks)
        bounds = [0, *breaks.tolist(), len(time_s)]
        cut_before = True
        for begin, end in pairwise(bounds):
            part = time_s[begin:end]
            cut, cut_after = _piece(watched, part, hand.values[begin:end], log, arm)
            if not (cut_before or cut):  # the gap cut no move, neither where it began nor where it ended
                across = slice(begin - 1, begin + 1)
                watched.counted += _reaches(log, arm, time_s[across], hand.values[across])
            cut_before = cut_after
            seen_s.append((float(max(part[0], 0.0)), float(min(part[-1], log.seconds(log.joints)[-1]))))
    # Several hands may be seen at the same time; their common time counts once.
    until_s = 0.0
    for first_s, last_s in sorted(seen_s):
        watched.seconds += max(last_s - max(first_s, until_s), 0.0)
        until_s = max(until_s, last_s)
    return watched


def _reaches(log: CellLog, arm: ArmModel, time_s: Floats, hand_m: Floats) -> int:
    """Return how often the hand comes nearer to the TCP by at least NEARER_M and ends within NEAR_M of it.

    The hand is at ``hand_m`` (n, 3) at the times ``time_s`` (n,).
    """
    tcp_m = np.array([_tcp_m(log, arm, at_s) for at_s in time_s.tolist()])
    count, away, least_m, most_m = 0, True, np.inf, -np.inf
    for distance_m in np.linalg.norm(hand_m - tcp_m, axis=1).tolist():
        most_m, least_m = max(most_m, distance_m), min(least_m, distance_m)
        if away and distance_m <= min(most_m - NEARER_M, NEAR_M):
            count, away, least_m = count + 1, False, distance_m
        elif not away and distance_m >= least_m + NEARER_M:
            away, most_m = True, distance_m
    return count


def _piece(seen: Watched, time_s: Floats, hand_m: Floats, log: CellLog, arm: ArmModel) -> tuple[bool, bool]:
    """Find the moves in one piece of the log that has no gaps, and add them to ``seen``.

    In this piece, the hand is at ``hand_m`` (n, 3) at the times ``time_s`` (n,). Return whether the piece
    begins during a move, and whether it ends during a move.
    """
    inside = (time_s >= 0.0) & (time_s <= log.seconds(log.joints)[-1])
    time_s, hand_m = time_s[inside], hand_m[inside]
    if len(time_s) < 3 or time_s[-1] - time_s[0] < 3.0 * WINDOW_S:
        moved = bool(np.linalg.norm(np.diff(hand_m, axis=0), axis=1).sum() >= LEAST_WAY_M)
        seen.cut, seen.counted = seen.cut + moved, seen.counted + moved
        return moved, moved
    speed_mps = _speed(time_s, hand_m)
    stood_s: float | None = None
    cuts = False, False
    for first, last, dwell_s, whole in _moves(time_s, hand_m, speed_mps):
        seen.moves += 1
        cuts = cuts[0] or first == 0, last == len(time_s) - 1
        path = slice(first, last + 1)
        # A move whose end was not seen may have been a reach, so count it.
        seen.counted += max(_reaches(log, arm, time_s[path], hand_m[path]), not whole)
        stood_before_s, stood_s = stood_s, dwell_s
        if not whole:
            seen.cut += 1
            continue
        tcp_m = [_tcp_m(log, arm, float(time_s[k])) for k in (first, last)]
        from_m, to_m = hand_m[first] - tcp_m[0], hand_m[last] - tcp_m[1]
        nearer_m = float(length(from_m) - length(to_m))
        if nearer_m < NEARER_M or length(to_m) > NEAR_M:
            continue
        peak = float(speed_mps[first : last + 1].max())
        # The mean acceleration until a fraction of the peak speed, because it falls to zero towards the peak.
        fast = first + int(np.argmax(speed_mps[first : last + 1] >= SHARE * peak))
        rise_s = max(float(time_s[fast] - time_s[first]), float(np.diff(time_s).min()))
        seen.approaches.append(
            Approach(
                speed_mps=peak,
                acceleration_mps2=(SHARE * peak - float(speed_mps[first])) / rise_s,
                start_from_tcp_m=(float(from_m[0]), float(from_m[1]), float(from_m[2])),
                end_distance_m=float(length(to_m)),
                dwell_s=dwell_s,
                pause_s=stood_before_s,
            )
        )
        stood_s = None
    return cuts


def _speed(time_s: Floats, hand_m: Floats) -> Floats:
    """Return the mean speed in a window around each sample, shape (n,).

    At the ends of the piece, the part of the window that lies outside the piece is omitted.
    """
    ends = [
        np.column_stack([np.interp(at, time_s, column) for column in hand_m.T])
        for at in (
            np.maximum(time_s - WINDOW_S / 2.0, time_s[0]),
            np.minimum(time_s + WINDOW_S / 2.0, time_s[-1]),
        )
    ]
    lasted_s = np.minimum(time_s + WINDOW_S / 2.0, time_s[-1]) - np.maximum(
        time_s - WINDOW_S / 2.0, time_s[0]
    )
    return np.asarray(np.linalg.norm(ends[1] - ends[0], axis=1) / lasted_s)


def _moves(time_s: Floats, hand_m: Floats, speed_mps: Floats) -> list[tuple[int, int, float | None, bool]]:
    """Return four values for each move.

    They are the index of the first sample, the index of the last sample, the time of rest afterwards [s], and
    whether the log shows the whole move. The time of rest is None if the log does not show it.
    """
    state = np.concatenate([[False], speed_mps >= MOVES_MPS, [False]])
    change = np.diff(state.astype(np.int8))
    spans = list(
        zip(np.flatnonzero(change == 1).tolist(), (np.flatnonzero(change == -1) - 1).tolist(), strict=True)
    )
    joined: list[tuple[int, int]] = []
    for first, last in spans:
        # A pause that is too short to be a stand belongs to the move.
        if joined and time_s[first] - time_s[joined[-1][1]] < LEAST_STAND_S:
            joined[-1] = joined[-1][0], last
        else:
            joined.append((first, last))
    far = [
        (first, last)
        for first, last in joined
        if np.linalg.norm(np.diff(hand_m[first : last + 1], axis=0), axis=1).sum() >= LEAST_WAY_M
    ]
    moves = []
    for number, (first, last) in enumerate(far):
        whole = first > 0 and last < len(time_s) - 1
        followed = number + 1 < len(far)
        dwell_s = float(time_s[far[number + 1][0]] - time_s[last]) if followed else None
        moves.append((first, last, dwell_s, whole))
    return moves


def _tcp_m(log: CellLog, arm: ArmModel, time_s: float) -> Floats:
    """Return the position (3,) of the TCP in the base frame at ``time_s``."""
    joints: LogSamples = log.joints
    at_s, count = (joints.time_ns - log.origin_ns) / NS, len(arm.joint_names)
    q = np.array([np.interp(time_s, at_s, column) for column in joints.values.T[:count]])
    return np.asarray(links_in_base(arm, q)[-1][:3, 3])
