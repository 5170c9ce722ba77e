"""Moves that never begin, faults that never act, values that vary in these alone are named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from examples import VISIT, scenario

from safety_harness.admission.admit import admit
from safety_harness.admission.trial import run_trial
from safety_harness.cell.simulation.worlds import KINEMATIC
from safety_harness.claims.properties.tried import TriedParts
from safety_harness.scenario.faults import AvoiderNaN, CameraBlind, FalseHand, HandSensorBlind, JointStuck
from safety_harness.scenario.faults import Joint as Which
from safety_harness.scenario.model import Scenario
from safety_harness.space.read import parse_space
from safety_harness.trace.trace import Trace

SPACE = """
scenario space: a reach that comes late
duration: 1 s
tcp start:
  offset: [from -20 mm to 20 mm, -60 mm, 20 mm]
avoider: opposite pose
hands:
  - hand: right hand
    starts at: [1100 mm, -700 mm, 300 mm]
    elbow towards: [1600 mm, -1200 mm, 300 mm]
    moves:
      - wait: from 100 ms to 200 ms
      - one of:
          - wait: 600 ms
          - wait: 50 s
      - reach for tcp: from 1.5 m/s to 2 m/s
        stop at distance: from 20 mm to 30 mm
        give up after: 2 s
claims:
  hand distance never below 50 mm: holds
"""


LATER = replace(VISIT, starts_at_in_base_m=(1.4, -1.1, 0.2))  # from more than 800 mm off


def made(what: Scenario) -> Trace:
    return run_trial(admit(what), world=KINEMATIC)


def test_every_move_that_begins_counts_as_tried() -> None:
    assert TriedParts.from_traces(made(scenario(VISIT))).lines() == []


@pytest.mark.parametrize(("duration_s", "idle"), [(0.2, [2, 3]), (0.9, [3])])
def test_the_moves_that_a_run_is_too_short_for_are_named(duration_s: float, idle: list[int]) -> None:
    (line,) = TriedParts.from_traces(made(scenario(VISIT, duration_s=duration_s))).lines()
    words = {2: "move 2 of right (wait)", 3: "move 3 of right (withdraw)"}
    assert line.startswith("untried in 1 run of 'an example'")
    assert line.endswith("of: " + "; ".join(words[number] for number in idle))


def test_a_move_that_one_of_several_runs_begins_is_tried() -> None:
    runs = [made(scenario(VISIT, duration_s=one)) for one in (0.2, 2.5)]
    assert TriedParts.from_traces(*runs).lines() == []


def test_a_run_that_was_cut_short_tries_nothing() -> None:
    assert TriedParts.from_traces(replace(made(scenario(VISIT)), ended="interrupted")).lines() == []


def test_faults_that_change_nothing_are_named_and_others_are_not() -> None:
    """A blind sensor before anybody is near, an avoider that nobody asks, a joint that stands anyway."""
    idle = (
        AvoiderNaN(until_s=0.2),
        HandSensorBlind(until_s=0.1),
        JointStuck(joint=Which.WRIST_3, until_s=0.001),
    )
    false = FalseHand(position_in_base_m=(0.9, -0.5, 0.2), from_s=0.5)
    busy = (CameraBlind(from_s=0.5, until_s=0.6), false)
    trace = made(replace(scenario(LATER), faults=(*idle, *busy)))
    (line,) = TriedParts.from_traces(trace).lines()
    for number, words in enumerate(("avoider answers NaN", "hand sensor sees nothing"), start=1):
        assert f"fault {number} ({words})" in line
    for number in (4, 5):
        assert f"fault {number} " not in line
    whole = made(replace(scenario(VISIT), faults=(HandSensorBlind(),)))
    assert TriedParts.from_traces(whole).lines() == []


def test_a_blind_sensor_acts_only_where_it_hides_a_hand() -> None:
    empty = replace(scenario(duration_s=0.4), faults=(HandSensorBlind(), CameraBlind()))
    acted = np.bitwise_or.reduce(made(empty).ticks["faults"])
    assert int(acted) == 2  # there is no hand to hide, and there is an object


def test_the_values_that_vary_in_what_no_run_tries_are_named() -> None:
    space, tried = parse_space(SPACE), TriedParts()
    late = [one for one in space.draws(0, 12) if "50.0" in repr(one.hands[0].moves[1])]
    early = next(one for one in space.draws(0, 12) if "0.6" in repr(one.hands[0].moves[1]))
    for one in late[:2]:
        tried.add(made(one))
    (line,) = tried.lines(space)
    assert "hands[0].moves[2].reach for tcp, which varies" in line
    assert "hands[0].moves[2].stop at distance, which varies" in line
    assert "offset" not in line
    assert "moves[0]" not in line
    tried.add(made(early))
    assert tried.lines(space) == []


def test_what_a_standing_arm_would_leave_untried_is_told_without_a_run() -> None:
    what = replace(
        scenario(LATER, duration_s=1.2), faults=(AvoiderNaN(until_s=0.2), CameraBlind(until_s=0.1))
    )
    tried = TriedParts()
    tried.suppose(what, made(what).ticks["transform_tcp_to_base"][0, :3, 3].copy())
    (line,) = tried.lines()
    assert line.endswith("of: move 3 of right (withdraw); fault 1 (avoider answers NaN)")
