"""Giving way must take place: a system that only decides to is violated, one that is slowed is not."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from examples import VISIT, Displaced, PassingGate, hand, run, scenario, ur10_gate

from safety_harness.base.settings import DEFAULTS, GateKind, Settings
from safety_harness.claims.properties.giving_way import MovesAway, last_tick, progress
from safety_harness.scenario.model import MovingHand, Verdict
from safety_harness.scenario.moves import FollowTcp, MoveTo, Wait
from safety_harness.trace.records import DecisionOutcome, Limit, Mode, Trigger
from safety_harness.trace.trace import Trace

STAYS = hand(MoveTo(position_in_base_m=(0.84, -0.35, 0.25), speed_mps=1.0), Wait(duration_s=9.0))
FOLLOWS = hand(FollowTcp(speed_mps=0.5, distance_m=0.1, duration_s=9.0))


def avoiding(*, period_s: float = 0.008, **settings: Any) -> Settings:
    return replace(
        DEFAULTS,
        clock=replace(DEFAULTS.clock, control_period_s=period_s),
        avoidance=replace(DEFAULTS.avoidance, **settings),
    )


def tried(who: MovingHand, settings: Settings, duration_s: float = 2.5) -> Trace:
    return run(scenario(who, duration_s=duration_s, settings=settings))


def frozen(trace: Trace, from_tick: int) -> Trace:
    """The same decisions, but the arm truly stays where it is from a tick on."""
    ticks = trace.ticks.copy()
    for name in ("joint_position_rad", "transform_tcp_to_base"):
        ticks[name][from_tick:] = ticks[name][from_tick]
    for name in ("joint_velocity_radps", "tcp_speed_mps"):
        ticks[name][from_tick:] = 0.0
    return replace(trace, ticks=ticks)


@pytest.mark.parametrize(
    ("settings", "reason"),
    [
        ({"repulsion_speed_mps": 1e-9}, "executed way, too slow"),
        ({"repulsion_speed_mps": 0.005}, "executed way, too slow"),
        ({"repulsion_acceleration_mps2": 1e-9}, "executed way, too slow"),
        ({"arrival_tolerance_m": 0.1}, "executed way, ended too early"),
        ({"arrival_tolerance_m": 0.02}, "executed way, ended too early"),
        ({"radius_m": 1e-6}, "hardly any way at all"),
    ],
    ids=str,
)
@pytest.mark.parametrize("who", [VISIT, STAYS], ids=["visit", "stays"])
def test_a_system_that_does_not_give_way_is_violated(
    settings: dict[str, float], reason: str, who: MovingHand
) -> None:
    evaluation = MovesAway().evaluate(tried(who, avoiding(**settings)))
    assert evaluation.verdict is Verdict.VIOLATED, evaluation
    assert evaluation.reason.startswith(reason)


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"repulsion_speed_mps": 0.05},
        {"repulsion_speed_mps": 0.02},
        {"repulsion_acceleration_mps2": 0.1},
        {"repulsion_speed_mps": 1.0, "repulsion_acceleration_mps2": 5.0, "restart_delay_s": 1.0},
        {"radius_m": 0.3},
        {"radius_m": 0.02},
        {"arrival_tolerance_m": 0.01},
        {"period_s": 0.02},
        {"period_s": 0.05},
    ],
    ids=str,
)
@pytest.mark.parametrize("who", [VISIT, FOLLOWS], ids=["visit", "follows"])
def test_a_system_that_gives_way_holds_however_it_is_set(settings: dict[str, float], who: MovingHand) -> None:
    evaluation = MovesAway().evaluate(tried(who, avoiding(**settings)))
    assert evaluation.verdict is Verdict.HOLDS, evaluation
    assert evaluation.exercised > 0


def test_limits_that_slow_the_arm_are_no_false_alarm() -> None:
    fast = avoiding(
        repulsion_speed_mps=3.0, repulsion_acceleration_mps2=30.0, radius_m=0.3, restart_delay_s=1.0
    )
    trace = tried(FOLLOWS, fast, duration_s=3.0)
    giving_way = trace.ticks["mode"] == Mode.REPULSING
    assert np.any(trace.ticks["limits"][giving_way] & Limit.JOINT_SPEED)
    assert MovesAway().evaluate(trace).verdict is Verdict.HOLDS


def test_saying_that_a_joint_is_at_its_limit_is_no_excuse(visit: Trace) -> None:
    standing = frozen(visit, int(visit.decisions["tick"][0]))
    ticks = standing.ticks.copy()
    ticks["limits"] |= int(Limit.JOINT_SPEED)
    assert MovesAway().evaluate(replace(standing, ticks=ticks)).verdict is Verdict.VIOLATED


@pytest.mark.parametrize("after", [0, 15, 30])
def test_an_arm_that_stands_still_or_stops_on_the_way_is_violated(after: int, visit: Trace) -> None:
    standing = frozen(visit, int(visit.decisions["tick"][0]) + after)
    evaluation = MovesAway().evaluate(standing)
    assert evaluation.verdict is Verdict.VIOLATED
    assert evaluation.margin is not None
    assert evaluation.margin < -0.03


def test_deciding_anew_again_and_again_does_not_replace_moving(visit: Trace) -> None:
    """Every tick "another hand" cuts the repulsion short: no single one had time for anything."""
    first = int(visit.decisions["tick"][0])
    standing = frozen(visit, first)
    count = 300
    decisions = np.repeat(visit.decisions[:1], count)
    ticks = standing.ticks.copy()
    decisions["tick"] = np.arange(first, first + count)
    decisions["time_s"] = ticks["time_s"][decisions["tick"]]
    decisions["asked_tick"] = decisions["tick"]
    decisions["trigger"][1:] = Trigger.ANOTHER_HAND
    ticks["decision"] = -1
    ticks["decision"][first : first + count] = np.arange(count)
    ticks["mode"][first : first + count] = Mode.REPULSING
    ticks["mode"][first + count :] = Mode.PROTECTIVE_STOP
    evaluation = MovesAway().evaluate(replace(standing, ticks=ticks, decisions=decisions))
    assert evaluation.verdict is Verdict.VIOLATED, evaluation
    assert evaluation.reason.startswith("executed way, too slow")


def test_a_repulsion_cut_short_by_a_stop_or_the_end_need_not_arrive(visit: Trace) -> None:
    first = int(visit.decisions["tick"][0])
    ticks = visit.ticks.copy()
    ticks["mode"][first + 40 :] = Mode.PROTECTIVE_STOP
    stopped = MovesAway().evaluate(replace(visit, ticks=ticks))
    assert stopped.verdict is Verdict.HOLDS, stopped
    short = replace(visit.scenario, duration_s=float(visit.time_s[first + 40]))
    ended = replace(visit, ticks=visit.ticks[: first + 41].copy(), scenario=short)
    assert MovesAway().evaluate(ended).verdict is Verdict.HOLDS


def test_a_repulsion_too_short_to_show_anything_is_no_evidence(visit: Trace) -> None:
    first = int(visit.decisions["tick"][0])
    short = replace(visit.scenario, duration_s=float(visit.time_s[first + 5]))
    ended = replace(visit, ticks=visit.ticks[: first + 6].copy(), scenario=short)
    evaluation = MovesAway().evaluate(ended)
    assert (evaluation.verdict, evaluation.exercised) == (Verdict.INCONCLUSIVE, 0)


def test_giving_way_to_a_phantom_is_no_evidence(visit: Trace) -> None:
    ticks = visit.ticks.copy()  # what the controller took for a hand was none
    ticks["hand_present"], ticks["hand_distance_m"], ticks["hand_distance_capsule"] = False, np.inf, -1
    alone = replace(visit, ticks=ticks, scenario=replace(visit.scenario, hands=()))
    evaluation = MovesAway().evaluate(alone)
    assert (evaluation.verdict, evaluation.margin) == (Verdict.INCONCLUSIVE, None)


def test_a_way_that_leads_towards_the_hand_is_violated_before_it_is_gone() -> None:
    gate = ur10_gate(DEFAULTS)
    broken = PassingGate(**{name: getattr(gate, name) for name in gate.__dataclass_fields__})
    what = scenario(VISIT, settings=avoiding(gate=GateKind.REACH))
    evaluation = MovesAway().evaluate(run(what, avoider=Displaced((0.0, -0.1, 0.0)), gate=broken))
    assert evaluation.verdict is Verdict.VIOLATED
    assert evaluation.margin is not None
    assert evaluation.margin < -0.05


def test_a_chosen_position_that_is_none_is_no_evidence(visit: Trace) -> None:
    for value in (np.nan, np.inf, 1e300):
        decisions = visit.decisions.copy()
        decisions["chosen_position_in_base_m"][0] = value
        assert MovesAway().evaluate(replace(visit, decisions=decisions)).verdict is Verdict.INCONCLUSIVE


def test_the_reference_is_never_ahead_of_the_trapezoid(visit: Trace) -> None:
    """Oracle: from rest the closed form of a trapezoid with the full speed and acceleration."""
    decision = visit.decisions[0]
    assert decision["outcome"] != DecisionOutcome.STOP
    avoidance = visit.scenario.settings.avoidance
    first, last = int(decision["tick"]), last_tick(visit, 0)
    ticks = visit.ticks.copy()
    ticks["transform_tcp_to_base"][:first] = ticks["transform_tcp_to_base"][first]  # from rest
    still = replace(visit, ticks=ticks)
    a, v = avoidance.repulsion_acceleration_mps2, avoidance.repulsion_speed_mps
    due_m = 0.0
    for end in range(first + 1, last + 1):
        t = (end - first + 1) * 0.008
        trapezoid = a * t * t / 2.0 if t < v / a else v * t - v * v / (2.0 * a)
        due_m = progress(still, decision, end, None).due_m
        assert due_m <= min(trapezoid, avoidance.radius_m) + 1e-9
    assert due_m > 0.9 * avoidance.radius_m
