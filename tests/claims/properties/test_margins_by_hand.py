"""Margins where the arithmetic can be done by hand: records edited for it, closed forms written out."""

from __future__ import annotations

from dataclasses import replace
from math import log, radians, sqrt

import numpy as np
import pytest
from examples import VISIT, run, scenario

from safety_harness.base.settings import DEFAULTS
from safety_harness.cell.avoidance.gate import REACH_MARGIN_M
from safety_harness.claims.properties.fallback import FallbackPoses
from safety_harness.claims.properties.finite import FiniteTrace, bad_decisions
from safety_harness.claims.properties.hand_prediction import HandPredictions
from safety_harness.claims.properties.limits import TcpAcceleration
from safety_harness.claims.properties.positions import RepulsivePosesReachable, opposite_position, spare_m
from safety_harness.claims.properties.protective_separation import ProtectiveSeparation
from safety_harness.claims.properties.servoing import Converged, GainSwitchIterations, GainSwitchReached
from safety_harness.claims.properties.spread_calibration import (
    IntervalRule,
    SpreadCalibration,
    Target,
    target_in_base_m,
)
from safety_harness.claims.signals.hand_distance import instants
from safety_harness.claims.signals.true_motion import hand_bend_m, hand_paths
from safety_harness.scenario.faults import AvoiderLate
from safety_harness.scenario.model import Verdict
from safety_harness.scenario.moves import Tremor
from safety_harness.trace.store import DECISION_3, as_now
from safety_harness.trace.trace import Trace

RADIUS_M = DEFAULTS.avoidance.radius_m


def with_decisions(trace: Trace, **changes: object) -> Trace:
    """The first decision with other values."""
    decisions = trace.decisions.copy()
    for name, value in changes.items():
        decisions[name][0] = value
    return replace(trace, decisions=decisions)


def twice(trace: Trace) -> Trace:
    """Its first decision made once more at the same time."""
    return replace(
        trace,
        decisions=np.concatenate([trace.decisions[:1]] * 2),
        decision_latency_s=np.concatenate([trace.decision_latency_s[:1]] * 2),
    )


def test_a_decision_no_later_than_the_one_before_is_bad(visit: Trace) -> None:
    assert bad_decisions(twice(visit)).tolist() == [False, True]
    assert not bad_decisions(visit).any()


def test_a_single_tick_is_looked_at(visit: Trace) -> None:
    one = replace(
        visit,
        ticks=visit.ticks[:1].copy(),
        decisions=visit.decisions[:0].copy(),
        decision_latency_s=np.zeros(0),
        ended="interrupted",
    )
    assert FiniteTrace().evaluate(one).exercised == 1


def test_a_late_answer_is_waited_for_from_its_own_question_on(visit: Trace) -> None:
    faults = (AvoiderLate(delay_s=0.05, from_s=0.0, until_s=1.0),)
    ticks = visit.ticks.copy()
    ticks["faults"] = 0
    ticks["faults"][:10] = 1
    decisions = np.zeros(3, DECISION_3)
    decisions["tick"] = [5, 9, 20]
    assert (decisions["tick"] - as_now(decisions, ticks, faults)["asked_tick"]).tolist() == [5, 3, 0]


def test_a_fallback_that_is_nowhere_is_a_radius_short_of_every_hand(visit: Trace) -> None:
    nowhere = with_decisions(visit, opposite_position_in_base_m=np.nan)
    reachable, away = FallbackPoses().evaluate(nowhere).parts
    for part in (reachable, away):
        assert part.margin == -RADIUS_M
        assert part.verdict is Verdict.VIOLATED
        assert part.worst_time_s == visit.decisions["time_s"][0]


def test_no_position_is_opposite_to_a_hand_at_the_tcp_or_nowhere(visit: Trace) -> None:
    ticks, decision = visit.ticks.copy(), visit.decisions[0]
    tick = ticks[int(decision["tick"])]
    for hand in (tick["transform_tcp_to_base"][:3, 3].copy(), np.full(3, np.nan)):
        tick["track_valid"] = False
        tick["track_valid"][0] = True
        tick["predicted_hand_in_base_m"][0] = hand
        found = opposite_position(replace(visit, ticks=ticks), decision)
        assert found.dtype == np.float64
        assert np.isnan(found).tolist() == [True] * 3


def test_the_forearm_is_told_from_the_hand_and_its_ways_are_counted() -> None:
    """Of a hand that comes its own ball is nearer; of one held back, its forearm across the arm."""
    across = replace(
        VISIT, moves=(), starts_at_in_base_m=(0.2, -0.9, 0.4), elbow_towards_in_base_m=(0.3, 0.3, 0.4)
    )
    for moved, forearm in ((VISIT, False), (across, True)):
        trace = run(scenario(moved, duration_s=0.5))
        prop = ProtectiveSeparation()
        worst = prop.worst(trace)
        assert worst is not None
        assert worst.forearm is forearm
        assert ("'s forearm" in prop.evaluate(trace).reason) is forearm
        assert worst.required_m > replace(worst, hand_moves_m=0.0, robot_moves_m=0.0).required_m


def test_a_run_too_short_for_its_iterations_has_no_margin_of_them() -> None:
    trace = run(scenario(duration_s=0.8))
    found = GainSwitchIterations(within=600).evaluate(trace)
    timed = GainSwitchReached(within_s=600.5 * DEFAULTS.clock.control_period_s).evaluate(trace)
    assert found.verdict is timed.verdict is Verdict.INCONCLUSIVE
    assert found.margin is timed.margin is None
    assert found.sentence == "gain switch reached within 600 iterations"


def test_hands_that_are_no_numbers_are_no_evidence_of_their_prediction(visit: Trace) -> None:
    ticks = visit.ticks.copy()
    ticks["hand_position_in_base_m"][50, 0] = np.nan
    evaluation = HandPredictions(maximum_m=0.05).evaluate(replace(visit, ticks=ticks))
    assert evaluation.verdict is Verdict.INCONCLUSIVE
    assert "hand_position_in_base_m is not finite" in evaluation.reason


def test_a_position_that_is_nowhere_lacks_the_gate_s_margin_too(visit: Trace) -> None:
    nowhere = np.full(3, np.nan)
    assert spare_m(visit, visit.decisions[0], nowhere) == pytest.approx(-RADIUS_M - REACH_MARGIN_M)


def test_from_a_hand_at_the_tcp_itself_any_way_leads_away(visit: Trace) -> None:
    ticks = visit.ticks.copy()
    tick = int(visit.decisions["tick"][0])
    tcp = ticks["transform_tcp_to_base"][tick, :3, 3]
    ticks["hand_position_in_base_m"][tick, 0] = tcp
    edited = replace(with_decisions(visit, opposite_position_in_base_m=tcp + [0.0, 0.03, 0.04]), ticks=ticks)
    away = FallbackPoses().evaluate(edited).parts[1]
    assert away.margin == pytest.approx(0.05)


@pytest.mark.parametrize("proposed", [True, False])
def test_a_position_that_is_nowhere_is_a_radius_out_of_reach(proposed: bool, visit: Trace) -> None:
    field = "proposed_position_in_base_m" if proposed else "chosen_position_in_base_m"
    evaluation = RepulsivePosesReachable(proposed=proposed).evaluate(with_decisions(visit, **{field: np.nan}))
    assert evaluation.margin == -RADIUS_M
    assert evaluation.verdict is Verdict.VIOLATED


def test_convergence_takes_the_closed_form_a_quarter_more_and_a_second(visit: Trace) -> None:
    servo = visit.scenario.settings.servo
    switch_m = sqrt(servo.gain_switch_sse)
    near_s = log(switch_m / 1e-3) / servo.gain_near
    for distance_m, free_s in (
        (1e-3, 0.0),
        (switch_m, near_s),
        (3.0 * switch_m, log(3.0) / servo.gain_far + near_s),
    ):
        assert Converged()._needed_s(visit, distance_m) == pytest.approx(1.25 * free_s + 1.0)


def test_a_wrong_angle_at_the_end_counts_as_a_way_at_the_object_s_depth() -> None:
    trace = run(scenario(duration_s=25.0, offset=(0.003, 0.0, 0.0)))
    before = Converged().evaluate(trace)
    assert before.verdict is Verdict.HOLDS
    turned = radians(1.0)
    ticks = trace.ticks.copy()
    about_z = np.eye(3)
    about_z[:2, :2] = [[np.cos(turned), -np.sin(turned)], [np.sin(turned), np.cos(turned)]]
    end = ticks["transform_tcp_to_base"][-1]
    end[:3, :3] = end[:3, :3] @ about_z
    after = Converged().evaluate(replace(trace, ticks=ticks))
    settings = trace.scenario.settings
    depth_m = settings.cell.desired_tcp_position_in_base_m[2] - settings.object.position_in_base_m[2]
    assert after.margin == pytest.approx(-radians(0.9) * depth_m, rel=0.02)  # it was not quite right before


def test_the_tcp_is_quick_at_as_many_ticks_as_its_record_says(visit: Trace) -> None:
    moving = int(np.count_nonzero(visit.ticks["tcp_speed_mps"] > 0.001))
    assert TcpAcceleration(maximum_mps2=2.0).evaluate(visit).exercised == pytest.approx(moving, rel=0.1)


def test_how_far_an_elbow_may_leave_its_chord_is_the_documented_bound() -> None:
    tremor = Tremor(amplitude_m=0.002, rate_hz=6.0)
    shaking = replace(VISIT, tremor=tremor)
    for moved in (VISIT, shaking):
        trace = run(scenario(moved, duration_s=1.0))
        paths = hand_paths(trace)
        moving = paths.moving[:, 0]
        assert moving.any()
        period_s = DEFAULTS.clock.control_period_s
        length, a, v = DEFAULTS.hand.forearm_length_m, moved.max_acceleration_mps2, moved.max_speed_mps
        a += moved.tremor.max_acceleration_mps2 if moved.tremor else 0.0
        v += moved.tremor.max_speed_mps if moved.tremor else 0.0
        away = np.linalg.norm(
            trace.ticks["hand_position_in_base_m"][:, 0] - np.array(moved.elbow_towards_in_base_m), axis=1
        )
        r = np.minimum(away[:-1], away[1:]) - v * period_s / 2.0  # half-way at the nearest
        b = a * (1.0 + length / r) + length * sqrt(4.0 / 3.0) * (v / r) ** 2
        bend = hand_bend_m(trace, paths, 0)
        assert bend[moving] == pytest.approx((b * period_s**2 / 8.0)[moving], rel=1e-12)
        assert not bend[~moving].any()


def test_each_decision_has_candidates_of_its_own(visit: Trace) -> None:
    targets = [
        target_in_base_m(with_decisions(visit, seed=seed).decisions[0], visit.scenario.settings, Target.LABEL)
        for seed in (1, 2, 1)
    ]
    assert targets[0].tolist() == targets[2].tolist()
    assert targets[0].tolist() != targets[1].tolist()


def test_a_hundred_decisions_are_enough(visit: Trace) -> None:
    wide = IntervalRule(multiplier=1.0, residual_std_m=(9.0, 9.0, 9.0), target=Target.LABEL)
    calibration = SpreadCalibration(intervals=wide)
    assert calibration.evaluate([visit] * 99).verdict is Verdict.INCONCLUSIVE
    assert calibration.evaluate([visit] * 99).exercised == 99
    assert calibration.evaluate([visit] * 100).verdict is Verdict.HOLDS


def test_a_corner_stands_between_its_ticks_and_shares_the_slack_of_both_sides(visit: Trace) -> None:
    corner = np.array([[[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]]])
    smooth = hand_paths(visit)
    paths = replace(smooth, corner_hand=np.array([0]), corner_at=np.array([10.5]), corners_in_base_m=corner)
    before, after = instants(visit, smooth, 0), instants(visit, paths, 0)
    assert after[0][9:13].tolist() == [9.0, 10.0, 10.5, 11.0]
    assert after[1][11] == pytest.approx((before[1][10] + before[1][11]) / 2)
    for k, expected in ((2, corner[0, 0]), (3, corner[0, 1]), (4, np.inf)):
        assert np.array_equal(after[k][11], expected)
        assert np.array_equal(np.delete(after[k], 11, axis=0), before[k])
    assert after[5][10] == after[5][11] == before[5][10]
    assert np.array_equal(np.delete(after[5], 11), before[5])


def test_where_nothing_is_wrong_the_last_tick_is_the_worst(visit: Trace) -> None:
    assert FiniteTrace().evaluate(visit).worst_time_s == visit.time_s[-1]
