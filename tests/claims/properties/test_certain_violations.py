"""A claim of distance is violated only if both ends of the least distance are below its limit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples import ConstantSpeed, hand, run, scenario

from safety_harness import load_trace, save_trace
from safety_harness.base.settings import DEFAULTS
from safety_harness.cell.controller.records import parameters_dtype
from safety_harness.cell.controller.stack import clip_joints
from safety_harness.cell.robot.robots import arm_model
from safety_harness.claims.formulas.claim import FormulaClaim
from safety_harness.claims.formulas.language import always, hand_distance, m
from safety_harness.claims.properties.base import Unit, judged
from safety_harness.claims.properties.clear_ways import least_along
from safety_harness.claims.properties.hand_distance import RESOLUTION_M, HandDistance
from safety_harness.claims.properties.touching import NoMovingPartTouches
from safety_harness.claims.signals.hand_distance import closest_approach, joint_bend_m, known_to
from safety_harness.claims.signals.true_motion import finer_paths, hand_paths
from safety_harness.scenario.model import MovingHand, Robot, Verdict
from safety_harness.scenario.moves import MoveTo, ReachForTcp, Tremor, Withdraw
from safety_harness.trace.compare import first_difference
from safety_harness.trace.trace import Trace, not_recorded

POKE = replace(
    hand(MoveTo(position_in_base_m=(0.9, -0.3, 0.3), speed_mps=1.9), Withdraw(speed_mps=2.1)),
    max_speed_mps=2.4,
    max_acceleration_mps2=90.0,
)
SHAKES = replace(POKE, tremor=Tremor(amplitude_m=0.002, rate_hz=8.0))
REACHES = replace(POKE, moves=(ReachForTcp(speed_mps=1.5, until_distance_m=0.2, at_most_s=2.0),))


def with_period(period_s: float, who: MovingHand) -> Trace:
    """The arm stands still."""
    settings = replace(DEFAULTS, clock=replace(DEFAULTS.clock, control_period_s=period_s))
    moved = scenario(who, duration_s=0.8, settings=settings)
    return run(moved, controller=ConstantSpeed((0.0,) * 6))


def said(trace: Trace, minimum_m: float) -> Verdict:
    return HandDistance(minimum_m=minimum_m, near_m=1.0).evaluate(trace).verdict


@pytest.mark.parametrize("who", [POKE, SHAKES], ids=["poke", "shakes"])
def test_a_distance_just_above_its_limit_is_no_violation(who: MovingHand) -> None:
    """Oracle: the same hand on a clock of 0.5 ms.  On one of 8 ms its acceleration leaves 0.7 mm open."""
    trace, true_m = with_period(0.008, who), with_period(0.0005, who).ticks["hand_distance_m"][:, 0].min()
    coarse = closest_approach(trace, hand_paths(trace))
    assert coarse.low_m < true_m - 4e-4
    assert said(trace, true_m - 3e-4) is Verdict.HOLDS
    assert said(trace, true_m + 3e-4) is Verdict.VIOLATED


@pytest.mark.parametrize("who", [POKE, SHAKES], ids=["poke", "shakes"])
def test_both_ends_lie_about_the_least_distance_within_a_fifth_of_a_millimetre(who: MovingHand) -> None:
    trace = with_period(0.008, who)
    paths = hand_paths(trace)
    found = known_to(closest_approach(trace, paths).high_m, closest_approach, trace, paths)
    assert 0.0 <= found.high_m - found.low_m < 2.0 * RESOLUTION_M
    true_m = with_period(0.0005, who).ticks["hand_distance_m"][:, 0].min()
    assert found.low_m <= true_m <= found.high_m + 1e-5


@pytest.mark.parametrize("who", [POKE, SHAKES, REACHES], ids=["poke", "shakes", "reaches"])
def test_the_parts_of_a_tick_are_where_the_hand_was(who: MovingHand) -> None:
    """Oracle: the moves on a clock 16 times as fast; a hand that heads for the TCP turns evenly in a tick."""
    trace = with_period(0.008, who)
    paths = finer_paths(trace)
    assert (paths.parts[paths.moving] > 1).mean() > 0.9
    if who is REACHES:
        ticks = paths.corner_at[paths.corner_at % 1.0 == 0.5].astype(int)
        middles = paths.corners_in_base_m[paths.corner_at % 1.0 == 0.5, 0]
        ends = trace.ticks["hand_position_in_base_m"][:, 0]
        off_m = np.linalg.norm(middles - 0.5 * (ends[ticks] + ends[ticks + 1]), axis=1)
        assert off_m.max() <= 90.0 * 0.008**2 / 8.0 + 1e-9
        return
    fine = with_period(0.0005, who).ticks["hand_position_in_base_m"][:, 0]
    then = fine[np.round(paths.corner_at * 16).astype(int)]
    assert paths.corners_in_base_m[:, 0] == pytest.approx(then, abs=1e-9)


def test_a_hand_that_leaves_the_point_of_its_elbow_is_not_called_a_touch() -> None:
    """The elbow may turn over within that tick: nothing certain was below zero."""
    at = (1.25, 0.0, 0.4)
    leaves = MovingHand(
        name="right hand",
        starts_at_in_base_m=at,
        elbow_towards_in_base_m=at,
        moves=(MoveTo(position_in_base_m=(1.6, 0.0, 0.4), speed_mps=1.0),),
    )
    trace = run(scenario(leaves, duration_s=0.6), controller=ConstantSpeed((0.05,) * 6))
    recorded_m = trace.ticks["hand_distance_m"][:, 0].min()
    assert recorded_m > 0.05
    for prop in (NoMovingPartTouches(near_m=2.0), HandDistance(minimum_m=0.05, near_m=2.0)):
        found = prop.evaluate(trace)
        assert found.verdict is Verdict.INCONCLUSIVE
        assert found.margin < 0.0
        assert "between -" in found.reason
        assert " and +" in found.reason


def test_a_hand_that_leaves_the_point_of_its_elbow_farther_off_touches_nothing() -> None:
    """Its forearm ends 285 mm beyond the hand's sphere at most, wherever the elbow turns."""
    at = (1.43, 0.0, 0.4)
    leaves = MovingHand(
        name="right hand",
        starts_at_in_base_m=at,
        elbow_towards_in_base_m=at,
        moves=(MoveTo(position_in_base_m=(1.9, 0.0, 0.4), speed_mps=1.0),),
    )
    trace = run(scenario(leaves, duration_s=0.6), controller=ConstantSpeed((0.05,) * 6))
    recorded_m = trace.ticks["hand_distance_m"][:, 0].min()
    assert 0.3 < recorded_m < 0.31
    found = NoMovingPartTouches(near_m=2.0).evaluate(trace)
    assert found.verdict is Verdict.HOLDS
    assert 0.005 < found.margin < recorded_m
    assert said(trace, recorded_m + 1e-4) is Verdict.VIOLATED


def test_a_violation_at_a_tick_is_certain_beside_a_wide_bound() -> None:
    prop = HandDistance(minimum_m=0.05, near_m=1.0)
    trace = with_period(0.008, hand())
    for low, most, verdict in (
        (-1.0, -0.1, Verdict.VIOLATED),
        (-1.0, 0.1, Verdict.INCONCLUSIVE),
        (0.1, 0.2, Verdict.HOLDS),
        (-np.inf, -0.1, Verdict.VIOLATED),
        (-np.inf, 0.1, Verdict.INCONCLUSIVE),
    ):
        found = judged(prop, trace, low, 0.0, "a part", 1, most=most)
        assert found.verdict is verdict
        assert found.unit is Unit.LENGTH


def test_a_clearance_between_samples_is_found_to_its_limit() -> None:
    """Oracle: a point that circles at 1 m has its least clearance of a plane half-way, in closed form."""

    def height_m(joints_rad: np.ndarray) -> np.ndarray:
        return 1.0 - np.cos(joints_rad)

    joints_rad, reach_m = np.array([[-0.02], [0.018]]), np.array([1.0])
    low_m, high_m, _ = least_along(height_m, joints_rad, reach_m, 0.0, -0.05)
    assert low_m[0] == pytest.approx(-0.019, abs=5e-4)  # what the ends alone tell
    assert high_m[0] == pytest.approx(1.0 - np.cos(0.018))
    low_m, high_m, _ = least_along(height_m, joints_rad, reach_m, 0.0, -0.001)
    assert -0.0015 < low_m[0] <= 0.0 <= high_m[0] < 1e-5


def saturated() -> Trace:
    """A run in PyBullet, in one tick of which joints are said to have gone faster in between."""
    trace = with_period(0.008, hand())
    beyond = np.where(np.arange(len(trace.ticks))[:, None] == 20, 0.6, np.zeros(6))
    return replace(trace, overshoot_radps=beyond)


def test_what_sub_steps_went_beyond_both_ticks_widens_the_bound() -> None:
    trace = saturated()
    bend_m = joint_bend_m(trace)
    assert bend_m[20] > 1e-3
    assert np.delete(bend_m, 20).max() < 1e-7
    near_m = trace.ticks["hand_distance_m"][:, 0].min()
    assert said(trace, near_m - 1e-3) is Verdict.INCONCLUSIVE
    assert said(trace, near_m - 0.1) is Verdict.HOLDS
    assert said(trace, near_m + 1e-3) is Verdict.VIOLATED


def test_where_nobody_recorded_sub_steps_a_mean_speed_that_is_not_the_last_decides_nothing() -> None:
    trace = replace(with_period(0.008, hand()), overshoot_radps=not_recorded())
    near_m = trace.ticks["hand_distance_m"][:, 0].min()
    assert said(trace, near_m - 1e-3) is Verdict.HOLDS
    ticks = trace.ticks.copy()
    ticks["joint_velocity_radps"][21, 5] += 0.1
    late = replace(trace, ticks=ticks)
    for below_m, verdict in ((1e-3, Verdict.INCONCLUSIVE), (-1e-3, Verdict.VIOLATED)):
        assert said(late, near_m - below_m) is verdict
        formula = FormulaClaim(always(hand_distance() >= m(near_m - below_m))).evaluate(late)
        assert formula.verdict is verdict
        assert formula.reason.startswith(
            "between the ticks nothing is known, as motors" if below_m > 0 else "hand"
        )


def test_an_engine_records_what_its_sub_steps_went_beyond(tmp_path: Path) -> None:
    trace = with_period(0.008, hand())
    assert trace.overshoot_radps.shape == (len(trace.ticks), 6)
    save_trace(saturated(), tmp_path / "a.trace")
    again = load_trace(tmp_path / "a.trace")
    assert np.array_equal(again.overshoot_radps, saturated().overshoot_radps)
    assert first_difference(again, replace(again, overshoot_radps=2.0 * again.overshoot_radps)) is not None
    assert first_difference(again, replace(again, overshoot_radps=not_recorded())) is None


def test_a_limiter_cuts_what_scaling_leaves_above_a_limit() -> None:
    """Scaled by limit/rate, a rate may be the float above the limit, which the claim calls violated."""
    limit_radps = np.array(arm_model(Robot.UR10).velocity_limit_radps)
    parameters = np.zeros(1, parameters_dtype(6))
    parameters["joint_velocity_limit_radps"] = limit_radps
    above = 0
    for factor in np.linspace(1.001, 3.0, 500):
        demanded_radps = factor * limit_radps
        scaled_radps = (limit_radps / demanded_radps) * demanded_radps
        above += int((scaled_radps > limit_radps).any())
        clip_joints(parameters, scaled_radps)
        assert (scaled_radps <= limit_radps).all()
    assert above > 0
