"""Harmless changes against geometry that is not ours: coal in these tests, PyBullet in the trial itself."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from itertools import pairwise

import coal
import numpy as np
import pytest
from examples import PassingGate, TowardsTheHand, hand, run, scenario
from small import shipped, trials

from safety_harness.admission.claims import property_of
from safety_harness.cell.robot.description import load_arm
from safety_harness.cell.robot.distance import place_capsules
from safety_harness.cell.robot.kinematics import forward_kinematics
from safety_harness.claims.properties.base import Evaluation
from safety_harness.claims.properties.hand_distance import HAND_DISTANCE, HandDistance
from safety_harness.claims.signals.true_motion import capsules_of
from safety_harness.extensions.assurance.certification.tools import FaultState
from safety_harness.extensions.selftest import trial
from safety_harness.extensions.selftest.catalogue import HARMLESS
from safety_harness.extensions.selftest.fault import FaultyPart, SeededFault
from safety_harness.extensions.selftest.geometry import BODIES, Kept, PyBulletArm, hand_distance_kept
from safety_harness.extensions.selftest.session import try_out
from safety_harness.extensions.selftest.system import ChangedSystem
from safety_harness.extensions.selftest.trial import LEAST_M, SAME_TWICE, confirmed_by
from safety_harness.scenario.model import Claim, Verdict
from safety_harness.scenario.moves import Wait
from safety_harness.trace.trace import Trace

PROVEN_BY_COAL: set[tuple[bytes, ...]] = set()
PROVEN, REFUTED = ("network-certain", "second-hand"), ("fast-reach", "hand-at-the-elbow-link")


@lru_cache
def sound(name: str) -> Trace:
    return ChangedSystem(shipped(name)).run()


def by_coal_m(trace: Trace, tick: int) -> float:
    """Least distance of any hand or forearm from the arm's capsules; within them any number below 0."""
    arm, settings = load_arm(trace.scenario.robot.arm_name), trace.scenario.settings
    capsules = capsules_of(trace)
    radii = capsules.radius_m
    transforms, placed = np.empty((8, 4, 4)), np.empty((len(radii), 2, 3))
    row = trace.ticks[tick]
    forward_kinematics(arm.chain[0], row["joint_position_rad"], transforms)
    place_capsules(capsules.records, transforms, placed)
    least = np.inf
    for k in np.flatnonzero(row["hand_present"]):
        wrist, elbow = row["hand_position_in_base_m"][k], row["elbow_position_in_base_m"][k]
        bodies = [(coal.Sphere(settings.hand.radius_m), coal.Transform3s(np.eye(3), wrist))]
        bodies.append(capsule(wrist, elbow, settings.hand.forearm_radius_m))
        for (start, end), radius in zip(placed, radii, strict=True):
            for body in bodies:
                link = capsule(start, end, radius)
                request, result = coal.DistanceRequest(), coal.DistanceResult()
                least = min(least, coal.distance(*link, *body, request, result))
    return float(least)


def capsule(a: np.ndarray, b: np.ndarray, radius: float) -> tuple[coal.Capsule, coal.Transform3s]:
    length = float(np.linalg.norm(b - a))
    z = (b - a) / length if length > 0.0 else np.array([0.0, 0.0, 1.0])
    x = np.cross(z, np.eye(3)[np.abs(z).argmin()])
    x /= np.linalg.norm(x)
    turn = np.column_stack((x, np.cross(z, x), z))
    return coal.Capsule(radius, length), coal.Transform3s(turn, (a + b) / 2)


@pytest.mark.parametrize("name", [*PROVEN, *REFUTED])
def test_two_libraries_measure_the_same_distances(name: str) -> None:
    trace = sound(name)
    with PyBulletArm(trace) as cell:
        for tick in range(0, len(trace.ticks), 40):
            theirs, other = cell.distance_m(trace.ticks[tick]), by_coal_m(trace, tick)
            assert theirs == pytest.approx(other, abs=1e-5) or max(theirs, other) < 0.0


@pytest.mark.parametrize("fault", HARMLESS, ids=lambda fault: fault.name)
def test_where_compliance_is_proven_a_harmless_change_raises_no_alarm(fault: SeededFault) -> None:
    """By PyBullet, and by coal at every eighth tick with all that can happen between."""
    name = "second-hand" if fault.name == "boxes in another order" else "network-certain"
    rung = trials(name, "nothing-reachable").everywhere(fault)
    assert not rung.caught
    assert rung.geometry is not None
    assert (rung.geometry.runs, rung.geometry.contradicted) == (2, ())
    assert rung.geometry.kept > 0
    trace = fault.seed_into(ChangedSystem(shipped(name)), fault.ladder.values[0]).run()
    ways = tuple(trace.ticks[field].tobytes() for field in ("joint_position_rad", *BODIES))
    if ways not in PROVEN_BY_COAL:  # most of these changes change no bit
        assert_proven_by_coal(trace)
        PROVEN_BY_COAL.add(ways)


def assert_proven_by_coal(trace: Trace) -> None:
    moved_m = np.abs(np.diff(trace.ticks["joint_position_rad"], axis=0)).sum(axis=1) * 2.0
    for body in BODIES:
        steps_m = np.linalg.norm(np.diff(trace.ticks[body], axis=0), axis=2)
        moved_m = moved_m + steps_m[:, trace.ticks["hand_present"][0]].max(axis=1)
    ticks = [*range(0, len(trace.ticks), 8), len(trace.ticks) - 1]
    known = [by_coal_m(trace, tick) for tick in ticks]
    for k, (first, last) in enumerate(pairwise(ticks)):
        assert known[k] + known[k + 1] - moved_m[first:last].sum() > 2.0 * LEAST_M


@pytest.mark.parametrize("name", REFUTED)
def test_where_compliance_is_refuted_both_libraries_and_the_claim_say_so(name: str) -> None:
    trace = sound(name)
    assert hand_distance_kept(trace, LEAST_M) is Kept.REFUTED
    assert min(by_coal_m(trace, tick) for tick in range(0, len(trace.ticks), 5)) < LEAST_M
    assert word_on(trace).verdict is Verdict.VIOLATED


def word_on(trace: Trace) -> Evaluation:
    claim = Claim(sentence=HAND_DISTANCE.example, expected=Verdict.HOLDS)
    prop = property_of(claim, trace.scenario)
    assert isinstance(prop, HandDistance)
    assert prop.minimum_m == LEAST_M
    return prop.evaluate(trace)


@pytest.mark.parametrize("name", PROVEN)
def test_the_limit_at_which_the_proof_ends_is_the_claims_own(name: str) -> None:
    """A proof has 1 mm to spare, and what the arm and the hands move within half a tick at the most."""
    trace = sound(name)
    least_m = (word_on(trace).margin or 0.0) + LEAST_M
    assert hand_distance_kept(trace, least_m - 0.015) is Kept.PROVEN
    assert hand_distance_kept(trace, least_m + 1.5e-3) is Kept.REFUTED
    assert hand_distance_kept(trace, least_m) is not Kept.REFUTED


def test_a_hand_that_is_near_at_one_tick_only_is_found() -> None:
    """However far the ticks before it let one look ahead."""
    beside = run(scenario(hand(Wait(duration_s=1.0), at=(2.0, -1.5, 0.2)), duration_s=0.4))
    assert hand_distance_kept(beside, LEAST_M) is Kept.PROVEN
    ticks = beside.ticks.copy()
    ticks["hand_position_in_base_m"][29, 0] = ticks["transform_tcp_to_base"][29, :3, 3]
    assert hand_distance_kept(replace(beside, ticks=ticks), LEAST_M) is Kept.REFUTED
    ticks = beside.ticks.copy()
    ticks["hand_present"][:29] = False
    ticks["hand_position_in_base_m"][29:, 0] = ticks["transform_tcp_to_base"][29, :3, 3]
    assert hand_distance_kept(replace(beside, ticks=ticks), LEAST_M) is Kept.REFUTED


def test_what_may_be_broken_between_two_ticks_and_what_is_no_number_stay_open() -> None:
    beside = run(scenario(hand(Wait(duration_s=1.0), at=(2.0, -1.5, 0.2)), duration_s=0.4))
    ticks = beside.ticks.copy()
    for body in ("hand_position_in_base_m", "elbow_position_in_base_m"):
        ticks[body][30:, 0] = [-2.0, 1.5, 0.2]
    assert hand_distance_kept(replace(beside, ticks=ticks), LEAST_M) is Kept.OPEN
    for field in ("hand_position_in_base_m", "joint_position_rad"):
        ticks = beside.ticks.copy()
        ticks[field][20] = np.nan
        assert hand_distance_kept(replace(beside, ticks=ticks), LEAST_M) is Kept.OPEN
    assert hand_distance_kept(replace(beside, ticks=beside.ticks[:0]), LEAST_M) is Kept.OPEN


def nothing(system: ChangedSystem, magnitude: float) -> ChangedSystem:
    return system


NO_CHANGE = SeededFault(
    name="nothing", part=FaultyPart.MOTION, hazard="none", seed_into=nothing, harmless="it is none"
)


@pytest.mark.parametrize(
    ("name", "said"), [("network-certain", Verdict.VIOLATED), ("fast-reach", Verdict.HOLDS)]
)
def test_a_word_that_geometry_contradicts_is_a_false_alarm(
    name: str, said: Verdict, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the fault and without alike, so that nothing else would tell."""

    class Wrong(HandDistance):
        def evaluate(self, trace: Trace) -> Evaluation:
            return replace(super().evaluate(trace), verdict=said)

    def broken(claim: Claim, of: object) -> object:
        prop = property_of(claim, of)  # type: ignore[arg-type]
        return Wrong(minimum_m=prop.minimum_m, near_m=prop.near_m) if type(prop) is HandDistance else prop

    assert try_out(trials(name), NO_CHANGE).state is FaultState.QUIET
    trials.cache_clear()
    monkeypatch.setattr(trial, "property_of", broken)
    outcome = try_out(trials(name), NO_CHANGE)
    trials.cache_clear()
    assert outcome.rungs[0].geometry is not None
    assert outcome.rungs[0].geometry.contradicted == (name,)
    assert outcome.state is FaultState.FALSE_ALARM


def test_an_alarm_that_geometry_confirms_is_a_true_one() -> None:
    """Of a change that is declared harmless and is not: the hands come from where the arm is."""
    [alarm] = trial.alarms_between(
        {HAND_DISTANCE.example: word_on(sound("network-certain"))},
        {HAND_DISTANCE.example: word_on(sound("fast-reach"))},
        "made up",
    )
    assert [one.true for one in confirmed_by(hand_distance_kept(sound("fast-reach"), LEAST_M), (alarm,))] == [
        True
    ]
    assert [one.true for one in confirmed_by(Kept.OPEN, (alarm,))] == [False]
    other = replace(alarm, claim=SAME_TWICE)
    assert [one.true for one in confirmed_by(Kept.REFUTED, (alarm, other))] == [True, False]


def test_a_change_that_is_wrongly_declared_harmless_is_told_of() -> None:
    """What it does to the hand distance is true; what it does to other claims nobody else has confirmed."""

    def harm(system: ChangedSystem, magnitude: float) -> ChangedSystem:
        return system.with_avoider(lambda _: TowardsTheHand()).with_gate(PassingGate)

    outcome = try_out(trials("hand-visits-and-leaves"), replace(NO_CHANGE, name="harm", seed_into=harm))
    true = {alarm.claim: alarm.true for rung in outcome.rungs for alarm in rung.alarms}
    assert true.pop(HAND_DISTANCE.example) is True
    assert set(true.values()) == {False}
    assert outcome.state is FaultState.FALSE_ALARM
