"""Shrinking ends at a simple scenario that still violates, within its budget, and then changes no more."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import radians
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from safety_harness.base.settings import DEFAULTS
from safety_harness.base.shipped.contents import located
from safety_harness.scenario.faults import HandSensorBlind, Joint, JointStuck
from safety_harness.scenario.model import Claim, MovingHand, OffsetStart, RecordedHand, Scenario, Verdict
from safety_harness.scenario.moves import MoveTo, ReachForTcp, Tremor, Wait, Withdraw
from safety_harness.scenario.read import parse_scenario, read_scenario
from safety_harness.scenario.write import write_scenario
from safety_harness.search.shrink import shrink
from safety_harness.space.read import read_space
from tests.examples import hand, scenario

CLAIMS = (Claim(sentence="joint speeds within limits", expected=Verdict.HOLDS),)
ELABORATE = replace(
    scenario(
        replace(
            hand(
                Wait(duration_s=0.8123),
                MoveTo(position_in_base_m=(0.5431, -0.3217, 0.2519), speed_mps=1.3371),
                Wait(duration_s=1.4142),
                ReachForTcp(speed_mps=1.1111, until_distance_m=0.1234, at_most_s=2.2222),
                Withdraw(speed_mps=0.7777),
            ),
            tremor=Tremor(amplitude_m=0.003, rate_hz=8.0),
            delay_s=0.3333,
        ),
        hand(MoveTo(position_in_base_m=(0.9, 0.4, 0.3), speed_mps=0.5), name="left"),
        duration_s=7.7777,
        offset=(0.0312, -0.1173, 0.0444),
        tilt=(0.0213, 0.0, -0.0101),
        settings=replace(DEFAULTS, avoidance=replace(DEFAULTS.avoidance, radius_m=0.12)),
        seed=987654321,
    ),
    faults=(HandSensorBlind(from_s=1.2345, for_s=0.4), JointStuck(joint=Joint.ELBOW, from_s=2.0)),
    claims=CLAIMS,
)


def fastest_mps(tried: Scenario) -> float:
    return max(
        (
            move.speed_mps
            for hand in tried.hands
            if isinstance(hand, MovingHand)
            for move in hand.moves
            if not isinstance(move, Wait)
        ),
        default=0.0,
    )


def too_fast(tried: Scenario) -> bool:
    return fastest_mps(tried) > 0.7342


def long_enough(tried: Scenario) -> bool:
    return tried.duration_s > 2.9


def far_aside(tried: Scenario) -> bool:
    return isinstance(tried.start, OffsetStart) and tried.start.offset_in_base_m[1] <= -0.0517


def blind(tried: Scenario) -> bool:
    return any(isinstance(fault, HandSensorBlind) and fault.from_s > 0.5 for fault in tried.faults)


def test_what_does_not_matter_is_gone_and_what_does_is_a_round_number() -> None:
    shrunk = shrink(ELABORATE, too_fast, budget=500)
    assert shrunk.settled
    left = shrunk.scenario
    assert left.faults == ()
    assert left.settings == DEFAULTS
    assert left.start == OffsetStart(offset_in_base_m=(0.0, 0.0, 0.0))
    assert left.duration_s == 0.1
    assert left.seed == 0
    assert len(left.hands) == 1
    (only,) = left.hands
    assert isinstance(only, MovingHand)
    assert only.tremor is None
    assert only.delay_s == 0.0
    assert len(only.moves) == 1
    assert fastest_mps(left) == 0.8


@pytest.mark.parametrize(
    ("violates", "value", "expected"),
    [
        (long_enough, lambda s: s.duration_s, 3.0),
        (far_aside, lambda s: s.start.offset_in_base_m, (0.0, -0.06, 0.0)),
        (blind, lambda s: s.faults[0].from_s, 0.6),
    ],
)
def test_a_number_comes_as_near_to_its_simplest_as_violates(
    violates: Callable[[Scenario], bool], value: Callable[[Scenario], object], expected: object
) -> None:
    assert value(shrink(ELABORATE, violates, budget=500).scenario) == expected


def test_a_number_that_no_round_one_can_replace_keeps_the_digits_it_needs() -> None:
    def just_so(tried: Scenario) -> bool:
        return 0.7342 < fastest_mps(tried) < 0.7348

    begin = replace(ELABORATE, hands=(hand(Withdraw(speed_mps=0.73456789)),))
    shrunk = shrink(begin, just_so, budget=500)
    assert shrunk.settled
    assert fastest_mps(shrunk.scenario) == 0.73456789


def test_angles_are_round_in_degrees() -> None:
    def tilted(tried: Scenario) -> bool:
        return isinstance(tried.start, OffsetStart) and tried.start.tilt_in_tcp_rad[0] > radians(0.7)

    start = shrink(ELABORATE, tilted, budget=500).scenario.start
    assert isinstance(start, OffsetStart)
    assert start.tilt_in_tcp_rad == (radians(1.0), 0.0, 0.0)


@pytest.mark.parametrize("budget", [1, 2, 7, 20])
def test_a_budget_that_is_too_small_is_kept_and_said(budget: int) -> None:
    runs = 0

    def counted(tried: Scenario) -> bool:
        nonlocal runs
        runs += 1
        return too_fast(tried)

    shrunk = shrink(ELABORATE, counted, budget=budget)
    assert shrunk.used == runs == budget
    assert not shrunk.settled
    assert too_fast(shrunk.scenario)


def test_ctrl_c_keeps_what_was_reached() -> None:
    runs = 0

    def interrupted(tried: Scenario) -> bool:
        nonlocal runs
        runs += 1
        if runs == 5:
            raise KeyboardInterrupt
        return too_fast(tried)

    shrunk = shrink(ELABORATE, interrupted, budget=500)
    assert shrunk.interrupted
    assert not shrunk.settled
    assert shrunk.scenario != ELABORATE
    assert too_fast(shrunk.scenario)


def test_an_own_arm_stays_and_what_a_file_cannot_say_of_it_is_not_tried_for_ever() -> None:
    """Its stop times are among the settings, and stand in a file with the arm."""
    found = read_scenario(located("shipped:robot-ur10e"))
    shrunk = shrink(found, lambda tried: len(tried.hands) == 1, budget=2_000)
    assert shrunk.settled
    assert shrunk.scenario.robot == found.robot
    assert shrunk.scenario.settings.braking == found.settings.braking != DEFAULTS.braking


def test_nothing_that_cannot_be_read_back_is_ever_run() -> None:
    """A claim is needed, speeds have bounds; the file of what came out is what came out."""

    def seen(tried: Scenario) -> bool:
        assert parse_scenario(write_scenario(tried), name=tried.name) == tried
        return long_enough(tried)

    shrink(ELABORATE, seen, budget=500)


@settings(max_examples=15, deadline=None)
@given(
    least_mps=st.floats(0.1, 1.3),
    least_s=st.floats(0.1, 7.0),
    where=st.floats(-0.11, 0.0),
    wild=st.integers(0, 6),
)
def test_the_result_violates_and_shrinking_it_changes_nothing(
    least_mps: float, least_s: float, where: float, wild: int
) -> None:
    """Whatever the boundary is like: ``wild`` makes it depend on digits that nobody would expect."""

    def violates(tried: Scenario) -> bool:
        start = tried.start
        return (
            fastest_mps(tried) >= least_mps
            and tried.duration_s >= least_s
            and isinstance(start, OffsetStart)
            and start.offset_in_base_m[1] <= where
            and (wild == 0 or round(tried.duration_s * 1000) % 7 != wild)
        )

    begin = replace(ELABORATE, duration_s=7.777)
    if not violates(begin):
        return
    shrunk = shrink(begin, violates, budget=2000)
    assert shrunk.settled
    assert violates(shrunk.scenario)
    again = shrink(shrunk.scenario, violates, budget=2000)
    assert again.scenario == shrunk.scenario
    assert again.steps == ()


def test_the_same_twice_and_nothing_random_in_it() -> None:
    first, second = (shrink(ELABORATE, too_fast, budget=100) for _ in range(2))
    assert first == second


def test_a_recorded_hand_keeps_its_recording_and_loses_its_variations() -> None:
    folder = Path(__file__).parents[2] / "scenarios/spaces"
    drawn = read_space(folder / "recorded-variations.yaml").draw(seed=3, k=0)
    shrunk = shrink(drawn, lambda tried: len(tried.hands) == 1, budget=300).scenario
    (only,) = shrunk.hands
    assert isinstance(only, RecordedHand)
    assert (only.turn_rad, only.speed_factor) == (0.0, 1.0)
    assert shrunk.settings == DEFAULTS
