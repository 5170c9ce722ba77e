"""No moving part touches a hand: which parts move, how near a hand comes to them, and what is no evidence."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
import pytest

from safety_harness import Move
from safety_harness.admission.admit import admit
from safety_harness.admission.trial import run_kinematic
from safety_harness.cell.robot.distance import place_capsules
from safety_harness.cell.robot.robots import arm_model
from safety_harness.claims.properties import touching
from safety_harness.claims.properties.touching import NO_MOVING_PART_TOUCHES, first_turning
from safety_harness.claims.signals.true_motion import capsules_of, hand_paths
from safety_harness.scenario.model import Verdict
from safety_harness.scenario.read import parse_scenario
from safety_harness.scenario.robots import Robot
from safety_harness.trace.trace import Trace
from tests.cell.robot.arms import transforms_of

AT_THE_UPPER_ARM = """
scenario: a hand comes to the upper arm and stays
duration: 2 s
hands:
  - hand: right hand
    starts at: [100 mm, 1000 mm, 400 mm]
    elbow towards: [100 mm, 1600 mm, 400 mm]
    moves:
      - move to: [80 mm, 230 mm, 400 mm]
        speed: 1.5 m/s
tcp start: {offset: [0 mm, 0 mm, 0 mm]}
claims:
  no moving part touches a hand: holds
"""
ELSEWHERE = AT_THE_UPPER_ARM.replace("[80 mm, 230 mm, 400 mm]", "[100 mm, 900 mm, 400 mm]")


class Turns:
    """Turns one joint, from a time on until another."""

    name = "turns a joint"
    sees = ("joints",)

    def __init__(self, joint: int, until_s: float = np.inf) -> None:
        self.joint, self.until_s = joint, until_s

    def reset(self, *, settings: Any, arm: Any, start: Any, seed: int) -> None:
        pass

    def act(self, seen: Any) -> Move:
        rates = np.zeros(6)
        rates[self.joint] = 0.2 if seen.time_s < self.until_s else 0.0
        return Move(joint_velocity_radps=rates)


@lru_cache
def turning(joint: int, until_s: float = np.inf, text: str = AT_THE_UPPER_ARM) -> Trace:
    return run_kinematic(admit(parse_scenario(text), controller=Turns(joint, until_s)))


def by_hand_m(trace: Trace) -> float:
    """At the ticks alone, by numpy: the least distance to what moved in the tick before or moves after."""
    capsules, rates = capsules_of(trace), np.abs(np.diff(trace.ticks["joint_position_rad"], axis=0))
    hand_m, forearm_m = trace.scenario.settings.hand.radius_m, trace.scenario.settings.hand.forearm_radius_m
    least_m = np.inf
    for k, tick in enumerate(trace.ticks):
        around = rates[max(k - 1, 0) : k + 1].max(axis=0) >= 8e-6
        if not around.any():
            continue
        ends = np.empty((len(capsules.names), 2, 3))
        place_capsules(
            capsules.records, transforms_of(arm_model(Robot.UR10), tick["joint_position_rad"]), ends
        )
        moved = capsules.link_index > int(around.argmax())
        arm = ends[moved, :1] + np.linspace(0.0, 1.0, 41)[None, :, None] * np.diff(ends[moved], axis=1)
        hand, elbow = tick["hand_position_in_base_m"][0], tick["elbow_position_in_base_m"][0]
        for part, radius_m in ((hand[None], hand_m), (np.linspace(hand, elbow, 41), forearm_m)):
            away = np.linalg.norm(arm[:, :, None] - part[None, None], axis=3).min(axis=(1, 2))
            least_m = min(least_m, float((away - capsules.radius_m[moved]).min()) - radius_m)
    return least_m


def judged(trace: Trace) -> Any:
    return NO_MOVING_PART_TOUCHES.prop.evaluate(trace)


def test_a_hand_may_touch_an_upper_arm_that_stands_while_the_wrist_turns() -> None:
    trace = turning(5)
    assert trace.ticks["hand_distance_m"].min() < 0.0
    assert judged(trace).verdict is Verdict.HOLDS
    assert set(first_turning(trace)) == {5}


def test_it_may_not_touch_one_that_moves() -> None:
    said = judged(turning(1))
    assert said.verdict is Verdict.VIOLATED
    assert said.reason.endswith("mm inside a part that moves")


def test_it_may_touch_one_that_has_stopped() -> None:
    trace = turning(1, 0.3)
    assert trace.ticks["hand_distance_m"].min() < 0.0
    assert judged(trace).verdict is Verdict.HOLDS


@pytest.mark.parametrize("trace", [turning(5), turning(1), turning(1, 0.3)], ids=["wrist", "lift", "stopped"])
def test_its_margin_is_that_of_the_parts_that_move(trace: Trace) -> None:
    by_hand = by_hand_m(trace)
    assert by_hand - 0.02 <= judged(trace).margin <= by_hand + 1e-3  # between ticks it may be nearer


def test_an_arm_that_never_moves_says_nothing() -> None:
    said = judged(turning(1, 0.0))
    assert said.verdict is Verdict.INCONCLUSIVE
    assert said.reason.startswith("never exercised: the arm did not move while a hand was there")


def test_a_hand_that_never_comes_says_nothing() -> None:
    said = judged(turning(1, text=ELSEWHERE))
    assert said.verdict is Verdict.INCONCLUSIVE
    assert said.reason.startswith("never exercised: the nearest hand came to")


@pytest.mark.parametrize("trace", [turning(5), turning(1), turning(1, 0.3)], ids=["wrist", "lift", "stopped"])
def test_what_is_passed_over_is_never_the_nearest(trace: Trace, monkeypatch: pytest.MonkeyPatch) -> None:
    paths, looked = hand_paths(trace), []
    exactly = touching.closest_between
    monkeypatch.setattr(touching, "closest_between", lambda *of: looked.append(1) or exactly(*of))
    found = touching.closest_moving(trace, paths)
    seen = len(looked)
    monkeypatch.setattr(touching, "_lower_bounds", lambda *of: np.full(len(of[-1]), -np.inf))
    assert touching.closest_moving(trace, paths) == found
    assert seen <= len(looked) - seen
