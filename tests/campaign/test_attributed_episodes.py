"""A campaign's violated episodes are drawn again from their seeds, and grouped by whose fault they are."""

from __future__ import annotations

BLIND = """\
scenario space: a hand comes, and the sensor does not see it
duration: 4.5 s
avoider: opposite pose
tcp start: {offset: [0 mm, 0 mm, 0 mm]}
hands:
  - hand: right hand
    starts at: [840 mm, from -510 mm to -490 mm, 400 mm]
    elbow towards: [1000 mm, -1200 mm, 500 mm]
    moves:
      - move to: [760 mm, -80 mm, 380 mm]
        speed: 0.25 m/s
      - wait: 1 s
faults:
  - hand sensor blind: {from: 0 s}
claims:
  hand distance never below 50 mm: holds
"""
