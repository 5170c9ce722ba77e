"""Unavoidable is what no arm could have kept, and nothing else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from examples import hand, scenario
from foresight import best_distance_m

from safety_harness.admission.admit import Admitted, admit
from safety_harness.admission.trial import run_many
from safety_harness.extensions.attribution.attribute import AttributionAnswer, attribute
from safety_harness.extensions.attribution.ingredients import CHANGES, Altered, Ingredient
from safety_harness.extensions.attribution.unavoidable import Chase, FreeArm, why_unavoidable
from safety_harness.scenario.faults import Joint, JointStuck
from safety_harness.scenario.model import NO_AVOIDER, Claim, MovingHand, Verdict
from safety_harness.scenario.moves import FollowTcp, HandMove, Hesitation, MoveTo, ReachForTcp, Wait

DISTANCE = Claim(sentence="hand distance never below 50 mm", expected=Verdict.HOLDS)
TO_THE_BASE = hand(MoveTo(position_in_base_m=(0.15, -0.1, 0.1), speed_mps=0.5), at=(1.0, -0.8, 0.1))


def admitted(*hands: MovingHand, duration_s: float = 4.0) -> Admitted:
    return admit(replace(scenario(*hands, duration_s=duration_s), claims=(DISTANCE,)))


def reaching(
    until_m: float = 0.08, speed_mps: float = 1.0, *before: HandMove, at_most_s: float = 3.0
) -> MovingHand:
    move = ReachForTcp(speed_mps=speed_mps, until_distance_m=until_m, at_most_s=at_most_s)
    return hand(*(before or (Wait(duration_s=0.2),)), move)


def why(*hands: MovingHand, duration_s: float = 4.0) -> str:
    system = admitted(*hands, duration_s=duration_s)
    return why_unavoidable(system, system.properties[0])


def test_nothing_gets_out_of_the_way_of_a_hand_at_the_base() -> None:
    (found,) = attribute(admitted(TO_THE_BASE))
    assert found.answer is AttributionAnswer.UNAVOIDABLE
    assert "shoulder" in found.why
    assert "no joint moves" in found.why


def test_a_hand_that_starts_at_the_tool_leaves_it_no_time() -> None:
    system = admitted(hand(at=(0.74, -0.12, 0.295)))
    assert "wherever the TCP can be at 0.00 s" in why_unavoidable(system, system.properties[0])


def test_nobody_outruns_a_hand_that_pursues_the_tool() -> None:
    assert "heads for the TCP at 1 m/s, which leaves at 0.25 m/s" in why(reaching())
    follows = FollowTcp(speed_mps=1.0, distance_m=0.08, duration_s=3.0)
    assert why(hand(Wait(duration_s=0.2), follows))


def test_a_tool_that_the_servo_does_not_hold_back_may_outrun_it() -> None:
    """A user's controller may command joint velocities; a stuck joint turns the tool out of its way."""
    system = admitted(reaching())
    stuck = replace(system.scenario, faults=(JointStuck(joint=Joint.ELBOW, from_s=0.5),))
    driven = replace(system.scenario, controller="stop when near", avoider=NO_AVOIDER)
    for other in (stuck, driven):
        assert why_unavoidable(admit(other), system.properties[0]) == ""


@pytest.mark.parametrize(
    "one",
    [
        reaching(until_m=0.2),  # it stays away by itself
        reaching(speed_mps=0.2),  # the TCP is faster
        reaching(at_most_s=0.5),  # it gives up
        reaching(0.08, 1.0, FollowTcp(speed_mps=0.3, distance_m=0.3, duration_s=0.5)),  # where is it then?
        hand(MoveTo(position_in_base_m=(0.7, 0.0, 0.35), speed_mps=1.0)),  # known beforehand
    ],
)
def test_what_an_arm_with_foresight_may_keep_is_not_called_unavoidable(one: MovingHand) -> None:
    assert why(one) == ""


def test_nor_is_a_reach_that_hesitates_or_is_cut_short_by_the_end_of_the_run() -> None:
    hesitates = Hesitation(distance_m=0.3, duration_s=0.3)
    (reach,) = reaching().moves[1:]
    assert isinstance(reach, ReachForTcp)
    assert why(hand(Wait(duration_s=0.2), replace(reach, hesitation=hesitates))) == ""
    assert why(reaching(), duration_s=1.0) == ""


def test_other_claims_are_never_unavoidable() -> None:
    system = admitted(TO_THE_BASE)
    stands = Claim(sentence="protective separation kept", expected=Verdict.HOLDS)
    other = admit(replace(system.scenario, claims=(stands,)))
    assert why_unavoidable(other, other.properties[0]) == ""


def test_no_motion_with_foresight_keeps_what_is_called_unavoidable() -> None:
    for one in (reaching(), reaching(0.11, 0.9), reaching(0.06, 1.5)):
        assert why(one)
        assert best_distance_m(admitted(one), 60) < 0.05
    assert best_distance_m(admitted(TO_THE_BASE), 4) < 0.05


def test_the_same_motions_keep_what_can_be_kept() -> None:
    assert best_distance_m(admitted(reaching(until_m=0.2)), 10) > 0.05


def test_no_change_of_the_system_helps_what_is_called_unavoidable() -> None:
    system = Altered.from_admitted(admitted(reaching()))
    others = (change.on(system) for change in CHANGES if change.ingredient is not Ingredient.HAND)
    traces = list(run_many([altered for altered in others if altered is not None]))
    assert len(traces) > 5
    assert {system.properties[0].evaluate(trace).verdict for trace in traces} == {Verdict.VIOLATED}


def test_the_bound_is_never_below_what_a_fleeing_tool_is_left_with() -> None:
    """In one dimension: the TCP flees straight away from where the hand comes."""
    rng = np.random.default_rng(11)
    bounded = 0
    for _ in range(200):
        speed_mps, until_m = rng.uniform(0.3, 2.0), rng.uniform(0.02, 0.2)
        chase = Chase(float(speed_mps), 10.0, float(until_m), 0.25, 0.008)
        caught = chase.caught(0.9, 0.9)
        if caught is None:
            continue
        bounded += 1
        gap_m, hand_mps, time_s = 0.9, 0.0, 0.0
        nearest_m = gap_m
        while time_s < caught[0] + caught[1]:
            left_m, change = gap_m - until_m, 10.0 * 0.008
            if left_m <= 0.0:
                break
            room = max(4.0 * 10.0 * left_m - 2.0 * change * hand_mps, 0.0)
            wanted = min(speed_mps, room / (change + np.sqrt(change**2 + 2.0 * room)))
            before = hand_mps
            hand_mps += np.clip(wanted - hand_mps, -change, change)
            gap_m += (0.25 - 0.5 * (before + hand_mps)) * 0.008
            nearest_m, time_s = min(nearest_m, gap_m), time_s + 0.008
        assert nearest_m <= caught[2]
    assert bounded > 100


def test_the_free_arm_contains_the_arm() -> None:
    system = admitted(reaching())
    free = FreeArm.from_checked(system)
    assert 0.01 < free.tip_m < 0.05
    assert set(free.body.names) == {"base_1", "base_2", "shoulder"}
    assert np.linalg.norm(free.start_m - free.centre_m) < free.reach_m
