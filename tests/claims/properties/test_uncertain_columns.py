"""A verdict on uncertain columns is that of every true run within the uncertainty, or there is none."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from examples import VISIT, hand, scenario
from numpy.typing import NDArray

from safety_harness.admission.admit import admit
from safety_harness.admission.claims import property_of
from safety_harness.admission.trial import run_kinematic
from safety_harness.cell.robot.description import load_arm
from safety_harness.claims.properties.base import Evaluation, Property
from safety_harness.claims.properties.hand_distance import HandDistance
from safety_harness.claims.properties.limits import (
    JointAccelerations,
    JointLimits,
    JointSpeedLimits,
    TcpAcceleration,
    TcpSpeedLimit,
)
from safety_harness.claims.properties.protective_separation import ProtectiveSeparation
from safety_harness.claims.properties.reaction import GIVES_WAY_TO_TRUE_HAND
from safety_harness.claims.properties.touching import NoMovingPartTouches
from safety_harness.claims.signals.true_motion import derived, first_untruth, tcp_velocity_moved_mps
from safety_harness.scenario.model import Claim, Verdict
from safety_harness.scenario.moves import FollowTcp, MoveTo, Tremor, Wait
from safety_harness.trace.known import NOT_MEASURED, Measurement, Source
from safety_harness.trace.records import Limit
from safety_harness.trace.trace import Trace
from safety_harness.trace.unmeasured import knowing

DRAWS = 40
JOINTS, RATES = "joint_position_rad", "joint_velocity_radps"
TCP, SPEED, DISTANCE = "transform_tcp_to_base", "tcp_speed_mps", "hand_distance_m"
HAND, ELBOW = "hand_position_in_base_m", "elbow_position_in_base_m"
LARGEST = {JOINTS: 1e-3, RATES: 5e-3, TCP: 2e-3, SPEED: 0.01, DISTANCE: 0.01, HAND: 0.01, ELBOW: 0.01}
ARM = load_arm("ur10")
COMES = hand(
    MoveTo(position_in_base_m=(0.9, -0.5, 0.3), speed_mps=0.8), Wait(duration_s=3.0), at=(1.6, -1.4, 0.4)
)


@cache
def run(name: str) -> Trace:
    left = replace(
        VISIT, name="left", starts_at_in_base_m=(1.2, 0.6, 0.3), tremor=Tremor(amplitude_m=0.002, rate_hz=8.0)
    )
    hands = {"visit": (VISIT,), "two": (VISIT, left), "comes": (COMES,)}[name]
    return run_kinematic(admit(scenario(*hands)))


def of(trace: Trace, ticks: NDArray[np.void]) -> Trace:
    return replace(trace, ticks=ticks)


def near(
    make: Callable[[float], Property], within: float
) -> Callable[[np.random.Generator, Trace], tuple[Property, Trace]]:
    """The claim whose true margin is anywhere ``within`` so much of zero."""

    def drawn(rng: np.random.Generator, trace: Trace) -> tuple[Property, Trace]:
        margin = make(0.0).evaluate(trace).margin
        assert margin is not None
        return make(margin + rng.uniform(-within, within)), trace

    return drawn


def distance(rng: np.random.Generator, trace: Trace) -> tuple[Property, Trace]:
    nearest = float(trace.ticks[DISTANCE].min())
    return HandDistance(
        minimum_m=nearest + rng.uniform(-0.04, 0.04), near_m=nearest + rng.uniform(-0.01, 0.06)
    ), trace


def joints(rng: np.random.Generator, trace: Trace) -> tuple[Property, Trace]:
    ticks = trace.ticks.copy()
    ticks[JOINTS][:, 2] += ARM.position_upper_rad[2] - ticks[JOINTS][:, 2].max() + rng.uniform(-2e-3, 2e-3)
    return JointLimits(), of(trace, ticks)


def rates(rng: np.random.Generator, trace: Trace) -> tuple[Property, Trace]:
    ticks = trace.ticks.copy()
    ticks[RATES][40, 1] = ARM.velocity_limit_radps[1] + rng.uniform(-0.3, 0.3)
    return JointSpeedLimits(), of(trace, ticks)


def stands(rng: np.random.Generator, trace: Trace) -> tuple[Property, Trace]:
    """At speeds near those of an arm that stands."""
    ticks = trace.ticks.copy()
    for name in (RATES, SPEED):
        ticks[name] *= rng.uniform(0.0, 4.0) * 1e-3 / np.abs(ticks[name]).max()
    ticks[TCP], ticks[JOINTS] = ticks[TCP][:1], ticks[JOINTS][:1]
    ticks[DISTANCE] = derived(of(trace, ticks.copy()))[DISTANCE]
    kind = int(rng.integers(5))
    return (
        TcpSpeedLimit(maximum_mps=1.0),
        JointSpeedLimits(),
        JointAccelerations(maximum_radps2=10.0),
        TcpAcceleration(maximum_mps2=10.0),
        ProtectiveSeparation(hand_speed_mps=rng.uniform(0.0, 1.0)),
    )[kind], of(trace, ticks)


def separation(rng: np.random.Generator, trace: Trace) -> tuple[Property, Trace]:
    """From hands of whom some stay far enough away, with an arm whose drives brake at times."""
    ticks = trace.ticks.copy()
    begins = rng.integers(0, len(ticks), 3)
    for first, after in zip(begins, begins + rng.integers(1, 120, 3), strict=True):
        ticks["limits"][first:after] |= int(Limit.BRAKING)
    return ProtectiveSeparation(hand_speed_mps=rng.uniform(0.0, 1.6)), of(trace, ticks)


def fast(rng: np.random.Generator, trace: Trace) -> tuple[Property, Trace]:
    """From an arm whose points go anywhere, faster than it is."""
    ticks = trace.ticks.copy()
    ticks[RATES] = rng.uniform(-1.0, 1.0, 6)
    ticks[SPEED] = derived(of(trace, ticks.copy()))[SPEED]
    return ProtectiveSeparation(hand_speed_mps=rng.uniform(0.0, 0.4)), of(trace, ticks)


def own(rng: np.random.Generator, trace: Trace) -> tuple[Property, Trace]:
    return ProtectiveSeparation(own_speeds=True), trace


def touching(rng: np.random.Generator, trace: Trace) -> tuple[Property, Trace]:
    """Of an arm that stands for some time, and hands that have grown into it or not."""
    hand_size = replace(trace.scenario.settings.hand, radius_m=rng.uniform(0.04, 0.5))
    settings = replace(trace.scenario.settings, hand=hand_size)
    true = replace(trace, scenario=replace(trace.scenario, settings=settings), ticks=trace.ticks.copy())
    ticks = true.ticks.copy()
    first = int(rng.integers(len(ticks)))
    ticks[JOINTS][first : first + 200] = ticks[JOINTS][first]
    found = derived(of(true, ticks.copy()))
    for name in (TCP, DISTANCE, "hand_distance_capsule"):
        ticks[name] = found[name]
    return NoMovingPartTouches(near_m=rng.uniform(0.2, 0.6)), of(true, ticks)


DRAWN = {
    "hand distance": distance,
    "no moving part": touching,
    "joint positions": joints,
    "joint speeds": rates,
    "TCP speed": near(lambda more: TcpSpeedLimit(maximum_mps=1.0 - more), 0.5),
    "joint accelerations": near(lambda more: JointAccelerations(maximum_radps2=50.0 - more), 2.0),
    "TCP acceleration": near(lambda more: TcpAcceleration(maximum_mps2=50.0 - more), 5.0),
    "an arm that stands": stands,
    "protective separation": separation,
    "protective separation, fast arm": fast,
    "protective separation, own speeds": own,
}


SOMETIMES_DECIDED = {*DRAWN} - {"an arm that stands", *(name for name in DRAWN if "separation," in name)}


def measured(rng: np.random.Generator, true: Trace) -> Trace:
    """``true`` as sensors saw it, which are all off by something, or all by as much as can be."""
    ticks, columns = true.ticks.copy(), {}
    share, worst, constant = rng.uniform() ** 2, rng.uniform() < 0.5, rng.uniform() < 0.5
    for name, largest in LARGEST.items():
        if rng.uniform() < 0.4:
            continue
        uncertainty = share * largest
        values = ticks[name][..., :3, 3] if name == TCP else ticks[name]
        off = rng.uniform(-1.0, 1.0, values.shape[:1] if constant and values.ndim == 1 else values.shape)
        off = np.broadcast_to(off[:1], values.shape) if constant else off
        if name in (TCP, HAND, ELBOW):
            off = off / np.linalg.norm(off, axis=-1, keepdims=True)
        elif worst:
            off = np.sign(off)
        off = off if worst else off * rng.uniform()
        values += uncertainty * 0.999999 * off
        columns[name] = Measurement(source=Source.SENSOR, uncertainty=uncertainty)
    ticks[SPEED] = np.abs(ticks[SPEED])  # no nearer to the truth, nor farther from it
    return knowing(of(true, ticks), columns)


def agree(found: Evaluation, truth: Evaluation) -> bool:
    """Is a verdict the true one, with a margin that is no better, or do its ends enclose the true one?"""
    if found.verdict is Verdict.INCONCLUSIVE:
        said = re.search(r"the margin is from (\S+?)( \S+)? to (\S+?)( \S+)?;", found.reason)
        if said is None or truth.margin is None:
            return True
        low, high = (float(said[k]) * (1e-3 if said[k + 1] == " ms" else 1.0) for k in (1, 3))
        margin = truth.margin * truth.unit.per_si
        return low - 0.05 - 0.01 * abs(low) <= margin <= high + 0.05 + 0.01 * abs(high)
    assert found.margin is not None
    assert truth.margin is not None
    surely = found.margin <= truth.margin if found.verdict is Verdict.HOLDS else found.margin >= truth.margin
    return found.verdict is truth.verdict and surely


@pytest.mark.parametrize("name", DRAWN)
@pytest.mark.parametrize("which", ["visit", "two", "comes"])
def test_what_is_said_of_uncertain_columns_is_so_for_the_truth(name: str, which: str) -> None:
    rng = np.random.default_rng([20261123, *name.encode(), len(which)])
    seen: Counter[Verdict] = Counter()
    for _ in range(DRAWS):
        prop, true = DRAWN[name](rng, run(which))
        truth, found = prop.evaluate(true), prop.evaluate(measured(rng, true))
        assert agree(found, truth), (found, truth)
        seen[found.verdict] += 1
        if found.verdict is Verdict.INCONCLUSIVE and truth.verdict is not Verdict.INCONCLUSIVE:
            assert found.unmeasured or found.reason.startswith("never exercised")
    assert seen[Verdict.INCONCLUSIVE] > 0
    assert len(seen) > 1 or name not in SOMETIMES_DECIDED


@pytest.mark.parametrize("name", DRAWN)
def test_without_uncertainty_a_verdict_is_that_of_today(name: str) -> None:
    rng = np.random.default_rng(5)
    sensed = {column: Measurement(source=Source.SENSOR) for column in LARGEST}
    for _ in range(5):
        prop, true = DRAWN[name](rng, run("visit"))
        assert prop.evaluate(knowing(true, sensed)) == prop.evaluate(true)


def test_columns_that_were_derived_from_uncertain_ones_are_no_contradiction() -> None:
    rng = np.random.default_rng(7)
    for _ in range(10):
        ticks = run("two").ticks.copy()
        ticks[JOINTS] += rng.uniform(-1e-3, 1e-3, ticks[JOINTS].shape)
        ticks[RATES] += rng.uniform(-1e-3, 1e-3, ticks[RATES].shape)
        for name in (HAND, ELBOW):
            ticks[name] += rng.uniform(-1.0, 1.0, ticks[name].shape) * 0.004 / np.sqrt(3.0)
        mine = of(run("two"), ticks)
        sure = {name: Measurement(source=Source.SENSOR, uncertainty=1e-3) for name in (JOINTS, RATES)}
        sure |= {name: Measurement(source=Source.SENSOR, uncertainty=4e-3) for name in (HAND, ELBOW)}
        again = mine.ticks.copy()
        for name in (TCP, SPEED, DISTANCE):
            again[name] = derived(mine)[name]
        assert first_untruth(knowing(mine, sure)) is None  # as the truth was
        assert first_untruth(knowing(of(mine, again), sure)) is None
        far = again.copy()
        far[DISTANCE][30, 0] += 0.02
        wrong = first_untruth(knowing(of(mine, far), sure))
        assert wrong is not None
        assert wrong.where == "hand_distance_m at tick 30"


def test_a_hand_that_came_near_only_within_the_uncertainty_exercises_nothing() -> None:
    trace = run("visit")
    nearest = float(trace.ticks[DISTANCE].min())
    prop = HandDistance(minimum_m=nearest - 0.1, near_m=nearest + 0.004)
    sensed = knowing(trace, {DISTANCE: Measurement(source=Source.SENSOR, uncertainty=0.005)})
    assert prop.evaluate(trace).verdict is Verdict.HOLDS
    found = prop.evaluate(sensed)
    assert found.verdict is Verdict.INCONCLUSIVE
    assert "perhaps it was never exercised" in found.reason
    assert replace(prop, near_m=nearest + 0.006).evaluate(sensed).verdict is Verdict.HOLDS


def test_without_ends_it_is_not_even_said_that_a_claim_was_never_exercised() -> None:
    trace = run("visit")
    comes_m = float(np.linalg.norm(trace.ticks[HAND][:, 0] - trace.ticks[TCP][:, :3, 3], axis=1).min())
    ticks, settings = trace.ticks.copy(), trace.scenario.settings
    ticks[HAND][:, 0] += (ticks[HAND][:, 0] - ticks[TCP][:, :3, 3]) * 0.002 / comes_m
    near = replace(settings, avoidance=replace(settings.avoidance, critical_distance_m=comes_m + 0.001))
    true = replace(trace, scenario=replace(trace.scenario, settings=near))
    prop = property_of(Claim(sentence=GIVES_WAY_TO_TRUE_HAND.example, expected=Verdict.HOLDS), true.scenario)
    seen = knowing(of(true, ticks), {HAND: Measurement(source=Source.SENSOR, uncertainty=0.02)})
    assert prop.evaluate(true).exercised > 0
    found = prop.evaluate(seen)
    assert (found.verdict, found.unmeasured) == (Verdict.INCONCLUSIVE, (HAND,))
    assert found.reason.startswith("known only to within an uncertainty: hand_position_in_base_m; ")
    assert "never exercised" in found.reason


def test_where_a_hand_goes_that_follows_an_uncertain_tcp_nobody_knows() -> None:
    follows = hand(FollowTcp(speed_mps=0.3, distance_m=0.25, duration_s=1.0))
    trace = run_kinematic(admit(scenario(follows, duration_s=1.0)))
    prop = HandDistance(minimum_m=0.01, near_m=5.0)
    assert prop.evaluate(trace).verdict is Verdict.HOLDS
    found = prop.evaluate(knowing(trace, {TCP: Measurement(source=Source.LOG, uncertainty=1e-6)}))
    assert found.verdict is Verdict.INCONCLUSIVE
    assert found.unmeasured == (TCP,)


@pytest.mark.parametrize("which", ["visit", "two", "comes"])
def test_unknown_braking_counts_as_none(which: str) -> None:
    """What holds holds for any flags; a stop excuses what is too near for as long as a stop may take."""
    rng = np.random.default_rng(11)
    seen: Counter[tuple[Verdict, Verdict]] = Counter()
    for _ in range(DRAWS):
        prop, true = separation(rng, run(which))
        truth, found = prop.evaluate(true), prop.evaluate(knowing(true, {"limits": NOT_MEASURED}))
        assert agree(found, truth), (found, truth)
        seen[found.verdict, truth.verdict] += 1
        if found.verdict is Verdict.INCONCLUSIVE and truth.verdict is not Verdict.INCONCLUSIVE:
            assert found.reason.startswith("not measured: limits; ")
    assert seen[Verdict.HOLDS, Verdict.HOLDS] > 0
    assert seen[Verdict.VIOLATED, Verdict.VIOLATED] > 0
    assert seen[Verdict.INCONCLUSIVE, Verdict.HOLDS] + seen[Verdict.INCONCLUSIVE, Verdict.VIOLATED] > 0


def test_an_arm_that_may_have_moved_while_a_hand_was_near_is_not_held_to_have_stood() -> None:
    trace = run("visit")
    near = trace.ticks[DISTANCE].min(axis=1) < trace.ticks[DISTANCE].min() + 0.05
    prop = ProtectiveSeparation(hand_speed_mps=float(trace.ticks[DISTANCE].min() + 0.025) / 0.45)
    ticks = trace.ticks.copy()
    ticks[RATES], ticks[SPEED] = 0.0, 0.0
    ticks[RATES][:, 5] = np.where(near, 0.8e-3, 5e-3)
    stood = knowing(of(trace, ticks), {RATES: Measurement(source=Source.SENSOR, uncertainty=4e-4)})
    moved = ticks.copy()
    moved[RATES][near, 5] = 1.1e-3
    assert prop.evaluate(of(trace, ticks.copy())).verdict is Verdict.HOLDS
    assert prop.evaluate(of(trace, moved)).verdict is Verdict.VIOLATED
    found = prop.evaluate(stood)
    assert (found.verdict, found.unmeasured) == (Verdict.INCONCLUSIVE, (RATES,))


def test_the_bound_of_what_the_tcps_speed_is_off_is_kept_and_of_the_right_size() -> None:
    rng = np.random.default_rng(13)
    trace, largest = run("visit"), 0.0
    for _ in range(60):
        off, ticks = rng.uniform(0.0, 1e-3, 2), trace.ticks.copy()
        for name, most in zip((JOINTS, RATES), off, strict=True):
            ticks[name] += most * rng.choice([-1.0, 1.0], 6)
        sure = {
            n: Measurement(source=Source.LOG, uncertainty=m)
            for n, m in zip((JOINTS, RATES), off, strict=True)
        }
        moved_mps = np.abs(derived(of(trace, ticks.copy()))[SPEED] - trace.ticks[SPEED])
        bound_mps = tcp_velocity_moved_mps(knowing(of(trace, ticks), sure))
        assert (moved_mps <= bound_mps).all()
        largest = max(largest, float((moved_mps / bound_mps).max()))
    assert largest > 0.3
