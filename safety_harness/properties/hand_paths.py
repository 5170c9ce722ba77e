"""Where the hands are between two ticks: the scenario's own moves, followed again along a trace.

At a tick a trace says where a hand is.  Within one it may have turned: it has touched and withdraws,
a move has ended, a recording has a sample.  On the chord from tick to tick such a corner is lost,
by up to half the way of a tick (8 mm at 2 m/s and 8 ms).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from safety_harness.compiled import compiled
from safety_harness.scenario.model import MovingHand
from safety_harness.simulation.hand_motion import (
    advance_hands,
    advance_move,
    hands_at_start,
    point_forearm,
)
from safety_harness.trace.trace import Trace

SAME_M = 1e-6  # a hand this far from where the scenario moves it is another hand


@dataclass(frozen=True, eq=False)
class HandPaths:
    """What the scenario's hands do along the arm's true way.

    ``positions_in_base_m`` (n, hands, 2, 3): hand and elbow at each tick.  ``corner_hand`` and
    ``corner_at`` (m,): whose corner, and when, in ticks (3.25: a quarter of the way from tick 3 to
    4), rising for each hand; ``corners_in_base_m`` (m, 2, 3): hand and elbow there.
    """

    positions_in_base_m: NDArray[np.float64]
    corner_hand: NDArray[np.int64]
    corner_at: NDArray[np.float64]
    corners_in_base_m: NDArray[np.float64]


def hand_paths(trace: Trace) -> HandPaths:
    """Follow the moves again; hands that head for the TCP see the trace's."""
    scenario, count = trace.scenario, len(trace.ticks)
    hands = hands_at_start(scenario.hands, scenario.settings.hand)
    most = int(hands.state["count"].sum()) + 1
    positions = np.zeros((count, len(scenario.hands), 2, 3))
    whose, at, corners = np.zeros(most, np.int64), np.zeros(most), np.zeros((most, 2, 3))
    found = _follow(
        hands.state,
        hands.moves,
        hands.samples,
        np.ascontiguousarray(trace.ticks["transform_tcp_to_base"][:, :3, 3]),
        scenario.settings.clock.control_period_s,
        positions,
        whose,
        at,
        corners,
    )
    return HandPaths(positions, whose[:found], at[:found], corners[:found])


def first_stray(trace: Trace, paths: HandPaths) -> int | None:
    """The first tick at which a hand or elbow of the trace is not where its scenario moves it."""
    hands = len(trace.scenario.hands)
    names = ("hand_position_in_base_m", "elbow_position_in_base_m")
    stored = np.stack([trace.ticks[name][:, :hands] for name in names], axis=2)
    near = np.isclose(stored, paths.positions_in_base_m, rtol=0.0, atol=SAME_M, equal_nan=True)
    strays = np.flatnonzero(~near.all(axis=(1, 2, 3)))
    return int(strays[0]) if len(strays) else None


def elbow_bend_m(trace: Trace, paths: HandPaths, hand: int) -> NDArray[np.float64]:
    """(n-1,) how far an elbow may leave its chord within each tick.

    The elbow is a forearm's length L from the hand towards a fixed point.  While the hand goes
    straight at the speed v, at least r away from that point, the second derivative of the elbow's
    way is at most L (4/3)^(1/2) (v/r)^2; a way with one of at most b leaves its chord by at most
    b dt^2/8.  A recorded elbow goes straight from sample to sample.
    """
    trajectory = trace.scenario.hands[hand]
    at = trace.ticks["hand_position_in_base_m"][:, hand]
    moving = np.any(np.diff(at, axis=0) != 0.0, axis=1)
    if not isinstance(trajectory, MovingHand):
        return np.zeros(len(moving))
    turns = paths.corner_at[paths.corner_hand == hand].astype(int)
    moving[turns[turns < len(moving)]] = True
    fastest = max((getattr(move, "speed_mps", 0.0) for move in trajectory.moves), default=0.0)
    most = np.where(moving, fastest * trace.scenario.settings.clock.control_period_s, 0.0)
    away = np.linalg.norm(at - np.array(trajectory.elbow_towards_in_base_m), axis=1)
    nearest = np.minimum(away[:-1], away[1:]) - most
    length = trace.scenario.settings.hand.forearm_length_m
    with np.errstate(divide="ignore", over="ignore"):
        turn = np.where(most > 0.0, most / np.maximum(nearest, 0.0), 0.0)
    bend: NDArray[np.float64] = np.minimum(length * np.sqrt(4.0 / 3.0) * turn**2 / 8.0, 2.0 * length)
    return bend


@compiled
def _follow(
    hands: NDArray[np.void],  # (MAX_HANDS,) HAND at the start
    moves: NDArray[np.void],  # (m,) MOVE
    samples: NDArray[np.float64],  # (s, 7)
    tcp_in_base_m: NDArray[np.float64],  # (n, 3)
    period_s: float,
    positions: NDArray[np.float64],  # (n, hands, 2, 3), written
    corner_hand: NDArray[np.int64],  # written, as the next two
    corner_at: NDArray[np.float64],
    corners: NDArray[np.float64],  # (., 2, 3)
) -> int:
    """Positions at the ticks and corners between them; returns the number of corners."""
    found = 0
    for k in range(positions.shape[0]):
        for i in range(positions.shape[1]):
            for j in range(3):
                positions[k, i, 0, j] = hands[i].position_in_base_m[j]
                positions[k, i, 1, j] = hands[i].elbow_in_base_m[j]
        if k == positions.shape[0] - 1:
            break
        for i in range(positions.shape[1]):
            if hands[i].recorded:
                row = hands[i].first + hands[i].current + 1
                while row < hands[i].first + hands[i].count and samples[row, 0] < (k + 1) * period_s:
                    if samples[row, 0] > k * period_s:
                        corner_hand[found], corner_at[found] = i, samples[row, 0] / period_s
                        for j in range(3):
                            corners[found, 0, j] = samples[row, 1 + j]
                            corners[found, 1, j] = samples[row, 4 + j]
                        found += 1
                    row += 1
                continue
            ahead = hands[i : i + 1].copy()  # goes from corner to corner, the hand itself from tick to tick
            left_s = period_s
            while left_s > 0.0 and ahead[0].current < ahead[0].count:
                left_s = advance_move(ahead, 0, moves, tcp_in_base_m[k], left_s)
                if 0.0 < left_s < period_s:
                    point_forearm(ahead, 0)
                    corner_hand[found], corner_at[found] = i, k + 1 - left_s / period_s
                    for j in range(3):
                        corners[found, 0, j] = ahead[0].position_in_base_m[j]
                        corners[found, 1, j] = ahead[0].elbow_in_base_m[j]
                    found += 1
        advance_hands(hands, moves, samples, tcp_in_base_m[k], k * period_s, period_s)
    return found
