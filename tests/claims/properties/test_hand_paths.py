"""What a hand does between two ticks is bounded, and counts for the closest approach."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples import ConstantSpeed, hand, run, scenario

from safety_harness import admit, read_scenario, run_kinematic, run_trial
from safety_harness.base.settings import DEFAULTS
from safety_harness.claims.properties.hand_distance import HandDistance
from safety_harness.claims.signals.hand_distance import closest_approach, joint_bend_m
from safety_harness.claims.signals.true_motion import first_stray, hand_bend_m, hand_paths
from safety_harness.scenario.model import HandTrajectory, JoinedHand, MovingHand, Verdict
from safety_harness.scenario.moves import FollowTcp, MoveTo, ReachForTcp, Tremor, Wait, Wander, Withdraw
from safety_harness.trace.trace import Trace

POKE = replace(
    hand(
        MoveTo(position_in_base_m=(0.9, -0.3, 0.3), speed_mps=1.9),
        Withdraw(speed_mps=2.1),
        Wait(duration_s=0.013),
        MoveTo(position_in_base_m=(0.95, -0.5, 0.3), speed_mps=0.7),
    ),
    max_speed_mps=2.4,
    max_acceleration_mps2=90.0,
)
TREMBLES = replace(POKE, tremor=Tremor(amplitude_m=0.002, rate_hz=8.0))
HOLDS = JoinedHand(
    name="left", joined_to="right", apart_in_base_m=(0.0, 0.4, 0.1), elbow_towards_in_base_m=(1.6, 1.0, 0.3)
)
SHIPPED = Path(__file__).parents[3] / "scenarios"


def with_period(period_s: float, *hands: HandTrajectory, duration_s: float = 1.2) -> Trace:
    """The arm stands still."""
    settings = replace(DEFAULTS, clock=replace(DEFAULTS.clock, control_period_s=period_s))
    return run(
        scenario(*hands, duration_s=duration_s, settings=settings), controller=ConstantSpeed((0.0,) * 6)
    )


@pytest.mark.parametrize("who", [POKE, TREMBLES], ids=["poke", "trembles"])
@pytest.mark.parametrize("period_s", [0.008, 0.05])
def test_between_ticks_a_hand_leaves_its_chord_by_no_more_than_its_bend(
    period_s: float, who: MovingHand
) -> None:
    """Oracle: the same hand on a clock of 1 ms."""
    coarse, fine = with_period(period_s, who, HOLDS), with_period(0.001, who, HOLDS)
    paths = hand_paths(coarse)
    assert first_stray(coarse) is None
    assert len(paths.corner_at) == 0
    ratio = round(period_s / 0.001)
    at = np.arange(len(fine.ticks)) / ratio
    largest = np.zeros(2)
    for number in range(2):
        bend = np.append(hand_bend_m(coarse, paths, number), 0.0)
        for part, name in enumerate(("hand_position_in_base_m", "elbow_position_in_base_m")):
            rough, true = coarse.ticks[name][:, number], fine.ticks[name][:, number]
            chord = np.column_stack([np.interp(at, np.arange(len(rough)), column) for column in rough.T])
            off = np.linalg.norm(chord - true, axis=1)
            assert (off <= bend[np.minimum(at.astype(int), len(bend) - 1)] + 1e-9).all()
            largest[part] = max(largest[part], (off / np.maximum(bend[at.astype(int)], 1e-6)).max())
    assert (largest > 0.3).all()  # the bound is of the right size


def test_a_hand_at_rest_has_no_bend() -> None:
    resting = with_period(0.008, hand(), HOLDS)
    assert not hand_paths(resting).moving.any()
    assert not hand_bend_m(resting, hand_paths(resting), 0).any()
    poked = hand_paths(with_period(0.008, POKE)).moving[:, 0]
    assert poked[0]
    assert not poked[-5:].any()


@pytest.mark.parametrize("period_s", [0.008, 0.02, 0.05])
def test_a_hand_that_turns_within_a_tick_is_not_missed_there(period_s: float) -> None:
    trace = with_period(period_s, POKE)
    distance_m, time_s, *_ = closest_approach(trace, hand_paths(trace))
    finest = with_period(0.0005, POKE).ticks["hand_distance_m"][:, 0].min()
    bend_m = hand_bend_m(trace, hand_paths(trace), 0).max()
    assert finest - bend_m - 0.0002 < distance_m <= finest + 1e-9
    assert 0.0 < time_s < 1.2


def test_on_the_chords_alone_it_would_have_been_missed() -> None:
    trace = with_period(0.05, POKE)
    paths = hand_paths(trace)
    finest = with_period(0.0005, POKE).ticks["hand_distance_m"][:, 0].min()
    blind = replace(paths, moving=np.zeros_like(paths.moving))
    assert closest_approach(trace, blind)[0] > finest + 0.005


def test_the_moves_are_followed_bit_by_bit_along_the_arms_way() -> None:
    seeks = hand(
        ReachForTcp(speed_mps=1.0, until_distance_m=0.2, at_most_s=2.0),
        FollowTcp(speed_mps=0.4, distance_m=0.15, duration_s=0.7),
        Withdraw(speed_mps=1.0),
    )
    wander = Wander(speed_mps=1.0, corners_in_base_m=((0.9, -0.5, 0.2), (1.1, -0.3, 0.4)), duration_s=1.0)
    trembles = replace(TREMBLES, name="left", moves=(*POKE.moves, wander))
    trace = run(scenario(seeks, trembles, duration_s=2.5))
    paths = hand_paths(trace)
    followed = paths.positions_in_base_m
    assert np.array_equal(followed[:, :, 0], trace.ticks["hand_position_in_base_m"])
    assert np.array_equal(followed[:, :, 1], trace.ticks["elbow_position_in_base_m"])


def test_the_samples_of_a_recording_between_two_ticks_are_corners() -> None:
    recorded = replace(read_scenario(SHIPPED / "recorded-giving.yaml"), duration_s=0.4)
    trace = run_trial(admit(recorded))
    paths = hand_paths(trace)
    assert first_stray(trace) is None
    samples_s = recorded.hands[0].motion.time_s  # type: ignore[union-attr]
    between = (samples_s < 0.4) & ~np.isclose(samples_s / 0.008, np.round(samples_s / 0.008))
    assert between.any()
    assert np.all(np.isin(np.round(samples_s[between], 9), np.round(paths.corner_at * 0.008, 9)))


def test_a_sample_that_is_a_rounding_before_the_last_tick_is_at_it() -> None:
    last, period_s = 26, 0.008
    before_s = np.nextafter(last * period_s, 0.0)
    assert before_s / period_s == last
    recorded = read_scenario(SHIPPED / "recorded-giving.yaml")
    motion = recorded.hands[0].motion  # type: ignore[union-attr]
    time_s = motion.time_s.copy()
    time_s[np.searchsorted(time_s, before_s)] = before_s
    hands = (replace(recorded.hands[0], motion=replace(motion, time_s=time_s)),)  # type: ignore[type-var]
    trace = run_kinematic(admit(replace(recorded, hands=hands, duration_s=last * period_s)))
    paths = hand_paths(trace)
    assert paths.corner_at[-1] == last == len(trace.ticks) - 1
    least_m, *_ = closest_approach(trace, paths)
    assert least_m == pytest.approx(trace.ticks["hand_distance_m"][:, 0].min(), abs=1e-3)


def test_a_hand_that_is_joined_to_a_recording_has_its_corners_too() -> None:
    recorded = replace(read_scenario(SHIPPED / "recorded-giving.yaml"), duration_s=0.4)
    held = replace(HOLDS, joined_to=recorded.hands[0].name)
    trace = run_trial(admit(replace(recorded, hands=(*recorded.hands, held))))
    paths = hand_paths(trace)
    assert first_stray(trace) is None
    leads, follows = (paths.corner_hand == number for number in range(2))
    assert np.array_equal(paths.corner_at[leads], paths.corner_at[follows])
    apart = paths.corners_in_base_m[follows, 0] - paths.corners_in_base_m[leads, 0]
    assert apart == pytest.approx(np.tile(held.apart_in_base_m, (leads.sum(), 1)), abs=1e-12)
    assert np.linalg.norm(np.diff(paths.corners_in_base_m[follows], axis=1), axis=2) == pytest.approx(0.3)


def test_a_hand_that_is_not_the_scenarios_is_no_evidence(visit: Trace) -> None:
    ticks = visit.ticks.copy()
    ticks["hand_position_in_base_m"][20:, 0] += 1e-3
    evaluation = HandDistance(minimum_m=0.05, near_m=0.4).evaluate(replace(visit, ticks=ticks))
    assert evaluation.verdict is Verdict.INCONCLUSIVE
    assert "tick 20" in evaluation.reason


def test_joints_that_change_their_speed_lower_the_bound(visit: Trace) -> None:
    """Oracle: what accelerates uniformly leaves its chord by a dt^2/8; at the speed of its end by nothing."""
    assert joint_bend_m(visit).max() < 1e-7
    dt_s, ticks = 0.008, visit.ticks.copy()
    ticks["joint_velocity_radps"][50:, 0] += 1.0
    ticks["joint_position_rad"][50:, 0] += 0.5 * dt_s + dt_s * np.arange(len(ticks) - 50)
    kinematic = replace(visit.provenance, world="kinematic")
    changed_m = joint_bend_m(replace(visit, ticks=ticks, provenance=kinematic))
    reach_m = np.linalg.norm(visit.ticks["transform_tcp_to_base"][49, :2, 3])  # from the pan's axis
    assert changed_m[49] > 1.0 * dt_s / 8.0 * reach_m
    assert changed_m[[*range(49), *range(50, 500)]].max() < 1e-7
