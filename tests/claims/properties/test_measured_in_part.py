"""What was measured of a run is judged, and what was not is never held for safe: hands, times, forearms."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from examples import VISIT, hand, scenario

from safety_harness import read_scenario
from safety_harness.admission.admit import admit
from safety_harness.admission.trial import judge, run_kinematic
from safety_harness.base.exceptions import TraceError
from safety_harness.claims.properties.base import Property
from safety_harness.claims.properties.hand_distance import HandDistance
from safety_harness.claims.properties.limits import JointAccelerations, JointSpeedLimits, TcpSpeedLimit
from safety_harness.claims.properties.protective_separation import ProtectiveSeparation
from safety_harness.claims.signals.true_motion import first_untruth
from safety_harness.scenario.model import Claim, JoinedHand, Verdict
from safety_harness.scenario.moves import MoveTo, Tremor, Wait, Withdraw
from safety_harness.trace.known import (
    COLUMNS_OF_A_TRACE,
    NOT_MEASURED,
    PER_HAND,
    PRESENCE,
    Gap,
    Measurement,
    Source,
)
from safety_harness.trace.trace import Trace
from safety_harness.trace.unmeasured import knowing

SCENARIOS = Path(__file__).parents[3] / "scenarios"
HAND, ELBOW, DISTANCE = "hand_position_in_base_m", "elbow_position_in_base_m", "hand_distance_m"
SEPARATION = ProtectiveSeparation()
TREMBLES = replace(
    VISIT, name="left", starts_at_in_base_m=(1.2, -0.9, 0.5), tremor=Tremor(amplitude_m=0.002, rate_hz=8.0)
)
AWAY = hand(Wait(duration_s=9.0), at=(2.0, 1.5, 0.5), name="left")
TWICE = replace(
    VISIT,
    moves=(
        MoveTo(position_in_base_m=(0.9, -0.45, 0.3), speed_mps=1.0),
        Withdraw(speed_mps=1.0),
        Wait(duration_s=0.6),
        MoveTo(position_in_base_m=(0.8, -0.3, 0.25), speed_mps=1.0),
        Wait(duration_s=0.5),
    ),
)
JOINED = JoinedHand(
    name="left", joined_to="right", apart_in_base_m=(0.0, 0.2, 0.0), elbow_towards_in_base_m=(1.6, 1.0, 0.3)
)


@cache
def run(*hands: str) -> Trace:
    known = {"right": VISIT, "trembles": TREMBLES, "away": AWAY, "twice": TWICE, "joined": JOINED}
    return run_kinematic(admit(scenario(*(known[name] for name in hands))))


def lost(*gaps: Gap, source: Source = Source.SENSOR) -> Measurement:
    return Measurement(source=source, gaps=gaps)


def least(trace: Trace, number: int) -> float:
    return float(trace.ticks[DISTANCE][:, number].min())


def at_least(minimum_m: float) -> HandDistance:
    return HandDistance(minimum_m=minimum_m, near_m=0.4)


def of_hand(number: int, trace: Trace) -> dict[str, Measurement]:
    """Nothing of this hand was measured."""
    gap = Gap(first=0, after=len(trace.ticks), hand=number)
    return {name: lost(gap) for name in PER_HAND if name != PRESENCE}


@pytest.mark.parametrize(("number", "name"), [(0, "right"), (1, "left")])
def test_a_hand_that_was_measured_violates_whatever_the_other_did(number: int, name: str) -> None:
    """Its tremor, of which the phase is that of the second hand, is followed too."""
    trace = run("right", "trembles")
    known = knowing(trace, of_hand(1 - number, trace))
    near = at_least(least(trace, number) + 0.01)
    found = near.evaluate(known)
    assert found.verdict is Verdict.VIOLATED
    assert f"(of {name} alone; not measured: hand_position_in_base_m of" in found.reason
    for prop in (near, ProtectiveSeparation(hand_speed_mps=2.0)):
        assert prop.evaluate(known).verdict is Verdict.VIOLATED


def test_a_hand_that_was_measured_is_no_excuse_for_the_other() -> None:
    trace = run("right", "away")
    found = at_least(0.05).evaluate(knowing(trace, of_hand(1, trace)))
    assert at_least(0.05).evaluate(trace).verdict is Verdict.HOLDS
    assert found.verdict is Verdict.INCONCLUSIVE
    assert "of right alone: +" in found.reason
    assert found.reason.startswith("not measured: hand_position_in_base_m of left from 0.000 to ")


def test_of_joined_hands_the_led_one_is_not_judged_without_its_leader() -> None:
    trace = run("right", "joined")
    everything = at_least(2.0)
    leader_lost = everything.evaluate(knowing(trace, of_hand(0, trace)))
    assert leader_lost.verdict is Verdict.INCONCLUSIVE
    assert "alone" not in leader_lost.reason
    led_lost = everything.evaluate(knowing(trace, of_hand(1, trace)))
    assert led_lost.verdict is Verdict.VIOLATED
    assert "of right alone" in led_lost.reason


@pytest.mark.parametrize(
    "prop", [at_least(9.0), ProtectiveSeparation(hand_speed_mps=2.0)], ids=["distance", "s"]
)
def test_of_hands_that_were_not_measured_nothing_is_said(prop: Property) -> None:
    trace = run("right", "trembles")
    for unknown in (of_hand(0, trace) | {HAND: NOT_MEASURED}, {HAND: NOT_MEASURED}):
        found = prop.evaluate(knowing(trace, unknown))
        assert found.verdict is Verdict.INCONCLUSIVE
        assert HAND in found.unmeasured


def test_a_violation_before_a_gap_stands_and_one_after_it_is_not_seen() -> None:
    trace = run("twice")
    distance_m = trace.ticks[DISTANCE][:, 0]
    middle = int(np.argmax(distance_m[60:200])) + 60
    assert distance_m[:middle].min() > distance_m[middle:].min() + 0.02
    gap = {HAND: lost(Gap(first=middle, after=middle + 5))}
    first, second = float(distance_m[:middle].min()) + 0.005, float(distance_m.min()) + 0.005
    before = at_least(first).evaluate(knowing(trace, gap))
    assert before.verdict is Verdict.VIOLATED
    assert before.margin == pytest.approx(-0.005, abs=1e-3)
    begin_s, end_s = middle * 0.008, (middle + 5) * 0.008
    words = f"(until {begin_s:.3f} s; not measured: {HAND} from {begin_s:.3f} to {end_s:.3f} s)"
    assert words in before.reason
    after = at_least(second).evaluate(knowing(trace, gap))
    assert at_least(second).evaluate(trace).verdict is Verdict.VIOLATED
    assert after.verdict is Verdict.INCONCLUSIVE
    assert after.reason.startswith(f"not measured: {HAND} from {begin_s:.3f} to {end_s:.3f} s; until ")


def test_before_a_gap_from_the_beginning_there_is_nothing_to_judge() -> None:
    trace = run("right")
    found = at_least(2.0).evaluate(knowing(trace, {HAND: lost(Gap(first=0, after=1))}))
    assert (found.verdict, found.unmeasured) == (Verdict.INCONCLUSIVE, (HAND,))
    assert "until" not in found.reason


def test_of_gaps_within_gaps_the_first_counts_and_all_are_named() -> None:
    trace = run("right", "trembles")
    gaps = {
        HAND: lost(Gap(first=100, after=300, hand=1), Gap(first=150, after=200, hand=1)),
        "joint_position_rad": lost(Gap(first=250, after=260)),
        "tcp_speed_mps": lost(Gap(first=40, after=50)),
    }
    found = ProtectiveSeparation(hand_speed_mps=0.01).evaluate(knowing(trace, gaps))
    assert found.verdict is Verdict.INCONCLUSIVE
    assert set(found.unmeasured) == set(gaps)
    seen = at_least(least(trace, 0) + 0.01).evaluate(knowing(trace, gaps))
    assert trace.ticks[DISTANCE][:250, 0].min() < least(trace, 0) + 0.005
    assert seen.verdict is Verdict.VIOLATED  # of the right hand alone, until its joints are lost


@pytest.mark.parametrize(
    "unknown", [NOT_MEASURED, lost(Gap(first=0, after=20)), lost(Gap(first=9, after=20, hand=1))]
)
def test_hands_not_known_to_be_absent_may_have_been_nearer(unknown: Measurement) -> None:
    trace = run("right")
    presumed = knowing(trace, {PRESENCE: unknown})
    assert at_least(least(trace, 0) + 0.01).evaluate(presumed).verdict is Verdict.VIOLATED
    found = at_least(0.05).evaluate(presumed)
    assert at_least(0.05).evaluate(trace).verdict is Verdict.HOLDS
    assert (found.verdict, found.unmeasured) == (Verdict.INCONCLUSIVE, (PRESENCE,))
    assert "of right alone: +" in found.reason


@pytest.mark.parametrize("filled_m", [0.0, np.nan])
def test_what_fills_the_place_of_a_hand_that_is_not_there_exercises_nothing(filled_m: float) -> None:
    trace, near_m = run("right"), least(run("right"), 0)
    ticks = trace.ticks.copy()
    ticks[DISTANCE][:, 1] = filled_m
    logged = knowing(replace(trace, ticks=ticks), {DISTANCE: lost(), "hand_distance_capsule": lost()})
    for prop in (HandDistance(minimum_m=0.001, near_m=near_m - 0.01), at_least(0.001), SEPARATION):
        assert prop.evaluate(logged) == prop.evaluate(trace)
    assert at_least(0.001).evaluate(trace).verdict is Verdict.HOLDS


def test_without_forearms_hands_alone_may_violate_and_never_hold() -> None:
    trace = run("right", "trembles")
    nothing_of_arms = {name: NOT_MEASURED for name in (ELBOW, DISTANCE, "hand_distance_capsule")}
    known = knowing(trace, nothing_of_arms)
    found = at_least(0.4).evaluate(known)
    whole = at_least(0.4).evaluate(trace)
    assert whole.verdict is found.verdict is Verdict.VIOLATED
    assert whole.margin is not None
    assert found.margin is not None
    assert found.margin >= whole.margin - 1e-4
    assert "of hands without their forearms" in found.reason
    assert at_least(0.01).evaluate(known).verdict is Verdict.INCONCLUSIVE
    assert ProtectiveSeparation(hand_speed_mps=2.0).evaluate(known).verdict is Verdict.VIOLATED


def test_a_recorded_hand_is_judged_without_its_forearm() -> None:
    whole = run_kinematic(admit(replace(read_scenario(SCENARIOS / "recorded-giving.yaml"), duration_s=2.0)))
    found = at_least(5.0).evaluate(knowing(whole, {ELBOW: NOT_MEASURED}))
    assert found.verdict is Verdict.VIOLATED


PROPS: tuple[Property, ...] = (
    at_least(0.05),
    at_least(0.25),
    SEPARATION,
    ProtectiveSeparation(own_speeds=True),
    JointSpeedLimits(),
    TcpSpeedLimit(maximum_mps=0.2),
    JointAccelerations(maximum_radps2=2.0),
)


@pytest.mark.parametrize("hands", [("right",), ("right", "trembles"), ("right", "joined"), ("twice", "away")])
def test_any_part_of_a_run_says_what_all_of_it_says_or_nothing(hands: tuple[str, ...]) -> None:
    trace = run(*hands)
    truths = [prop.evaluate(trace) for prop in PROPS]
    rng = np.random.default_rng(3)
    decided = 0
    for _ in range(60):
        columns = {}
        for name in rng.choice(COLUMNS_OF_A_TRACE[:12], rng.integers(1, 4), replace=False):
            first = int(rng.integers(0, len(trace.ticks) - 1))
            after = int(rng.integers(first + 1, len(trace.ticks) + 1))
            most = 2 if name == PRESENCE else len(hands)
            hand_lost = int(rng.integers(most)) if name in PER_HAND and rng.uniform() < 0.6 else None
            gap = Gap(first=first, after=after, hand=hand_lost)
            columns[str(name)] = NOT_MEASURED if rng.uniform() < 0.3 else lost(gap)
        masked = knowing(trace, columns)
        for prop, truth in zip(PROPS, truths, strict=True):
            found = prop.evaluate(masked)
            assert found.verdict in (truth.verdict, Verdict.INCONCLUSIVE), (found, truth, columns)
            decided += found.verdict is not Verdict.INCONCLUSIVE
        assert first_untruth(masked) is None
    assert decided > 60


def test_a_trace_that_is_known_in_part_can_be_judged_and_what_is_known_must_agree() -> None:
    claims = tuple(
        Claim(sentence=sentence, expected=Verdict.HOLDS)
        for sentence in ("hand distance never below 50 mm", "joint speeds within limits")
    )
    whole = run("right", "trembles")
    trace = replace(whole, scenario=replace(whole.scenario, claims=claims))
    gap = lost(Gap(first=30, after=60, hand=0))
    known = knowing(
        trace, {HAND: gap, "transform_tcp_to_base": lost(Gap(first=80, after=90)), "mode": NOT_MEASURED}
    )
    assert [found.verdict for found in judge(known)] == [Verdict.INCONCLUSIVE, Verdict.HOLDS]
    for name, tick, number, named in (
        (HAND, 70, 0, "hand_distance_m at tick 70"),
        (DISTANCE, 40, 1, "hand_distance_m at tick 40"),
        (ELBOW, 45, 0, "hand_position_in_base_m at tick 45"),
        ("tcp_speed_mps", 45, ..., "tcp_speed_mps at tick 45"),
    ):
        ticks = known.ticks.copy()
        ticks[name][tick, number] += 1e-3
        with pytest.raises(TraceError, match=named):
            judge(replace(known, ticks=ticks))
    ticks = known.ticks.copy()
    ticks[DISTANCE][40, 0] = 7.0  # of a hand that was not measured then: nobody can tell
    judge(replace(known, ticks=ticks))
