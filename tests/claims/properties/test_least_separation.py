"""Passing over ticks and pairs changes no answer: against every tick and every capsule for itself."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from examples import ConstantSpeed, hand, run, scenario

from safety_harness.base.settings import DEFAULTS
from safety_harness.cell.robot.capsules import Arm, load_capsules
from safety_harness.cell.robot.description import load_arm
from safety_harness.cell.robot.distance import chain_lengths
from safety_harness.claims.properties.protective_separation import ProtectiveSeparation
from safety_harness.claims.signals.separation import farthest_steps, least_separation
from safety_harness.claims.signals.true_motion import true_motion
from safety_harness.scenario.moves import ReachForTcp, Sweep
from safety_harness.trace.trace import Trace

Found = tuple[list[int], list[float]]
Search = Callable[..., Found]


@pytest.fixture(scope="module")
def two_hands() -> Trace:
    hands = (
        hand(
            ReachForTcp(speed_mps=1.5, until_distance_m=0.05, at_most_s=1.0),
            at=(1.1, -0.5, 0.3),
        ),
        hand(
            Sweep(from_in_base_m=(0.9, 0.6, 0.4), to_in_base_m=(0.9, -0.2, 0.4), times=2, speed_mps=1.0),
            at=(0.9, 0.6, 0.4),
            name="left hand",
        ),
    )
    moving = ConstantSpeed((-0.2, 0.15, -0.1, 0.3, 0.1, 0.2))
    return run(scenario(*hands, duration_s=0.8), controller=moving)


@pytest.fixture(scope="module")
def search(two_hands: Trace) -> Search:
    """``least_separation`` of chosen ticks and capsules."""
    arm, capsules, true = load_arm("ur10"), load_capsules(), true_motion(two_hands)
    n = len(two_hands.ticks)
    reach_m = chain_lengths(arm.chain, capsules.records)
    every = Arm(arm.chain, capsules.records, reach_m)
    steps_m = farthest_steps(every, true.joints_rad, true.hands_m, true.present)

    def found(
        ticks: slice, some: slice = slice(None), *, hand_speed_mps: float, first_look: int = 0
    ) -> Found:
        judged = np.zeros(n, np.bool_)
        judged[ticks] = True
        which, what = least_separation(
            Arm(arm.chain, capsules.records[some], reach_m),
            judged,
            true.joints_rad,
            true.rates_radps,
            true.present,
            true.hands_m,
            np.full(n, 0.1),
            np.linspace(0.3, 0.4, n),
            np.array([DEFAULTS.hand.radius_m, DEFAULTS.hand.forearm_radius_m]),
            hand_speed_mps,
            0.008,
            *steps_m,
            first_look,
        )
        return which.tolist(), what.tolist()

    return found


def margin_m(found: Found) -> float:
    """Distance less the six terms."""
    (tick, *_), (distance, robot, human, hand_moves, robot_moves) = found
    stop_s = float(np.linspace(0.3, 0.4, 101)[tick])
    return distance - (human * (0.1 + stop_s) + robot * 0.1 + 0.5 * robot * stop_s + hand_moves + robot_moves)


@pytest.mark.parametrize("hand_speed_mps", [1.6, np.nan], ids=["constant", "own"])
def test_the_least_of_all_is_the_least_of_every_tick_and_capsule(
    hand_speed_mps: float, search: Search, two_hands: Trace
) -> None:
    every = [
        margin_m(search(slice(k, k + 1), slice(c, c + 1), hand_speed_mps=hand_speed_mps, first_look=k))
        for k in range(len(two_hands.ticks))
        for c in range(len(load_capsules().names))
    ]
    found = search(slice(None), hand_speed_mps=hand_speed_mps)
    assert margin_m(found) == pytest.approx(min(every), abs=1e-12)
    least = int(np.argmin(every))
    assert found[0][0] == least // len(load_capsules().names)
    assert found[0][2] == least % len(load_capsules().names)
    assert max(every) > min(every) + 0.5  # there was something to pass over


@pytest.mark.parametrize("first_look", [0, 37, 100])
def test_where_it_looks_first_changes_nothing(first_look: int, search: Search) -> None:
    expected = search(slice(None), hand_speed_mps=1.6, first_look=60)
    assert search(slice(None), hand_speed_mps=1.6, first_look=first_look) == expected


def test_a_tick_that_does_not_count_is_not_the_worst(search: Search) -> None:
    worst = search(slice(None), hand_speed_mps=1.6)[0][0]
    before = search(slice(0, worst), hand_speed_mps=1.6, first_look=worst)
    assert before[0][0] < worst
    assert margin_m(before) > margin_m(search(slice(None), hand_speed_mps=1.6))


def test_a_distance_that_the_trace_claims_does_not_hide_a_pair(two_hands: Trace) -> None:
    """Whoever writes greater distances into a trace's field changes no margin."""
    ticks = two_hands.ticks.copy()
    ticks["hand_distance_m"] += 0.4
    for prop in (ProtectiveSeparation(), ProtectiveSeparation(own_speeds=True)):
        honest, claimed = prop.worst(two_hands), prop.worst(replace(two_hands, ticks=ticks))
        assert honest is not None
        assert claimed == honest


@pytest.mark.parametrize("value", [np.nan, 1e9])
def test_what_stands_where_no_hand_is_changes_nothing(value: float, visit: Trace) -> None:
    ticks = visit.ticks.copy()
    assert not ticks["hand_present"][:, 1].any()
    ticks["hand_position_in_base_m"][::7, 1], ticks["elbow_position_in_base_m"][3, 1] = value, value
    for prop in (ProtectiveSeparation(), ProtectiveSeparation(own_speeds=True)):
        assert prop.evaluate(replace(visit, ticks=ticks)) == prop.evaluate(visit)
