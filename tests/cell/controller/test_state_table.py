"""Each transition of the state machine, driven by observations that are made up."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bench import AWAY, Bench, with_avoidance
from examples import Displaced, hand, run, scenario, ur10_gate

from safety_harness.base.settings import DEFAULTS, GateKind
from safety_harness.cell.avoidance.gate import Gate, Query
from safety_harness.cell.avoidance.simple import OppositePose
from safety_harness.cell.robot.robots import arm_capsules, inverse_kinematics
from safety_harness.scenario.moves import MoveTo, Wait, Withdraw
from safety_harness.scenario.robots import Robot
from safety_harness.trace.records import Check, DecisionOutcome, Limit, Mode, Trigger

UNREACHABLE = Displaced((0.0, 3.0, 0.0))
CRITICAL_M = DEFAULTS.avoidance.critical_distance_m
NO_FALLBACK = replace(ur10_gate(DEFAULTS), fallback=OppositePose(3.0))


class Changing:
    """An avoider that goes through a list of others, one a decision."""

    name = "changing"

    def __init__(self, *others: object) -> None:
        self.others = list(others)

    def propose(self, **question: object) -> object:
        return self.others.pop(0).propose(**question)  # type: ignore[attr-defined]


def mode(row: np.void) -> Mode:
    return Mode(int(row["mode"]))


def last(bench: Bench) -> np.void:
    return bench.controller.decisions[-1]


def repulsing(bench: Bench, *hands: np.ndarray) -> np.ndarray:
    """Bring the controller into REPULSING; returns where it goes."""
    assert mode(bench.tick(*(hands or (bench.beside(0.3),)))) is Mode.REPULSING
    return last(bench)["chosen_position_in_base_m"].copy()


def test_without_a_hand_it_servoes() -> None:
    row = Bench().tick(count=3)
    assert mode(row) is Mode.SERVOING
    assert row["decision"] == -1
    assert row["predicted_distance_m"] == np.inf
    assert np.isfinite(row["sse"])


@pytest.mark.parametrize(("distance_m", "expected"), [(0.39, Mode.REPULSING), (0.41, Mode.SERVOING)])
def test_servoing_gives_way_at_the_critical_distance(distance_m: float, expected: Mode) -> None:
    bench = Bench()
    assert mode(bench.tick(AWAY)) is Mode.SERVOING
    bench = Bench()
    row = bench.tick(bench.beside(distance_m))
    assert mode(row) is expected
    assert row["predicted_distance_m"] == pytest.approx(distance_m, abs=5e-3)
    assert len(bench.controller.decisions) == (expected is Mode.REPULSING)


def test_the_decision_says_what_was_asked_and_why() -> None:
    bench = Bench()
    bench.tick(AWAY, count=5)
    near = bench.beside(0.3)
    row = bench.tick(AWAY, near)
    decision = last(bench)
    assert row["decision"] == 0
    assert decision["tick"] == 5
    assert decision["time_s"] == pytest.approx(5 * DEFAULTS.clock.control_period_s)
    assert Trigger(decision["trigger"]) is Trigger.HAND_ENTERED
    assert decision["hand_position_in_base_m"] == pytest.approx(near, abs=5e-3)  # the nearest of the two
    assert decision["tcp_position_in_base_m"] == pytest.approx(bench.tcp, abs=1e-12)
    assert np.array_equal(decision["joint_position_rad"], bench.joints)
    assert DecisionOutcome(decision["outcome"]) is DecisionOutcome.PROPOSED
    assert bench.tick(AWAY, near)["decision"] == -1  # once


def test_a_hand_that_will_be_there_soon_counts() -> None:
    """0.1 s ahead at 1 m/s: the decision comes at 0.5 m, not at 0.4 m."""
    bench = Bench()
    distance_m, row = 0.8, bench.tick(bench.beside(0.8))
    while mode(row) is Mode.SERVOING:
        distance_m -= 1.0 * DEFAULTS.clock.control_period_s
        row = bench.tick(bench.beside(distance_m))
    assert distance_m == pytest.approx(CRITICAL_M + DEFAULTS.hand_filter.prediction_horizon_s, abs=0.03)


def test_servoing_stops_where_no_pose_can_be_reached() -> None:
    bench = Bench(avoider=UNREACHABLE, gate=NO_FALLBACK)
    row = bench.tick(bench.beside(0.3))
    assert mode(row) is Mode.PROTECTIVE_STOP
    assert bench.command["protective_stop"].all()
    assert DecisionOutcome(last(bench)["outcome"]) is DecisionOutcome.STOP
    assert Check.UNREACHABLE in Check(int(last(bench)["opposite_failed"]))
    assert np.isnan(last(bench)["chosen_position_in_base_m"]).all()


def test_repulsing_servoes_again_on_arrival() -> None:
    bench = Bench()
    target = repulsing(bench)
    assert mode(bench.tick(AWAY, count=150)) is Mode.REPULSING  # the hand has gone: the way is finished first
    bench.place(np.add(target, (0.0, 0.0, 2e-3)))
    assert mode(bench.tick(AWAY)) is Mode.REPULSING  # 2 mm before the end
    bench.place(np.add(target, (0.0, 0.0, 0.5e-3)))
    row = bench.tick(AWAY)
    assert mode(row) is Mode.SERVOING
    assert row["gain"] > 0.0
    assert len(bench.controller.decisions) == 1


def test_on_arrival_at_a_hand_it_gives_way_again() -> None:
    bench = Bench()
    stays = bench.beside(0.2)
    target = repulsing(bench, stays)
    bench.place(target)
    row = bench.tick(stays)
    assert mode(row) is Mode.REPULSING
    assert row["decision"] == 1
    assert Trigger(last(bench)["trigger"]) is Trigger.HAND_STILL_THERE
    assert not np.allclose(last(bench)["chosen_position_in_base_m"], target, atol=0.01)


def test_the_same_hand_is_not_asked_about_on_the_way() -> None:
    bench = Bench()
    near = bench.beside(0.3)
    repulsing(bench, near)
    assert mode(bench.tick(near, count=20)) is Mode.REPULSING
    assert len(bench.controller.decisions) == 1


def test_another_hand_on_the_way_is_a_new_decision() -> None:
    bench = Bench()
    first, second = bench.beside(0.35), np.add(bench.tcp, (0.25, 0.0, 0.0))  # a way leads from both
    repulsing(bench, first, np.array(AWAY))
    row = bench.tick(first, second)
    assert mode(row) is Mode.REPULSING
    assert row["decision"] == 1
    assert Trigger(last(bench)["trigger"]) is Trigger.ANOTHER_HAND
    assert last(bench)["hand_position_in_base_m"] == pytest.approx(second, abs=5e-3)
    bench.tick(first, second, count=10)
    assert len(bench.controller.decisions) == 2  # now both are known


def test_between_two_hands_the_arm_stops_and_the_plain_gate_goes_on() -> None:
    for kind, expected in ((GateKind.FULL, Mode.PROTECTIVE_STOP), (GateKind.REACH, Mode.REPULSING)):
        bench = Bench(settings=with_avoidance(gate=kind))
        first, opposite = bench.beside(0.35), np.add(bench.tcp, (0.0, 0.25, 0.0))
        repulsing(bench, first)
        assert mode(bench.tick(first, opposite)) is expected
        failed = Check.TOWARDS_A_HAND if kind is GateKind.FULL else Check.NONE
        assert last(bench)["proposed_failed"] == last(bench)["opposite_failed"] == failed


def test_the_controller_tells_the_gate_of_every_valid_predicted_hand() -> None:
    class Listening(Gate):
        def check(self, position_in_base_m: np.ndarray, query: Query) -> Check:
            heard.append(query)
            return super().check(position_in_base_m, query)

    heard: list[Query] = []
    bench = Bench(
        gate=Listening.from_settings(DEFAULTS, inverse_kinematics(Robot.UR10), arm_capsules(Robot.UR10))
    )
    near, far = bench.beside(0.3), bench.beside(0.9)
    bench.tick(far, near)
    assert len(heard) == 2  # the proposal, the opposite pose
    for question in heard:
        assert question.hand_position_in_base_m == pytest.approx(near, abs=5e-3)
        found = question.hands_in_base_m[np.argsort(question.hands_in_base_m[:, 0])]
        assert found == pytest.approx(np.array([near, far]), abs=0.02)


def test_a_far_second_hand_is_no_decision() -> None:
    bench = Bench()
    near = bench.beside(0.3)
    repulsing(bench, near)
    bench.tick(near, AWAY, count=5)
    assert len(bench.controller.decisions) == 1


@pytest.mark.parametrize("trigger", [Trigger.HAND_STILL_THERE, Trigger.ANOTHER_HAND])
def test_repulsing_stops_where_the_next_pose_cannot_be_reached(trigger: Trigger) -> None:
    bench = Bench(avoider=Changing(OppositePose(0.1), UNREACHABLE), gate=NO_FALLBACK)
    first = bench.beside(0.2)
    target = repulsing(bench, first)
    if trigger is Trigger.HAND_STILL_THERE:
        bench.place(target)
        row = bench.tick(first)
    else:
        row = bench.tick(first, np.add(bench.tcp, (0.0, 0.25, 0.0)))
    assert mode(row) is Mode.PROTECTIVE_STOP
    assert Trigger(last(bench)["trigger"]) is trigger


def stopped(bench: Bench) -> None:
    assert mode(bench.tick(bench.beside(0.3))) is Mode.PROTECTIVE_STOP


@pytest.mark.parametrize("delay_s", [0.475, 0.5, 0.9])
def test_a_stop_ends_when_the_hands_have_been_away_for_the_restart_delay(delay_s: float) -> None:
    bench = Bench(avoider=UNREACHABLE, gate=NO_FALLBACK, settings=with_avoidance(restart_delay_s=delay_s))
    stopped(bench)
    assert mode(bench.tick(bench.beside(0.3), count=100)) is Mode.PROTECTIVE_STOP
    assert len(bench.controller.decisions) == 1  # a stopped arm asks nothing
    clear_s = None
    for _ in range(250):
        row, now_s = bench.tick(AWAY), (bench.ticks - 1) * DEFAULTS.clock.control_period_s
        if row["predicted_distance_m"] >= CRITICAL_M and clear_s is None:
            clear_s = now_s
        if mode(row) is Mode.SERVOING:
            break
    assert mode(row) is Mode.SERVOING
    assert clear_s is not None
    assert 0.0 <= now_s - clear_s - delay_s + 1e-9 < DEFAULTS.clock.control_period_s
    assert not bench.command["protective_stop"].any()


def test_a_hand_that_comes_back_begins_the_delay_anew() -> None:
    bench = Bench(avoider=UNREACHABLE, gate=NO_FALLBACK)
    stopped(bench)
    bench.tick(count=100)  # its track times out
    bench.tick(bench.beside(0.3))
    restart = int(DEFAULTS.avoidance.restart_delay_s / DEFAULTS.clock.control_period_s)
    assert mode(bench.tick(bench.beside(0.3), count=restart)) in (Mode.PROTECTIVE_STOP, Mode.SERVOING)
    assert mode(bench.tick(bench.beside(0.3))) is Mode.PROTECTIVE_STOP


def test_an_arm_that_still_moves_stays_stopped() -> None:
    bench = Bench(avoider=UNREACHABLE, gate=NO_FALLBACK)
    stopped(bench)
    bench.velocity[2] = 2e-3
    assert mode(bench.tick(count=300)) is Mode.PROTECTIVE_STOP
    bench.velocity[2] = 0.0
    assert mode(bench.tick()) is Mode.SERVOING


def test_servoing_loses_the_object_stands_and_finds_it_again() -> None:
    bench = Bench()
    assert mode(bench.tick(count=30)) is Mode.SERVOING
    bench.object_seen = False
    row = bench.tick()
    assert mode(row) is Mode.OBJECT_LOST
    assert np.isnan(row["sse"])
    assert np.isnan(row["features"]).all()
    row = bench.tick(count=60)
    assert np.array_equal(row["demanded_joint_velocity_radps"], np.zeros(6))
    assert row["gain"] == 0.0
    assert not bench.command["protective_stop"].any()
    bench.object_seen = True
    row = bench.tick(count=2)
    assert mode(row) is Mode.SERVOING
    assert np.abs(row["demanded_joint_velocity_radps"]).max() > 0.0


def test_a_lost_object_does_not_blind_it_to_hands() -> None:
    bench = Bench()
    bench.object_seen = False
    assert mode(bench.tick()) is Mode.OBJECT_LOST
    target = repulsing(bench)
    assert Trigger(last(bench)["trigger"]) is Trigger.HAND_ENTERED
    assert mode(bench.tick(AWAY, count=150)) is Mode.REPULSING
    bench.place(target)
    assert mode(bench.tick(AWAY)) is Mode.OBJECT_LOST  # on arrival there is still nothing to servo on


def test_with_the_object_lost_it_stops_where_no_pose_can_be_reached_and_is_released_to_it() -> None:
    bench = Bench(avoider=UNREACHABLE, gate=NO_FALLBACK)
    bench.object_seen = False
    assert mode(bench.tick()) is Mode.OBJECT_LOST
    stopped(bench)
    assert bench.command["protective_stop"].all()
    assert Trigger(last(bench)["trigger"]) is Trigger.HAND_ENTERED
    modes = [mode(bench.tick(AWAY)) for _ in range(250)]
    assert modes[0] is Mode.PROTECTIVE_STOP
    assert modes[-1] is Mode.OBJECT_LOST  # there is still nothing to servo on
    assert Mode.SERVOING not in modes


def test_features_that_are_no_numbers_are_an_object_lost() -> None:
    bench = Bench()
    observation = bench.observation(())
    observation["moments"] = np.nan
    command = bench.controller.step(observation)
    assert np.isfinite(command["joint_velocity_radps"]).all()
    assert mode(bench.controller.records.state[0]) is Mode.OBJECT_LOST


@pytest.mark.parametrize("near", [False, True])
def test_next_to_a_singularity_the_arm_is_stopped_whatever_it_does(near: bool) -> None:
    bench = Bench()
    if near:
        repulsing(bench)
    bench.joints[4] = 1e-3  # a wrist singularity
    row = bench.tick(AWAY)
    assert mode(row) is Mode.PROTECTIVE_STOP
    assert Limit.SINGULARITY in Limit(int(row["limits"]))
    assert np.array_equal(row["demanded_joint_velocity_radps"], np.zeros(6))
    assert bench.command["protective_stop"].all()
    assert mode(bench.tick(AWAY, count=200)) is Mode.PROTECTIVE_STOP  # it cannot get out by itself


def test_joint_angles_that_are_no_numbers_stop_the_arm() -> None:
    bench = Bench()
    observation = bench.observation((AWAY,))
    observation["joint_position_rad"][0, 1] = np.nan
    command = bench.controller.step(observation)
    assert command["protective_stop"].all()
    assert np.array_equal(command["joint_velocity_radps"], np.zeros((1, 6)))


@pytest.mark.parametrize("slot", [0, 1])
def test_a_track_that_is_no_number_is_not_hidden_by_another(slot: int) -> None:
    bench = Bench()
    bench.tick(AWAY, (1.2, 0.9, 0.2))
    for name in bench.controller.records.tracks.dtype.names or ():
        if bench.controller.records.tracks[name].dtype == np.float64 and name not in (
            "time_s",
            "last_seen_s",
        ):
            bench.controller.records.tracks[name][slot] = np.nan
    observation = bench.observation(())
    observation["boxes_new"] = False
    bench.controller.step(observation)
    assert (
        mode(bench.controller.records.state[0]) is Mode.PROTECTIVE_STOP
    )  # no direction leads away from nowhere


def test_a_whole_story_passes_through_the_table_in_the_engine() -> None:
    """Servo, give way, servo; then a stop because nothing can be reached, and on again."""
    visits = hand(
        MoveTo(position_in_base_m=(0.84, -0.35, 0.25), speed_mps=1.0),
        Wait(duration_s=0.3),
        Withdraw(speed_mps=1.0),
    )
    trace = run(scenario(visits, duration_s=4.0))
    modes = [Mode(int(m)) for m in trace.ticks["mode"]]
    order = [m for k, m in enumerate(modes) if k == 0 or m is not modes[k - 1]]
    assert order == [Mode.SERVOING, Mode.REPULSING, Mode.SERVOING]
    trace = run(scenario(visits, duration_s=4.0), avoider=UNREACHABLE, gate=NO_FALLBACK)
    modes = [Mode(int(m)) for m in trace.ticks["mode"]]
    order = [m for k, m in enumerate(modes) if k == 0 or m is not modes[k - 1]]
    assert order == [Mode.SERVOING, Mode.PROTECTIVE_STOP, Mode.SERVOING]
    stopped_at = np.flatnonzero(np.array(modes) == Mode.PROTECTIVE_STOP)
    braking = (trace.ticks["limits"] & Limit.BRAKING) > 0
    assert braking[stopped_at].all()
    assert np.abs(trace.ticks["joint_velocity_radps"][stopped_at[-1]]).max() < 1e-5
