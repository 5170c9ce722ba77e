"""Each signal is what it says at the ticks, and what lies between them is within its bounds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from safety_harness.admission.admit import admit
from safety_harness.admission.trial import run_trial
from safety_harness.base.geometry.rotations import vector_from_rotation
from safety_harness.cell.controller.desired import desired_transform_tcp_to_base
from safety_harness.cell.robot.capsules import load_capsules
from safety_harness.cell.robot.description import load_arm
from safety_harness.cell.robot.distance import hand_distance, place_capsules
from safety_harness.cell.robot.kinematics import forward_kinematics
from safety_harness.cell.simulation.truth import cell_capsules
from safety_harness.claims.formulas.measures import Flag, Measure
from safety_harness.claims.formulas.signals import SIGNALS
from safety_harness.claims.signals.signal import Interpolation, Sampled, lipschitz_bounds
from safety_harness.scenario.read import read_scenario
from safety_harness.trace.records import DecisionOutcome, Mode
from safety_harness.trace.trace import Trace

SCENARIOS = Path(__file__).parents[3] / "scenarios"
FRACTIONS = (0.25, 0.5, 0.75)
ROUNDING = 1e-9
BY_WORDS = {signal.words: signal for signal in SIGNALS}


@pytest.fixture(scope="module")
def two_hands() -> Trace:
    return run_trial(admit(read_scenario(SCENARIOS / "between-two-hands.yaml")))


def sampled(words: str, trace: Trace) -> Sampled:
    return BY_WORDS[words].sample(trace)


def test_no_two_signals_have_the_same_words_and_none_is_an_operator() -> None:
    assert len(BY_WORDS) == len(SIGNALS)
    for signal in SIGNALS:
        assert signal.meaning
        assert isinstance(signal, Flag if signal.dimension is None else Measure)
        assert not {"and", "or", "not", "until", "then", "within", "always"} & set(signal.words.split())


@pytest.mark.parametrize("words", BY_WORDS)
def test_every_signal_has_a_value_for_each_tick_within_its_bounds(words: str, visit: Trace) -> None:
    one = sampled(words, visit)
    assert len(one.value) == len(one.low) == len(one.high) == len(visit.ticks)
    if words == "fault acting":
        assert one.absent
        return
    assert not one.absent
    known = ~np.isnan(one.value)
    assert known.any()
    assert np.all(one.low[known] <= one.value[known])
    assert np.all(one.value[known] <= one.high[known])
    if BY_WORDS[words].between is not Interpolation.BOUNDED:
        assert one.low is one.value is one.high


def test_truths_are_those_of_the_records(two_hands: Trace) -> None:
    mode = two_hands.ticks["mode"]
    for words, code in (("servoing", 0), ("repulsing", 1), ("stopped", 2), ("object lost", 3)):
        assert np.array_equal(sampled(words, two_hands).value, (mode == code).astype(float))
    stops = sampled("falling back", two_hands).value == 1.0
    assert stops.any()
    assert np.array_equal(stops, mode == Mode.PROTECTIVE_STOP)
    assert two_hands.decisions["outcome"][0] == DecisionOutcome.STOP
    made = np.flatnonzero(sampled("deciding", two_hands).value)
    assert np.array_equal(made, two_hands.decisions["tick"])


def test_the_spread_is_that_of_the_decision_in_force() -> None:
    stays = run_trial(admit(replace(read_scenario(SCENARIOS / "hand-stays.yaml"), duration_s=4.0)))
    spread = sampled("spread", stays).value
    first, second = stays.decisions[:2]
    assert np.all(np.isnan(spread[: first["tick"]]))
    assert spread[first["tick"]] == spread[second["tick"] - 1] == first["proposed_spread_m"].max()
    assert spread[second["tick"]] == second["proposed_spread_m"].max()


def poses(trace: Trace, fraction: float) -> NDArray[np.float64]:
    """(n-1, 8, 4, 4) the links a part of the way from each tick to the next, joints turning evenly."""
    arm = load_arm(trace.scenario.robot.arm_name)
    joints = trace.ticks["joint_position_rad"]
    between = joints[:-1] + fraction * (joints[1:] - joints[:-1])
    placed = np.empty((len(between), 8, 4, 4))
    for one, q in zip(placed, between, strict=True):
        forward_kinematics(arm.chain[0], q, one)
    return placed


def encloses(one: Sampled, between: NDArray[np.float64]) -> None:
    assert np.all(one.low[:-1] <= between + ROUNDING)
    assert np.all(between <= one.high[:-1] + ROUNDING)


@pytest.mark.parametrize("fraction", FRACTIONS)
def test_what_the_tcp_does_between_ticks_is_within_the_bounds(two_hands: Trace, fraction: float) -> None:
    tcp = poses(two_hands, fraction)[:, 7]
    desired = desired_transform_tcp_to_base(two_hands.scenario.settings)
    encloses(sampled("TCP height", two_hands), tcp[:, 2, 3])
    away = np.linalg.norm(tcp[:, :3, 3] - desired[:3, 3], axis=1)
    encloses(sampled("distance to desired pose", two_hands), away)
    turns = desired[:3, :3].T @ tcp[:, :3, :3]
    angle = [np.linalg.norm(vector_from_rotation(np.ascontiguousarray(turn))) for turn in turns]
    encloses(sampled("angle to desired pose", two_hands), np.array(angle))
    hands = two_hands.ticks["hand_position_in_base_m"][:, :2]
    moved = hands[:-1] + fraction * (hands[1:] - hands[:-1])
    nearest = np.linalg.norm(moved - tcp[:, None, :3, 3], axis=2).min(axis=1)
    encloses(sampled("nearest hand to TCP", two_hands), nearest)


@pytest.mark.parametrize("fraction", FRACTIONS)
def test_the_hand_distance_between_ticks_is_within_the_bounds(two_hands: Trace, fraction: float) -> None:
    settings = two_hands.scenario.settings
    capsules = cell_capsules(load_capsules(two_hands.scenario.robot.arm_name), settings)
    placed = np.empty((len(capsules.names), 2, 3))
    ends = [two_hands.ticks[name][:, :2] for name in ("hand_position_in_base_m", "elbow_position_in_base_m")]
    hand, elbow = (end[:-1] + fraction * (end[1:] - end[:-1]) for end in ends)
    between = np.empty(len(two_hands.ticks) - 1)
    for k, transforms in enumerate(poses(two_hands, fraction)):
        place_capsules(capsules.records, transforms, placed)
        between[k] = min(
            hand_distance(
                capsules.records,
                placed,
                hand[k, i],
                elbow[k, i],
                settings.hand.radius_m,
                settings.hand.forearm_radius_m,
            )[0]
            for i in range(2)
        )
    encloses(sampled("hand distance", two_hands), between)


def test_the_speeds_between_ticks_count_with_their_mean(visit: Trace) -> None:
    ticks = visit.ticks.copy()
    ticks["joint_position_rad"][50:, 0] += 0.01  # a jump that the speeds at the ticks do not show
    jump = replace(visit, ticks=ticks)
    high = sampled("joint speed", jump).high
    assert np.argmax(high) == 49
    assert high[49] == pytest.approx(0.01 / 0.008, abs=0.2)


@given(
    st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=20),
    st.floats(0.0, 1.0),
    st.integers(1, 20),
)
def test_a_signal_is_within_the_tent_of_its_way(steps: list[float], before: float, parts: int) -> None:
    """A random walk seen at its ends only; the way is the sum of its steps."""
    walk = before + np.append(0.0, np.cumsum(steps))
    low, high = lipschitz_bounds(walk[0], walk[-1], np.abs(steps).sum(), 0.0)
    assert low - ROUNDING <= walk.min()
    assert walk.max() <= high + ROUNDING
