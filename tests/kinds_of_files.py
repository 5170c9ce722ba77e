"""Short scenarios that several tests give to commands."""

from __future__ import annotations

SCENARIO = """\
scenario: a short run
duration: 300 ms
tcp start: {offset: [0 mm, -60 mm, 20 mm]}
avoider: opposite pose
claims: {joint speeds within limits: holds}
"""
VISIT = """\
scenario: a hand passes
duration: 1.6 s
tcp start:
  offset: [40 mm, -120 mm, 60 mm]
hands:
  - hand: right hand
    starts at: [1100 mm, -750 mm, 200 mm]
    elbow towards: [1600 mm, -1200 mm, 300 mm]
    moves:
      - move to: [840 mm, -350 mm, 250 mm]
        speed: 1 m/s
      - withdraw: 1 m/s
claims:
  joint speeds within limits: holds
"""
