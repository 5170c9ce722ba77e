"""Avoiders that are wrong in one corner, and a space of short runs in PyBullet in which to find it."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from safety_harness.cell.avoidance.avoider import Proposal
from safety_harness.space.read import parse_space

Vector = NDArray[np.float64]

SPACE = parse_space(
    """\
scenario space: a hand from the right
duration: 300 ms
avoider: opposite pose
tcp start:
  offset: [from -40 mm to 40 mm, from -60 mm to 60 mm, from 0 mm to 40 mm]
hands:
  - hand: right hand
    starts at: {box: [[700 mm, -600 mm, 250 mm], [950 mm, -480 mm, 550 mm]]}
    elbow towards: [1000 mm, -1200 mm, 500 mm]
    moves:
      - reach for tcp: from 0.5 m/s to 2 m/s
        stop at distance: 50 mm
        give up after: 2 s
claims:
  proposed repulsive poses reachable: holds
  joint speeds within limits: holds
settings: {clock: {wall limit: 500 ms}}
"""
)


def away(hand_m: Vector, tcp_m: Vector) -> Vector:
    direction: Vector = (tcp_m - hand_m) / np.linalg.norm(tcp_m - hand_m)
    return direction


@dataclass(frozen=True)
class Overreaches:
    """Gives way the farther the lower the hand: slopes, once the arm's reach comes into it."""

    name: str = "overreaches"

    def propose(
        self, *, hand_position_in_base_m: Vector, tcp_position_in_base_m: Vector, seed: int
    ) -> Proposal:
        low_m = max(tcp_position_in_base_m[2] - hand_position_in_base_m[2], 0.0)
        way = away(hand_position_in_base_m, tcp_position_in_base_m)
        return Proposal(tcp_position_in_base_m + way * (0.1 + 11.0 * low_m))


@dataclass(frozen=True)
class NoNumber:
    """Answers NaN to a hand in front and above: flat."""

    name: str = "no number"

    def propose(
        self, *, hand_position_in_base_m: Vector, tcp_position_in_base_m: Vector, seed: int
    ) -> Proposal:
        if hand_position_in_base_m[0] > 0.84 and hand_position_in_base_m[2] > 0.47:
            return Proposal(np.full(3, np.nan))
        way = away(hand_position_in_base_m, tcp_position_in_base_m)
        return Proposal(tcp_position_in_base_m + 0.1 * way)


@dataclass(frozen=True)
class Raises:
    """Divides by nothing where the hand is straight ahead of the right side: a mishap."""

    name: str = "raises"

    def propose(
        self, *, hand_position_in_base_m: Vector, tcp_position_in_base_m: Vector, seed: int
    ) -> Proposal:
        aside = abs(hand_position_in_base_m[0] - tcp_position_in_base_m[0])
        if aside < 0.004:
            raise ZeroDivisionError("no direction")
        way = away(hand_position_in_base_m, tcp_position_in_base_m)
        return Proposal(tcp_position_in_base_m + 0.1 * way)


@dataclass(frozen=True)
class Hangs:
    """Thinks for ever about a low hand that is far ahead: the run fails, a mishap."""

    name: str = "hangs"

    def propose(
        self, *, hand_position_in_base_m: Vector, tcp_position_in_base_m: Vector, seed: int
    ) -> Proposal:
        if hand_position_in_base_m[0] > 0.84 and hand_position_in_base_m[2] < 0.3:
            while True:
                time.sleep(0.01)
        way = away(hand_position_in_base_m, tcp_position_in_base_m)
        return Proposal(tcp_position_in_base_m + 0.1 * way)
