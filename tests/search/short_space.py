"""A space whose runs last 0.4 s: a hand is near and reaches for the tool, faster than it can give way."""

from __future__ import annotations

from safety_harness.space.read import parse_space

TEXT = """\
scenario space: a hand nearby
duration: 400 ms
avoider: opposite pose
tcp start:
  offset: [0 mm, from -40 mm to 40 mm, 20 mm]
hands:
  - hand: right hand
    starts at: [from 700 mm to 900 mm, -500 mm, 400 mm]
    elbow towards: [1000 mm, -1200 mm, 500 mm]
    moves:
      - reach for tcp: from 0.2 m/s to 2 m/s
        stop at distance: 50 mm
        give up after: 2 s
claims:
  hand distance never below 150 mm: holds
  joint speeds within limits: holds
"""
SHORT = parse_space(TEXT)
CRASHING = """\
from safety_harness import Proposal


class Crashing:
    name = "crashing"

    def propose(self, *, hand_position_in_base_m, tcp_position_in_base_m, seed):
        if hand_position_in_base_m[0] > 0.83:
            raise ZeroDivisionError(f"at {hand_position_in_base_m[0]}")
        return Proposal(tcp_position_in_base_m + [0.0, 0.1, 0.0])
"""
