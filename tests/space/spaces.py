"""Spaces that several tests look at: one with everything in it, and one of a single number."""

from __future__ import annotations

from pathlib import Path

from safety_harness.space.read import parse_space
from safety_harness.space.space import ScenarioSpace

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "scenarios/spaces"
FILES = sorted(FOLDER.glob("*.yaml"))

HEAD = """\
scenario space: a test
duration: 5 s
tcp start: {offset: [0 mm, 0 mm, 0 mm]}
claims: {gain switch reached: holds}
"""

EVERYTHING = """\
scenario space: every kind of distribution
duration: from 2 s to 4 s
avoider: opposite pose
hand sensor:
  one of: [{kind: ideal}, {kind: overhead, pixel noise: from 0 px to 3 px}]
  chances: [3, 1]
choices:
  side: one of right, left
  reach speed: from 0.5 m/s to 2 m/s
  start:
    by: side
    right: [1.2 m, from -0.8 m to -0.6 m, 0.3 m]
    left: [1.2 m, from 0.6 m to 0.8 m, 0.3 m]
tcp start:
  offset: {in: unseen tcp}
  tilt: {box: [[-5 deg, -5 deg, 0 deg], [5 deg, 5 deg, 10 deg]]}
settings:
  avoidance: {radius: "normal 100 mm +- 20 mm from 80 mm to 150 mm"}
hands:
  - hand: one of a hand, another hand
    starts at: the start
    elbow towards: {by: side, right: [1.6 m, -1.2 m, 0.3 m], left: [1.6 m, 1.2 m, 0.3 m]}
    moves:
      - wait: one of 500 ms, 1 s, 2 s
      - repeat: from 0 to 3 times
        moves:
          - move to: {in: seen hand}
            speed: the reach speed
          - one of:
              - wait: from 0.1 s to 1 s
              - reach for tcp: the reach speed
                stop at distance: from 50 mm to 200 mm
                give up after: 2 s
              - withdraw: from 0.2 m/s to 0.4 m/s
            chances: [2, 1, 1]
      - move to: {shell: [1 m, 0 m, 0.5 m], from: 100 mm, to: 200 mm}
        speed: the reach speed
claims:
  gain switch reached: holds
"""


def everything() -> ScenarioSpace:
    return parse_space(EVERYTHING)


def of_duration(sentence: str) -> ScenarioSpace:
    """A space of one number: the duration."""
    return parse_space(HEAD.replace("duration: 5 s", f"duration: {sentence}"))
