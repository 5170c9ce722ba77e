"""A violation whose cause was planted is attributed to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from examples import VISIT, TowardsTheHand, hand, scenario

from safety_harness.admission.admit import Admitted, admit
from safety_harness.admission.trial import run_kinematic
from safety_harness.base.exceptions import InadmissibleError
from safety_harness.base.settings import DEFAULTS, DecisionTimes, GateKind, Settings
from safety_harness.cell.avoidance.measures import optimum_in_base_m
from safety_harness.cell.avoidance.simple import OppositePose
from safety_harness.claims.properties.base import Unit
from safety_harness.extensions.attribution.attribute import (
    Attribution,
    AttributionAnswer,
    Outcome,
    attribute,
    confirmed,
)
from safety_harness.extensions.attribution.ingredients import CHANGES, Altered, ExactOptimum, Ingredient
from safety_harness.extensions.attribution.tally import AttributionTally
from safety_harness.scenario.faults import (
    AvoiderNaN,
    AvoiderSilent,
    Fault,
    HandSensorBlind,
    Joint,
    JointStuck,
)
from safety_harness.scenario.model import NO_AVOIDER, Claim, MovingHand, RecordedHand, Scenario, Verdict
from safety_harness.scenario.moves import FollowTcp, MoveTo, ReachForTcp, Wait, Withdraw
from safety_harness.scenario.read import parse_scenario, read_scenario
from safety_harness.trace.trace import Trace

LAGGING = """\
scenario: a slow hand, an arm whose drives follow late
duration: 6 s
robot: {arm: "shipped:iiwa14", drives: {dead time: 100 ms, lag: 1 s}}
tcp start: {offset: [40 mm, -120 mm, 60 mm]}
avoider: opposite pose
object: {position: [550 mm, 45 mm, -300 mm]}
hands:
  - hand: right
    starts at: [900 mm, -700 mm, 250 mm]
    elbow towards: [1600 mm, -1200 mm, 300 mm]
    moves: [{wait: 500 ms}, {move to: [580 mm, -140 mm, 300 mm], speed: 0.4 m/s}]
settings:
  cell:
    desired tcp position: [550 mm, 0 mm, 250 mm]
    preferred joint position: [0 deg, 40 deg, 0 deg, -95 deg, 0 deg, 45 deg, 0 deg]
claims: {hand distance never below 50 mm: holds}
"""
RECORDED = "shipped:recorded-giving"
DISTANCE = "hand distance never below 50 mm"
AWAY = "repulsion moves away from every hand"
SLOW_HAND = hand(
    MoveTo(position_in_base_m=(0.76, -0.08, 0.38), speed_mps=0.25),
    Wait(duration_s=1.0),
    Withdraw(speed_mps=1.0),
)


def claim(sentence: str) -> Claim:
    return Claim(sentence=sentence, expected=Verdict.HOLDS)


def with_avoidance(**changed: object) -> Settings:
    return replace(DEFAULTS, avoidance=replace(DEFAULTS.avoidance, **changed))  # type: ignore[arg-type]


def slow(settings: Settings = DEFAULTS, *faults: Fault) -> Scenario:
    return replace(scenario(SLOW_HAND, duration_s=6.0, settings=settings), faults=faults)


def only(admitted: Admitted, sentence: str = DISTANCE) -> Attribution:
    (found,) = attribute(admitted, [claim(sentence)])
    return found


REACH = with_avoidance(gate=GateKind.REACH)
SMALL = with_avoidance(critical_distance_m=0.1)
LATE = with_avoidance(decision_deadline_s=3.0, decision_time=DecisionTimes(quantiles_s=(1.6,)))


def reversed_avoider() -> Admitted:
    return admit(scenario(VISIT, settings=REACH), avoider=TowardsTheHand())


def test_what_an_ordinary_system_keeps_is_what_these_tests_break() -> None:
    assert attribute(admit(replace(slow(), claims=(claim(DISTANCE),)))) == ()


def test_a_reversed_avoider_is_blamed() -> None:
    found = only(reversed_avoider(), AWAY)
    assert found.cause == (Ingredient.AVOIDER,)
    assert found.margin is not None
    assert found.margin < -0.3
    assert any(one.ingredients == (Ingredient.GATE,) for one in found.helping)  # the full gate sees it too
    assert found.summary.startswith("avoider (exact optimum): +")


def test_late_decisions_are_blamed_and_not_what_is_decided() -> None:
    found = only(admit(slow(LATE)))
    assert [one.ingredients for one in found.helping] == [(Ingredient.DEADLINE,)]


def test_a_blind_sensor_is_blamed() -> None:
    found = only(admit(slow(DEFAULTS, HandSensorBlind())))
    assert [one.ingredients for one in found.helping] == [(Ingredient.PERCEPTION,)]


def test_a_small_critical_distance_is_blamed_with_the_least_change_that_helps() -> None:
    found = only(admit(slow(SMALL)))
    assert found.group == "critical distance"
    assert found.summary.startswith("critical distance (x 2): +")
    alone = {one.summary: one.outcome for one in found.replays if len(one.changes) == 1}
    assert alone["critical distance (x 1.5)"] is Outcome.VIOLATED


def test_a_stuck_joint_is_blamed_for_all_that_it_breaks() -> None:
    stuck = replace(scenario(VISIT), faults=(JointStuck(joint=Joint.ELBOW, from_s=0.5),))
    sentences = [AWAY, "TCP acceleration never above 2 m/s2", "joint accelerations never above 500 deg/s2"]
    found = attribute(admit(replace(stuck, claims=tuple(map(claim, sentences)))))
    assert len(found) > 1
    assert {one.cause for one in found} == {(Ingredient.DRIVES,)}


@pytest.mark.parametrize("fault", [AvoiderNaN(), AvoiderSilent()])
def test_an_avoider_that_answers_nothing_is_blamed(fault: Fault) -> None:
    found = only(admit(replace(scenario(VISIT), faults=(fault,))), "proposed repulsive poses reachable")
    assert found.cause == (Ingredient.AVOIDER,)


def test_two_causes_are_named_together() -> None:
    found = only(admit(slow(LATE, HandSensorBlind())))
    assert found.cause == (Ingredient.DEADLINE, Ingredient.PERCEPTION)
    assert found.group == "deadline and perception"
    assert not any(one.helps for one in found.replays if len(one.changes) == 1)


def test_what_the_replay_does_not_show_is_not_attributed() -> None:
    found = only(admit(slow()))
    assert found.answer is AttributionAnswer.NOT_ATTRIBUTED
    assert found.summary == "not attributed: the kinematic replay does not reproduce it: holds"
    assert not found.replays
    expected = replace(slow(), claims=(Claim(sentence=DISTANCE, expected=Verdict.VIOLATED),))
    assert [one.answer for one in attribute(admit(expected))] == [AttributionAnswer.NOT_ATTRIBUTED]


def test_a_run_that_fails_is_not_attributed() -> None:
    def fails(systems: Sequence[Altered]) -> list[Trace | Exception]:
        return [ValueError("no such run") for _ in systems]

    (found,) = attribute(admit(slow(SMALL)), [claim(DISTANCE)], run=fails)
    assert found.answer is AttributionAnswer.NOT_ATTRIBUTED
    assert "no such run" in found.why
    with pytest.raises(ValueError, match="no such run"):
        attribute(admit(replace(slow(SMALL), claims=(claim(DISTANCE),))), run=fails)


def test_it_is_the_same_every_time() -> None:
    first, again = (only(admit(slow(SMALL))) for _ in range(2))
    assert first.summary == again.words
    assert [(one.summary, one.margin) for one in first.replays] == [
        (one.summary, one.margin) for one in again.replays
    ]


def test_pybullet_confirms_what_is_blamed() -> None:
    system = admit(slow(SMALL))
    as_it_is, changed = confirmed(system, only(system))
    assert (as_it_is.outcome, changed.outcome) == (Outcome.VIOLATED, Outcome.KEPT)


def test_a_claim_that_is_none_is_refused() -> None:
    with pytest.raises(InadmissibleError):
        attribute(admit(slow()), [claim("all is well")])


def test_the_exact_optimum_is_the_closed_form_one_at_a_time_and_together() -> None:
    rng = np.random.default_rng(3)
    hands, tcps = rng.uniform(-1.0, 1.0, (2, 5, 3))
    avoider = ExactOptimum(OppositePose(0.1), DEFAULTS)
    expected = optimum_in_base_m(DEFAULTS, hands, tcps)
    together, spreads = avoider.propose_many(hands, tcps, np.zeros(5, np.uint64))
    single = [
        avoider.propose(hand_position_in_base_m=h, tcp_position_in_base_m=t, seed=0).position_in_base_m
        for h, t in zip(hands, tcps, strict=True)
    ]
    assert np.array_equal(together, expected)
    assert not spreads.any()
    assert np.allclose(single, expected, rtol=0.0, atol=1e-15)


def test_what_changes_nothing_is_not_tried() -> None:
    system = Altered.from_admitted(admit(scenario(hand())))
    tried = {str(change) for change in CHANGES if change.on(system) is not None}
    idle = {"deadline (answers within a tick)", "perception (ideal)", "servoing (ideal camera)"}
    assert not tried & {*idle, "avoider (opposite pose)", "hand (half as fast)"}
    assert "avoider (exact optimum)" in tried
    assert "gate (the other kind)" in tried


def test_a_hand_half_as_fast_goes_the_same_way_for_twice_as_long() -> None:
    moves = (
        Wait(duration_s=0.5),
        ReachForTcp(speed_mps=1.0, until_distance_m=0.2, at_most_s=2.0),
        FollowTcp(speed_mps=0.4, distance_m=0.2, duration_s=1.5),
        Withdraw(speed_mps=0.6),
    )
    (change,) = (one for one in CHANGES if one.ingredient is Ingredient.HAND)
    slower = change.on(Altered.from_admitted(admit(scenario(hand(*moves)))))
    assert slower is not None
    assert slower.scenario.duration_s == 5.0
    (half,) = slower.scenario.hands
    assert isinstance(half, MovingHand)
    assert half.moves == (
        Wait(duration_s=0.5),
        ReachForTcp(speed_mps=0.5, until_distance_m=0.2, at_most_s=4.0),
        FollowTcp(speed_mps=0.2, distance_m=0.2, duration_s=3.0),
        Withdraw(speed_mps=0.3),
    )


def test_a_recorded_hand_half_as_fast_takes_twice_as_long() -> None:
    recorded = read_scenario(RECORDED)
    hands = tuple(replace(one, speed_factor=0.8) for one in recorded.hands if isinstance(one, RecordedHand))
    (change,) = (one for one in CHANGES if one.ingredient is Ingredient.HAND)
    slower = change.on(Altered.from_admitted(admit(replace(recorded, hands=hands))))
    assert slower is not None
    for before, after in zip(hands, slower.scenario.hands, strict=True):
        assert isinstance(after, RecordedHand)
        assert after.speed_factor == 0.4
        assert (after.motion.time_s == 2.0 * before.motion.time_s).all()


def test_violations_without_a_cause_come_last_however_many_they_are() -> None:
    claim = Claim(sentence=DISTANCE, expected=Verdict.HOLDS)
    answers = [AttributionAnswer.NOT_ATTRIBUTED] * 3 + [AttributionAnswer.UNAVOIDABLE]
    tally = AttributionTally.from_attributions(
        Attribution(scenario="s", claim=claim, unit=Unit.LENGTH, answer=answer, margin=-0.1)
        for answer in answers
    )
    assert list(tally.groups.items()) == [("unavoidable", 1), ("not attributed", 3)]


def test_nothing_of_the_servo_is_tried_of_another_controller() -> None:
    driven = replace(slow(), controller="stop when near", avoider=NO_AVOIDER)
    system = Altered.from_admitted(admit(driven))
    tried = {change.ingredient for change in CHANGES if change.on(system) is not None}
    assert not tried & {Ingredient.AVOIDER, Ingredient.DEADLINE, Ingredient.GATE, Ingredient.FALLBACK}
    assert Ingredient.HAND in tried


def test_answers_that_take_a_controller_long_are_blamed() -> None:
    late = with_avoidance(decision_time=DecisionTimes(quantiles_s=(0.4,)))
    driven = replace(scenario(VISIT), controller="stop when near", avoider=NO_AVOIDER)
    cases = [replace(driven, settings=settings) for settings in (DEFAULTS, late)]
    near_m = [float(run_kinematic(admit(case)).ticks["hand_distance_m"].min()) for case in cases]
    assert near_m[0] > near_m[1] + 0.005
    found = only(admit(cases[1]), f"hand distance never below {500.0 * sum(near_m):.3f} mm")
    assert found.cause == (Ingredient.DEADLINE,)


def test_drives_that_lag_are_blamed() -> None:
    found = only(admit(parse_scenario(LAGGING)))
    assert found.cause == (Ingredient.DRIVES,)


def test_every_pair_is_tried_where_nothing_helps_alone() -> None:
    """The sensor alone makes it worse, and the avoider alone is never asked."""
    blind = replace(slow(REACH), faults=(HandSensorBlind(),))
    found = only(admit(blind, avoider=TowardsTheHand()))
    assert found.cause == (Ingredient.AVOIDER, Ingredient.PERCEPTION)
    single = {one.ingredients for one in found.replays if len(one.changes) == 1}
    pairs = {one.ingredients for one in found.replays if len(one.changes) == 2}
    assert len(pairs) == len(single) * (len(single) - 1) // 2


def test_a_tally_counts_each_violation_once_and_every_change_that_helps() -> None:
    found = [only(reversed_avoider(), AWAY), only(admit(slow(SMALL))), only(admit(slow()))]
    tally = AttributionTally.from_attributions(found)
    assert tally.summary == "of 3: 1 avoider, 1 critical distance, 1 not attributed"
    assert tally.would_help["avoider (exact optimum)"] == 1
    assert tally.would_help["critical distance (x 2)"] == 1
    assert tally.would_help["critical distance (x 1.5)"] == 0
    assert list(AttributionTally.from_attributions([]).lines()) == []
    data = tally.as_json()
    assert data["violations"] == 3
    assert data["groups"] == tally.groups
