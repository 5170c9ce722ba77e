"""Every property holds on a run that keeps it and is violated by something that breaks it."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from examples import (
    VISIT,
    ConstantSpeed,
    Displaced,
    PassingGate,
    TowardsTheHand,
    hand,
    run,
    scenario,
    ur10_gate,
)

from safety_harness.base.settings import DEFAULTS, GateKind
from safety_harness.claims.properties.answered import DecisionTime
from safety_harness.claims.properties.base import Property, judged
from safety_harness.claims.properties.finite import FiniteTrace
from safety_harness.claims.properties.giving_way import MovesAway
from safety_harness.claims.properties.hand_distance import HandDistance
from safety_harness.claims.properties.hand_prediction import HandPredictions
from safety_harness.claims.properties.limits import (
    JointAccelerations,
    JointLimits,
    JointSpeedLimits,
    TcpAcceleration,
    TcpSpeedLimit,
)
from safety_harness.claims.properties.positions import RepulsivePosesReachable
from safety_harness.claims.properties.proposals import FewOverruled
from safety_harness.claims.properties.reaction import GivesWayAtMost
from safety_harness.claims.properties.servoing import (
    Converged,
    GainSwitchIterations,
    GainSwitchReached,
    NeverStarved,
    ObjectInView,
)
from safety_harness.claims.signals.hand_distance import closest_approach
from safety_harness.claims.signals.true_motion import hand_paths
from safety_harness.scenario.model import Verdict
from safety_harness.scenario.moves import FollowTcp, MoveTo, Wait
from safety_harness.trace.trace import Trace

DISTANCE = HandDistance(minimum_m=0.05, near_m=0.4)
ALL: tuple[Property, ...] = (
    DISTANCE,
    RepulsivePosesReachable(proposed=False),
    RepulsivePosesReachable(proposed=True),
    MovesAway(),
    JointLimits(),
    JointSpeedLimits(),
    TcpSpeedLimit(maximum_mps=0.25),
    GainSwitchReached(),
    Converged(),
    HandPredictions(maximum_m=0.1),
    DecisionTime(within_s=0.1),
    JointAccelerations(maximum_radps2=10.0),
    TcpAcceleration(maximum_mps2=2.0),
    ObjectInView(within_s=2.0),
    GainSwitchIterations(within=250),
    GivesWayAtMost(most=3),
    NeverStarved(longest_s=3.0),
    FiniteTrace(),
)
TRACE_LENGTH_CLAIMS = (Converged,)


def truncated(trace: Trace, ticks: int) -> Trace:
    kept = trace.decisions[trace.decisions["tick"] < ticks]
    return replace(
        trace, ticks=trace.ticks[:ticks].copy(), decisions=kept.copy(), ended="interrupted by the user"
    )


def with_value(trace: Trace, field: str, value: float) -> Trace:
    ticks = trace.ticks.copy()
    ticks[field][len(ticks) // 2] = value
    return replace(trace, ticks=ticks)


# What takes longer than a visit, and what is not modelled where no computing time is declared.
NOT_THERE = (Converged, DecisionTime)


@pytest.mark.parametrize("prop", [p for p in ALL if not isinstance(p, NOT_THERE)], ids=lambda p: p.sentence)
def test_the_plain_system_holds_when_a_hand_visits_slowly(prop: Property, visit: Trace) -> None:
    evaluation = prop.evaluate(visit)
    assert evaluation.verdict is Verdict.HOLDS, evaluation
    assert evaluation.margin is not None
    assert evaluation.margin >= 0.0
    assert evaluation.exercised > 0


@pytest.mark.parametrize("prop", ALL, ids=lambda p: p.sentence)
def test_an_empty_trace_is_no_evidence(prop: Property, visit: Trace) -> None:
    assert prop.evaluate(truncated(visit, 0)).verdict is Verdict.INCONCLUSIVE


@pytest.mark.parametrize("prop", ALL, ids=lambda p: p.sentence)
def test_a_truncated_trace_never_holds(prop: Property, visit: Trace) -> None:
    for ticks in (1, 100, len(visit.ticks) - 1):
        assert prop.evaluate(truncated(visit, ticks)).verdict is not Verdict.HOLDS


@pytest.mark.parametrize(
    ("prop", "field"),
    [
        (DISTANCE, "hand_distance_m"),
        (DISTANCE, "joint_position_rad"),
        (DISTANCE, "hand_position_in_base_m"),
        (DISTANCE, "elbow_position_in_base_m"),
        (DISTANCE, "joint_velocity_radps"),
        (MovesAway(), "transform_tcp_to_base"),
        (MovesAway(), "hand_position_in_base_m"),
        (MovesAway(), "demanded_joint_velocity_radps"),
        (JointLimits(), "joint_position_rad"),
        (JointSpeedLimits(), "joint_position_rad"),
        (JointSpeedLimits(), "joint_velocity_radps"),
        (TcpSpeedLimit(maximum_mps=0.25), "transform_tcp_to_base"),
        (TcpSpeedLimit(maximum_mps=0.25), "tcp_speed_mps"),
        (GainSwitchReached(), "transform_tcp_to_base"),
        (GainSwitchReached(), "hand_position_in_base_m"),
        (Converged(), "transform_tcp_to_base"),
        (Converged(), "hand_position_in_base_m"),
        (HandPredictions(maximum_m=0.1), "hand_position_in_base_m"),
        (DecisionTime(within_s=0.1), "time_s"),
        (JointAccelerations(maximum_radps2=10.0), "joint_velocity_radps"),
        (TcpAcceleration(maximum_mps2=2.0), "joint_position_rad"),
        (TcpAcceleration(maximum_mps2=2.0), "joint_velocity_radps"),
        (ObjectInView(within_s=2.0), "tcp_speed_mps"),
        (GainSwitchIterations(within=250), "transform_tcp_to_base"),
        (GivesWayAtMost(most=3), "time_s"),
        (NeverStarved(longest_s=3.0), "transform_tcp_to_base"),
        (RepulsivePosesReachable(proposed=False), "time_s"),
        (RepulsivePosesReachable(proposed=False), "joint_position_rad"),
        (RepulsivePosesReachable(proposed=True), "transform_tcp_to_base"),
    ],
)
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_in_mid_trace_is_no_evidence(
    prop: Property, field: str, value: float, visit: Trace
) -> None:
    assert prop.evaluate(with_value(visit, field, value)).verdict is Verdict.INCONCLUSIVE


def test_a_hand_that_is_not_there_may_be_infinitely_far(visit: Trace) -> None:
    assert np.all(np.isinf(visit.ticks["hand_distance_m"][:, 1]))
    assert DISTANCE.evaluate(visit).verdict is Verdict.HOLDS


@pytest.mark.parametrize("margin", [np.nan, np.inf, -np.inf])
def test_a_margin_that_is_not_finite_is_no_evidence(margin: float, visit: Trace) -> None:
    evaluation = judged(DISTANCE, visit, margin=margin, worst_time_s=1.0, reason="", exercised=1)
    assert evaluation.verdict is Verdict.INCONCLUSIVE
    assert evaluation.margin is None


@pytest.mark.parametrize("prop", [DISTANCE, MovesAway(), RepulsivePosesReachable(proposed=True)], ids=str)
def test_what_was_never_exercised_is_no_evidence(prop: Property) -> None:
    far = run(scenario(hand(Wait(duration_s=1.0), at=(2.0, -1.5, 0.2)), duration_s=0.4))
    assert prop.evaluate(far).verdict is Verdict.INCONCLUSIVE


def test_no_hand_at_all_is_no_evidence_about_hands() -> None:
    assert DISTANCE.evaluate(run(scenario(duration_s=0.2))).verdict is Verdict.INCONCLUSIVE


@pytest.mark.parametrize(
    ("kind", "verdict"), [(GateKind.REACH, Verdict.VIOLATED), (GateKind.FULL, Verdict.HOLDS)]
)
def test_an_avoider_that_seeks_the_hand_violates_distance_and_direction_unless_the_gate_is_full(
    kind: GateKind, verdict: Verdict
) -> None:
    stays = hand(MoveTo(position_in_base_m=(0.84, -0.35, 0.25), speed_mps=1.0), Wait(duration_s=9.0))
    settings = replace(DEFAULTS, avoidance=replace(DEFAULTS.avoidance, gate=kind))
    trace = run(scenario(stays, duration_s=3.0, settings=settings), avoider=TowardsTheHand())
    assert DISTANCE.evaluate(trace).verdict is verdict
    assert MovesAway().evaluate(trace).verdict is verdict


def test_a_hand_that_catches_the_arm_is_violated_even_if_the_run_was_cut_short() -> None:
    chase = hand(FollowTcp(speed_mps=2.0, distance_m=0.0, duration_s=9.0))
    trace = run(scenario(chase, duration_s=1.5))
    assert DISTANCE.evaluate(truncated(trace, len(trace.ticks) - 5)).verdict is Verdict.VIOLATED


def test_an_unreachable_proposal_is_counted_even_when_the_gate_refused_it() -> None:
    trace = run(scenario(VISIT), avoider=Displaced((0.0, 2.0, 0.0)))
    proposed = RepulsivePosesReachable(proposed=True).evaluate(trace)
    assert proposed.verdict is Verdict.VIOLATED
    assert proposed.margin is not None
    assert proposed.margin < -0.5
    assert RepulsivePosesReachable(proposed=False).evaluate(trace).verdict is Verdict.HOLDS


def test_without_the_gate_an_unreachable_position_is_chosen() -> None:
    gate = ur10_gate(DEFAULTS)
    broken = PassingGate(**{field.name: getattr(gate, field.name) for field in fields(gate)})
    trace = run(scenario(VISIT), avoider=Displaced((0.0, 2.0, 0.0)), gate=broken)
    assert RepulsivePosesReachable(proposed=False).evaluate(trace).verdict is Verdict.VIOLATED


def test_a_controller_that_turns_too_fast_violates_the_speed_limits() -> None:
    trace = run(scenario(duration_s=0.2), controller=ConstantSpeed((2.5, 0.0, 0.0, 0.0, 0.0, 0.0)))
    assert JointSpeedLimits().evaluate(trace).verdict is Verdict.VIOLATED
    assert TcpSpeedLimit(maximum_mps=0.25).evaluate(trace).verdict is Verdict.VIOLATED


def test_a_joint_beyond_its_limit_is_violated(visit: Trace) -> None:
    ticks = visit.ticks.copy()
    ticks["joint_position_rad"][7, 2] = np.pi + 1e-6  # the elbow's limit is pi
    evaluation = JointLimits().evaluate(replace(visit, ticks=ticks))
    assert evaluation.verdict is Verdict.VIOLATED
    assert evaluation.worst_time_s == visit.time_s[7]


def test_a_controller_that_turns_on_and_on_violates_a_position_limit() -> None:
    trace = run(scenario(duration_s=1.0), controller=ConstantSpeed((0.0, 0.0, 2.5, 0.0, 0.0, 0.0)))
    evaluation = JointLimits().evaluate(trace)
    assert (evaluation.verdict, evaluation.reason) == (Verdict.VIOLATED, "elbow_joint")


def test_a_controller_that_does_nothing_never_switches_its_gain() -> None:
    idle = run(scenario(duration_s=4.0), controller=ConstantSpeed((0.0,) * 6))
    assert GainSwitchReached().evaluate(idle).verdict is Verdict.VIOLATED  # it sees nothing at all
    ticks = idle.ticks.copy()
    ticks["sse"] = 0.0196
    assert GainSwitchReached().evaluate(replace(idle, ticks=ticks)).verdict is Verdict.VIOLATED


def test_an_error_below_the_switch_from_the_start_is_no_evidence_that_it_is_reached() -> None:
    near = GainSwitchReached().evaluate(run(scenario(duration_s=0.5, offset=(0.02, -0.03, 0.02))))
    assert (near.verdict, near.exercised) == (Verdict.INCONCLUSIVE, 0)
    far = GainSwitchReached().evaluate(run(scenario(duration_s=2.0, offset=(0.05, -0.05, 0.02))))
    assert (far.verdict, far.exercised) == (Verdict.HOLDS, 1)


def test_an_image_that_is_not_there_yet_does_not_count_as_above_the_switch() -> None:
    late = replace(DEFAULTS, camera=replace(DEFAULTS.camera, rate_hz=30.0, latency_s=0.05))
    near = run(scenario(duration_s=0.5, offset=(0.02, -0.03, 0.02), settings=late))
    assert np.isnan(near.ticks["sse"][0])
    assert GainSwitchReached().evaluate(near).verdict is Verdict.INCONCLUSIVE


def test_a_tcp_that_starts_at_the_desired_pose_is_no_evidence_that_it_converges() -> None:
    evaluation = Converged().evaluate(run(scenario(duration_s=0.5, offset=(0.0, 0.0, 0.0))))
    assert (evaluation.verdict, evaluation.exercised) == (Verdict.INCONCLUSIVE, 0)


def test_convergence_is_judged_by_pose_after_the_time_of_the_closed_form() -> None:
    long = scenario(duration_s=60.0, offset=(0.02, -0.03, 0.02))
    held = Converged().evaluate(run(long))
    assert held.verdict is Verdict.HOLDS, held
    idle = run(replace(long, duration_s=56.0), controller=ConstantSpeed((0.0,) * 6))
    assert Converged().evaluate(idle).verdict is Verdict.VIOLATED
    assert Converged().evaluate(run(replace(long, duration_s=3.0))).verdict is Verdict.INCONCLUSIVE


def test_the_closest_approach_between_ticks_counts() -> None:
    """A hand that passes the arm at 13 m/s is nearer between two ticks than at any of them."""
    passing = hand(MoveTo(position_in_base_m=(0.9, 0.9, 0.30), speed_mps=16.0), at=(0.9, -0.836, 0.30))
    passing = replace(passing, max_speed_mps=16.0, max_acceleration_mps2=100.0, delay_s=0.004)
    trace = run(scenario(passing, duration_s=0.3))
    at_ticks = trace.ticks["hand_distance_m"][:, 0].min()
    paths = hand_paths(trace)
    straight = replace(paths, moving=np.zeros_like(paths.moving))  # and not by what it may bend
    distance_m, time_s, *_ = closest_approach(trace, straight)
    assert distance_m < at_ticks - 1e-3
    assert not np.isclose(np.mod(time_s, 0.008), 0.0, atol=1e-6)


def test_a_margin_of_exactly_zero_holds(visit: Trace) -> None:
    fastest = TcpSpeedLimit(maximum_mps=0.25).evaluate(visit)
    assert fastest.margin is not None
    exact = TcpSpeedLimit(maximum_mps=0.25 - fastest.margin).evaluate(visit)
    assert exact.margin == pytest.approx(0.0, abs=1e-15)


def test_a_tilt_needs_its_time_to_converge_too() -> None:
    tilted = scenario(duration_s=5.0, offset=(0.0, 0.0, 0.0), tilt=(0.0, 0.0, np.radians(6.0)))
    evaluation = Converged().evaluate(run(tilted))
    assert (evaluation.verdict, "closed form" in evaluation.reason) == (Verdict.INCONCLUSIVE, True)


@pytest.mark.parametrize(
    "prop", [GainSwitchReached(within_s=0.01), FewOverruled(most=0.0)], ids=lambda p: p.sentence
)
def test_what_later_ticks_could_undo_is_no_violation_of_a_run_that_was_cut_short(prop: Property) -> None:
    whole = run(scenario(VISIT), avoider=TowardsTheHand())
    assert prop.evaluate(whole).verdict is Verdict.VIOLATED
    cut = prop.evaluate(truncated(whole, len(whole.ticks) - 1))
    assert (cut.verdict, "cut short" in cut.reason) == (Verdict.INCONCLUSIVE, True)


def test_what_nothing_can_undo_stays_a_violation_of_a_run_that_was_cut_short() -> None:
    whole = run(scenario(VISIT), avoider=TowardsTheHand())
    cut = truncated(with_value(whole, "sse", np.nan), len(whole.ticks) - 1)
    assert FiniteTrace().evaluate(cut).verdict is Verdict.VIOLATED
