"""What a hand does between two ticks: its corners are found, and count for the closest approach."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples import ConstantSpeed, hand, run, scenario

from safety_harness import admit, read_scenario, run_trial
from safety_harness.properties.hand_distance import HandDistance, closest_approach, joint_bend_m
from safety_harness.properties.hand_paths import first_stray, hand_paths
from safety_harness.scenario.model import FollowTcp, MoveTo, MovingHand, ReachForTcp, Verdict, Wait, Withdraw
from safety_harness.settings import DEFAULTS
from safety_harness.trace.trace import Trace

POKE = hand(
    MoveTo(position_in_base_m=(0.9, -0.3, 0.3), speed_mps=1.9),
    Withdraw(speed_mps=2.1),
    Wait(duration_s=0.013),
    MoveTo(position_in_base_m=(0.95, -0.5, 0.3), speed_mps=0.7),
)
SHIPPED = Path(__file__).parents[2] / "scenarios"


def with_period(period_s: float, who: MovingHand, duration_s: float = 1.2) -> Trace:
    """The arm stands still."""
    settings = replace(DEFAULTS, clock=replace(DEFAULTS.clock, control_period_s=period_s))
    return run(scenario(who, duration_s=duration_s, settings=settings), controller=ConstantSpeed((0.0,) * 6))


@pytest.mark.parametrize("period_s", [0.008, 0.05])
def test_corners_lie_where_a_far_finer_clock_sees_the_hand(period_s: float) -> None:
    coarse, fine = with_period(period_s, POKE), with_period(0.001, POKE)
    paths = hand_paths(coarse)
    assert first_stray(coarse, paths) is None
    assert len(paths.corner_at) == 4
    for at, (hand_m, elbow_m) in zip(paths.corner_at, paths.corners_in_base_m, strict=True):
        tick = round(at * period_s / 0.001)
        assert np.linalg.norm(fine.ticks["hand_position_in_base_m"][tick, 0] - hand_m) < 0.0022
        assert np.linalg.norm(fine.ticks["elbow_position_in_base_m"][tick, 0] - elbow_m) < 0.0044


@pytest.mark.parametrize("period_s", [0.008, 0.02, 0.05])
def test_a_hand_that_turns_within_a_tick_is_not_missed_there(period_s: float) -> None:
    trace = with_period(period_s, POKE)
    distance_m, time_s, _ = closest_approach(trace, hand_paths(trace))
    finest = with_period(0.0005, POKE).ticks["hand_distance_m"][:, 0].min()
    assert finest - 0.003 < distance_m <= finest + 1e-9
    assert 0.0 < time_s < 1.2


def test_on_the_chords_alone_it_would_have_been_missed() -> None:
    trace = with_period(0.05, POKE)
    paths = hand_paths(trace)
    blind = replace(paths, corner_hand=np.full_like(paths.corner_hand, -1))
    assert closest_approach(trace, blind)[0] > closest_approach(trace, paths)[0] + 0.01


def test_the_moves_are_followed_bit_by_bit_along_the_arms_way() -> None:
    seeks = hand(
        ReachForTcp(speed_mps=1.0, until_distance_m=0.2, at_most_s=2.0),
        FollowTcp(speed_mps=0.4, distance_m=0.15, duration_s=0.7),
        Withdraw(speed_mps=1.0),
    )
    trace = run(scenario(seeks, replace(POKE, name="left"), duration_s=2.5))
    paths = hand_paths(trace)
    followed = paths.positions_in_base_m
    assert np.array_equal(followed[:, :, 0], trace.ticks["hand_position_in_base_m"])
    assert np.array_equal(followed[:, :, 1], trace.ticks["elbow_position_in_base_m"])
    assert set(paths.corner_hand) == {0, 1}


def test_the_samples_of_a_recording_between_two_ticks_are_corners() -> None:
    recorded = replace(read_scenario(SHIPPED / "recorded-giving.yaml"), duration_s=0.4)
    trace = run_trial(admit(recorded))
    paths = hand_paths(trace)
    assert first_stray(trace, paths) is None
    samples_s = recorded.hands[0].motion.time_s  # type: ignore[union-attr]
    between = (samples_s < 0.4) & ~np.isclose(samples_s / 0.008, np.round(samples_s / 0.008))
    assert between.any()
    assert np.all(np.isin(np.round(samples_s[between], 9), np.round(paths.corner_at * 0.008, 9)))


def test_a_hand_that_is_not_the_scenarios_is_no_evidence(visit: Trace) -> None:
    ticks = visit.ticks.copy()
    ticks["hand_position_in_base_m"][20:, 0] += 1e-3
    evaluation = HandDistance(minimum_m=0.05, near_m=0.4).evaluate(replace(visit, ticks=ticks))
    assert evaluation.verdict is Verdict.INCONCLUSIVE
    assert "tick 20" in evaluation.reason


def test_joints_that_change_their_speed_lower_the_bound(visit: Trace) -> None:
    """Oracle: what accelerates uniformly leaves its chord by a dt^2/8."""
    bend_m = joint_bend_m(visit)
    assert bend_m.max() < 1e-4  # at 1 m/s^2 and 8 ms
    ticks = visit.ticks.copy()
    ticks["joint_velocity_radps"][50:, 0] += 1.0
    changed_m = joint_bend_m(replace(visit, ticks=ticks))
    reach_m = np.linalg.norm(visit.ticks["transform_tcp_to_base"][49, :2, 3])  # from the pan's axis
    assert changed_m[49] - bend_m[49] > 1.0 * 0.008 / 8.0 * reach_m - 1e-5
    assert np.allclose(changed_m[50:], bend_m[50:], rtol=0.0, atol=1e-12)
