"""Hands that move as the scenario says: an interpreter of hand moves, compiled for both worlds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from safety_harness.compiled import compiled
from safety_harness.scenario.model import (
    MAX_HANDS,
    FollowTcp,
    HandMove,
    HandTrajectory,
    MoveTo,
    MovingHand,
    ReachForTcp,
    RecordedHand,
    Wait,
)
from safety_harness.settings import Hand


class Kind(IntEnum):
    """What a compiled move does."""

    MOVE_TO = 0
    WAIT = 1
    REACH_FOR_TCP = 2
    FOLLOW_TCP = 3


MOVE_TO, WAIT = int(Kind.MOVE_TO), int(Kind.WAIT)
REACH_FOR_TCP, FOLLOW_TCP = int(Kind.REACH_FOR_TCP), int(Kind.FOLLOW_TCP)

MOVE = np.dtype(
    [
        ("kind", np.int64),
        ("target_in_base_m", np.float64, (3,)),
        ("speed_mps", np.float64),
        ("distance_m", np.float64),  # how near to the TCP
        ("duration_s", np.float64),  # at most, for a reach
    ],
    align=True,
)

HAND = np.dtype(
    [
        ("present", np.bool_),
        ("recorded", np.bool_),
        ("position_in_base_m", np.float64, (3,)),
        ("elbow_in_base_m", np.float64, (3,)),
        ("elbow_towards_in_base_m", np.float64, (3,)),
        ("forearm_length_m", np.float64),
        ("first", np.int64),  # of this hand's moves or samples
        ("count", np.int64),
        ("current", np.int64),  # which move or sample interval
        ("elapsed_s", np.float64),  # in the current move
    ],
    align=True,
)


@dataclass(frozen=True, eq=False)
class Hands:
    """The hands of one episode: their state and their programs.

    ``state`` (MAX_HANDS,) HAND; ``moves`` (m,) MOVE; ``samples`` (s, 7): time, hand, elbow.
    """

    state: NDArray[np.void]
    moves: NDArray[np.void]
    samples: NDArray[np.float64]


def hands_at_start(trajectories: Sequence[HandTrajectory], hand: Hand) -> Hands:
    """The hands as the scenario begins."""
    state = np.zeros(MAX_HANDS, HAND)
    state["position_in_base_m"] = state["elbow_in_base_m"] = np.nan
    moves: list[NDArray[np.void]] = []
    samples: list[NDArray[np.float64]] = []
    for record, trajectory in zip(state, trajectories, strict=False):
        record["present"] = True
        record["forearm_length_m"] = hand.forearm_length_m
        if isinstance(trajectory, RecordedHand):
            motion = trajectory.motion
            record["recorded"] = True
            record["first"] = sum(map(len, samples))
            record["count"] = len(motion.time_s)
            samples.append(
                np.column_stack(
                    [motion.time_s, motion.hand_position_in_base_m, motion.elbow_position_in_base_m]
                )
            )
        else:
            record["position_in_base_m"] = trajectory.starts_at_in_base_m
            record["elbow_towards_in_base_m"] = trajectory.elbow_towards_in_base_m
            record["first"] = sum(map(len, moves))
            record["count"] = len(trajectory.moves)
            moves.append(np.array([_move(trajectory, move) for move in trajectory.moves], MOVE).reshape(-1))
    hands = Hands(
        state,
        np.concatenate([*moves, np.zeros(1, MOVE)]),  # never empty: compiled code wants its type
        np.concatenate([*samples, np.zeros((1, 7))]),
    )
    advance_hands(hands.state, hands.moves, hands.samples, np.zeros(3), 0.0, 0.0)
    return hands


def _move(hand: MovingHand, move: HandMove) -> tuple[int, tuple[float, float, float], float, float, float]:
    """One MOVE record."""
    nowhere = (0.0, 0.0, 0.0)
    if isinstance(move, MoveTo):
        return (MOVE_TO, move.position_in_base_m, move.speed_mps, 0.0, 0.0)
    if isinstance(move, Wait):
        return (WAIT, nowhere, 0.0, 0.0, move.duration_s)
    if isinstance(move, ReachForTcp):
        return (REACH_FOR_TCP, nowhere, move.speed_mps, move.until_distance_m, move.at_most_s)
    if isinstance(move, FollowTcp):
        return (FOLLOW_TCP, nowhere, move.speed_mps, move.distance_m, move.duration_s)
    return (MOVE_TO, hand.starts_at_in_base_m, move.speed_mps, 0.0, 0.0)  # Withdraw


@compiled
def advance_hands(
    hands: NDArray[np.void],  # (MAX_HANDS,) HAND
    moves: NDArray[np.void],  # (m,) MOVE
    samples: NDArray[np.float64],  # (s, 7)
    tcp_position_in_base_m: NDArray[np.float64],  # (3,) at time_s
    time_s: float,
    dt_s: float,
) -> None:
    """Move every hand from ``time_s`` to ``time_s + dt_s``; what is left of a move's tick flows on.

    Hands that head for the TCP aim at where it was at ``time_s``.
    """
    for k in range(hands.shape[0]):
        hand = hands[k]
        if not hand.present:
            continue
        if hand.recorded:
            follow_recording(hands, k, samples, time_s + dt_s)
            continue
        left_s = dt_s
        while left_s > 0.0 and hand.current < hand.count:
            left_s = advance_move(hands, k, moves, tcp_position_in_base_m, left_s)
        point_forearm(hands, k)


@compiled
def advance_move(
    hands: NDArray[np.void],
    k: int,
    moves: NDArray[np.void],
    tcp_position_in_base_m: NDArray[np.float64],
    left_s: float,
) -> float:
    """Spend up to ``left_s`` on the current move; returns what is left when the move is over."""
    hand = hands[k]
    move = moves[hand.first + hand.current]
    if move.kind == WAIT:
        used_s = min(left_s, move.duration_s - hand.elapsed_s)
        over = hand.elapsed_s + left_s >= move.duration_s
    else:
        goal = np.empty(3)
        total = 0.0
        for i in range(3):
            goal[i] = move.target_in_base_m[i] if move.kind == MOVE_TO else tcp_position_in_base_m[i]
            total += (goal[i] - hand.position_in_base_m[i]) ** 2
        distance = np.sqrt(total)
        gap = max(distance - move.distance_m, 0.0)
        allowed_s = left_s
        if move.kind != MOVE_TO:
            allowed_s = min(left_s, move.duration_s - hand.elapsed_s)
        step = min(gap, move.speed_mps * allowed_s)
        for i in range(3):
            if step > 0.0:
                hand.position_in_base_m[i] += step / distance * (goal[i] - hand.position_in_base_m[i])
        there = step >= gap
        if move.kind == FOLLOW_TCP:
            used_s = allowed_s
            over = hand.elapsed_s + left_s >= move.duration_s
        else:
            used_s = step / move.speed_mps if there else allowed_s
            over = there or (move.kind == REACH_FOR_TCP and hand.elapsed_s + left_s >= move.duration_s)
            if there and move.kind == MOVE_TO:
                hand.position_in_base_m[:] = move.target_in_base_m  # exactly, whatever the rounding
    if over:
        hand.current += 1
        hand.elapsed_s = 0.0
        return float(max(left_s - used_s, 0.0))
    hand.elapsed_s += left_s
    return 0.0


@compiled
def point_forearm(hands: NDArray[np.void], k: int) -> None:
    """Put the elbow one forearm's length from the hand towards the person."""
    hand = hands[k]
    total = 0.0
    for i in range(3):
        total += (hand.elbow_towards_in_base_m[i] - hand.position_in_base_m[i]) ** 2
    distance = np.sqrt(total)
    for i in range(3):
        direction = 1.0 if i == 2 else 0.0  # straight up if the hand is where the person stands
        if distance > 0.0:
            direction = (hand.elbow_towards_in_base_m[i] - hand.position_in_base_m[i]) / distance
        hand.elbow_in_base_m[i] = hand.position_in_base_m[i] + hand.forearm_length_m * direction


@compiled
def follow_recording(hands: NDArray[np.void], k: int, samples: NDArray[np.float64], time_s: float) -> None:
    """Put hand and elbow where the recording has them; straight between samples, at rest after it."""
    hand = hands[k]
    last = hand.first + hand.count - 1
    row = hand.first + hand.current
    while row < last - 1 and samples[row + 1, 0] <= time_s:
        row += 1
    hand.current = row - hand.first
    span_s = samples[row + 1, 0] - samples[row, 0]
    fraction = min(max((time_s - samples[row, 0]) / span_s, 0.0), 1.0)
    for i in range(3):
        before, after = samples[row, 1 + i], samples[row + 1, 1 + i]
        hand.position_in_base_m[i] = before + fraction * (after - before)
        before, after = samples[row, 4 + i], samples[row + 1, 4 + i]
        hand.elbow_in_base_m[i] = before + fraction * (after - before)
