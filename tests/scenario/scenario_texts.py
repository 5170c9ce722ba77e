"""A valid scenario file that uses most of the language, a very short one, and ways to spoil them."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest
from scenario_strategies import RECORDING, RECORDINGS

from safety_harness.base.exceptions import InputError, RecordingError, ScenarioError
from safety_harness.scenario.model import Scenario
from safety_harness.scenario.read import parse_scenario

FILE = Path("folder/reach.yaml")
SHA256 = hashlib.sha256(RECORDING).hexdigest()
VALID = f"""\
scenario: a hand reaches for the tool and withdraws
about: >
  Why a safety engineer
  would try this.
duration: 12 s
seed: 7
robot: UR5
tcp start:
  offset: [40 mm, -120 mm, 60 mm]      # from the desired pose
  tilt: [0 deg, 3 deg, 0 deg]
avoider: nearest candidate
hands:
  - hand: right
    starts at: [1.2 m, -0.7 m, 100 mm]
    elbow towards: [1.6 m, -1.2 m, 300 mm]
    shifted by: [20 mm, 0 mm, 0 mm]
    delayed by: 250 ms
    speed at most: 2.2 m/s
    acceleration at most: 8 m/s2
    tremor: {{amplitude: 3 mm, rate: 9 Hz}}
    moves:
      - wait: 1 s
      - move to: [840 mm, -350 mm, 5 mm]
        speed: 0.5 m/s
      - reach for tcp: 2 m/s
        stop at distance: 100 mm
        give up after: 3 s
        hesitating at: 300 mm
        for: 400 ms
      - reach for object: 0.8 m/s
        stop at distance: 150 mm
        give up after: 2 s
      - wander: 0.9 m/s
        within: [[0.9 m, -0.6 m, 0 mm], [1.1 m, -0.4 m, 200 mm]]
        for: 3 s
      - sweep: 0.7 m/s
        from: [0.9 m, -0.3 m, 50 mm]
        to: [0.9 m, -0.7 m, 50 mm]
        times: 3
      - follow tcp: 0.3 m/s
        keeping: 250 mm
        for: 4 s
      - withdraw: 1.6 m/s
  - recording: walks/walk.csv
    sha256: {SHA256}
    track: left hand
    elbow track: right elbow
    starts at: [1.4 m, -0.9 m, 200 mm]
    turned: 90 deg
    speed factor: 2.0
    speed at most: 4 m/s
    from: 200 ms
    to: 1.5 s
    longest gap: 100 ms
    fastest jump: 4 m/s
object:
  polygon: [[-60 mm, -40 mm], [100 mm, -40 mm], [-40 mm, 80 mm]]
  position: [710 mm, 40 mm, -300 mm]
  yaw: 20 deg
faults:
  - hand sensor: is late
    delay: 120 ms
    from: 1 s
    for: 500 ms
  - hand sensor: sees a false hand
    at: [800 mm, -350 mm, 250 mm]
  - camera: is knocked
    turned: [0 deg, 2 deg, 0 deg]
    until: 3 s
  - joint: is stuck
    which: elbow
hand sensor:
  kind: overhead
  detector: rendered
  pixel noise: 2 px
  depth noise: 0.0025 /m
  dropout: 5 %
  rate: 30 Hz
  latency: 33 ms
camera:
  source: raster
  width: 320 px
  calibration error: {{offset: [1 mm, 0 mm, 0 mm], rotation: [0 deg, 0 deg, 1 deg]}}
settings:
  avoidance: {{critical distance: 450 mm}}
  servo: {{interaction: mean}}
claims:
  hand distance never below 50 mm: holds
  repulsive poses reachable: violated
  gain switch reached: inconclusive
"""
SHORTEST = """\
scenario: nothing happens
duration: 1 s
tcp start: {offset: [0 mm, 0 mm, 0 mm]}
claims: {gain switch reached: holds}
"""


def parse(text: str) -> Scenario:
    return parse_scenario(text, FILE, RECORDINGS)


def line_of(text: str, part: str) -> int:
    return text[: text.index(part)].count("\n") + 1


def refusal(text: str) -> InputError:
    with pytest.raises(InputError) as caught:
        parse(text)
    assert isinstance(caught.value, ScenarioError | RecordingError)
    return caught.value


def changed(old: str, new: str) -> str:
    assert VALID.count(old) == 1, old
    return VALID.replace(old, new)
