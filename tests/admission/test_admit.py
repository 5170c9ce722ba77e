"""What cannot be tried is refused before anything runs, with its place and what was expected."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples import TowardsTheHand, hand, scenario

from safety_harness import admit
from safety_harness.admission.claims import property_of
from safety_harness.admission.poses import start_joint_position
from safety_harness.base.exceptions import InadmissibleError, Place
from safety_harness.base.settings import DEFAULTS, Avoidance, Camera, HandSensor, HandSensorKind, Object
from safety_harness.cell.controller.desired import desired_transform_tcp_to_base
from safety_harness.cell.robot.description import load_arm
from safety_harness.cell.robot.kinematics import forward_kinematics
from safety_harness.claims.properties.catalogue import CATALOGUE
from safety_harness.scenario.model import (
    Claim,
    JoinedHand,
    JointStart,
    OffsetStart,
    PoseStart,
    Scenario,
    Verdict,
)
from safety_harness.scenario.moves import MoveTo, Tremor
from safety_harness.scenario.shield import Shield

DOWNWARD = DEFAULTS.cell.preferred_joint_position_rad


def starting(start: OffsetStart | JointStart) -> Scenario:
    return replace(
        scenario(), start=start, places={"tcp start": Place(file=Path("f.yaml"), line=7, field="tcp start")}
    )


def refusal(what: Scenario) -> InadmissibleError:
    with pytest.raises(InadmissibleError) as caught:
        admit(what)
    return caught.value


def test_an_offset_start_is_where_it_was_asked_for() -> None:
    offset = (0.04, -0.12, 0.06)
    arm = load_arm()
    transforms = np.empty((8, 4, 4))
    joints = start_joint_position(scenario(offset=offset), arm)
    forward_kinematics(arm.chain[0], joints, transforms)
    expected = desired_transform_tcp_to_base(DEFAULTS)
    expected[:3, 3] += offset
    np.testing.assert_allclose(transforms[7], expected, atol=1e-9)


def test_a_start_by_its_position_is_the_offset_start_there() -> None:
    tilt = (0.02, -0.03, 0.01)
    desired = np.array(DEFAULTS.cell.desired_tcp_position_in_base_m)
    place = PoseStart(position_in_base_m=tuple(desired + (0.04, -0.12, 0.06)), tilt_in_tcp_rad=tilt)
    offset = OffsetStart(offset_in_base_m=(0.04, -0.12, 0.06), tilt_in_tcp_rad=tilt)
    joints = [start_joint_position(replace(scenario(), start=start), load_arm()) for start in (place, offset)]
    assert joints[0] == pytest.approx(joints[1], abs=1e-12)


def test_a_hand_of_a_program_is_held_to_its_bounds_too() -> None:
    fast = hand(MoveTo(position_in_base_m=(1.0, -0.5, 0.3), speed_mps=2.1))
    error = refusal(scenario(fast))
    assert (error.place.field, error.got) == ("hands[0].moves[0]", "2.1 m/s")
    assert admit(scenario(replace(fast, max_speed_mps=2.1)))
    trembles = Tremor(amplitude_m=0.003, rate_hz=8.0)
    assert (
        "bound of 1.949 m/s" in refusal(scenario(replace(fast, max_speed_mps=2.1, tremor=trembles))).expected
    )


def test_a_hand_that_is_joined_to_none_before_it_is_refused() -> None:
    joined = JoinedHand(
        name="left",
        joined_to="right",
        apart_in_base_m=(0.0, 0.3, 0.0),
        elbow_towards_in_base_m=(1.6, 0.5, 0.3),
    )
    assert admit(replace(scenario(), hands=(hand(), joined)))
    for hands in ((joined, hand()), (joined,), (hand(name="other"), joined)):
        assert "an earlier hand" in refusal(replace(scenario(), hands=hands)).expected


def test_an_object_out_of_view_comes_with_the_place_for_the_tcp_that_sees_it_best() -> None:
    away = replace(DEFAULTS.object, position_in_base_m=(0.8, 0.4, -0.3))
    error = refusal(scenario(settings=replace(DEFAULTS, object=away)))
    assert "desired tcp position: [800 mm, 355 mm, 350 mm]" in error.hint
    cell = replace(DEFAULTS.cell, desired_tcp_position_in_base_m=(0.8, 0.355, 0.35))
    assert admit(scenario(settings=replace(DEFAULTS, object=away, cell=cell)))


def test_all_starts_of_the_default_workspace_are_admitted() -> None:
    rng = np.random.default_rng(11)
    corners = [(x, y, z) for x in (-0.06, 0.06) for y in (-0.15, 0.15) for z in (-0.1, 0.1)]
    inside = [tuple(rng.uniform(-1, 1, 3) * (0.06, 0.15, 0.1)) for _ in range(40)]
    for offset in corners + inside:
        admit(scenario(offset=offset))


def test_a_start_out_of_reach_is_refused_with_its_place() -> None:
    error = refusal(starting(OffsetStart(offset_in_base_m=(1.2, 0.0, 0.3))))
    assert str(error.place) == "f.yaml:7: tcp start"
    assert "no inverse kinematics" in error.got


def test_a_start_with_the_object_out_of_view_is_refused() -> None:
    assert "in the camera's view" in refusal(starting(OffsetStart(offset_in_base_m=(0.0, 0.4, 0.0)))).expected


def test_a_start_near_the_table_is_refused() -> None:
    assert "above the table" in refusal(starting(OffsetStart(offset_in_base_m=(0.0, 0.0, -0.62)))).expected


def test_joints_beyond_their_limits_are_refused() -> None:
    joints = (0.0, -1.3, 3.3, -2.2, -1.57, 0.0)
    error = refusal(starting(JointStart(joint_position_rad=joints)))
    assert "elbow_joint between -180 and 180 deg" in error.expected


def test_a_singular_start_is_refused() -> None:
    a, b, c, d, _, f = DOWNWARD
    assert "singularit" in refusal(starting(JointStart(joint_position_rad=(a, b, c, d, 0.0, f)))).expected


def test_a_hand_above_the_sensor_of_a_shield_is_refused() -> None:
    """The sensor hangs at 1.8 m and looks down; without a shield nobody relies on it."""
    above, below = (scenario(hand(at=(0.9, -0.5, z))) for z in (1.75, 1.73))
    assert "below the hand sensor" in refusal(replace(above, shield=Shield())).expected
    admit(replace(below, shield=Shield()))
    admit(above)


def test_a_hand_below_the_table_is_refused() -> None:
    assert "above the table" in refusal(scenario(hand(at=(0.9, -0.5, -0.4)))).expected


def test_a_symmetric_object_is_refused() -> None:
    isosceles = Object(polygon_m=((-0.05, -0.04), (0.05, -0.04), (0.0, 0.08)))
    assert "rank 6" in refusal(scenario(settings=replace(DEFAULTS, object=isosceles))).expected


def test_an_eye_in_hand_sensor_with_other_optics_is_refused() -> None:
    sensor = HandSensor(kind=HandSensorKind.EYE_IN_HAND, focal_px=500.0)
    assert "focal, 615 px" in refusal(scenario(settings=replace(DEFAULTS, hand_sensor=sensor))).expected


def test_more_frames_under_way_than_can_be_kept_are_refused() -> None:
    slow = replace(DEFAULTS, camera=Camera(latency_s=2.0))
    assert "under way" in refusal(scenario(settings=slow)).expected


def test_a_restart_before_the_longest_stop_is_over_is_refused() -> None:
    hasty = replace(DEFAULTS, avoidance=Avoidance(restart_delay_s=0.3))
    assert "at least 0.475 s" in refusal(scenario(settings=hasty)).expected


def test_an_unknown_avoider_gets_the_list_and_a_suggestion() -> None:
    error = refusal(scenario(avoider="oposite pose"))
    assert "opposite pose" in error.expected
    assert error.hint == 'did you mean "opposite pose"?'


def test_the_given_avoider_takes_the_place_of_the_named_one() -> None:
    assert admit(scenario(), avoider=TowardsTheHand()).avoider.name == "towards the hand"


def test_every_example_of_the_catalogue_is_understood_and_written_back() -> None:
    for entry in CATALOGUE:
        example = entry.example
        claim = Claim(sentence=example, expected=Verdict.HOLDS)
        assert property_of(claim, scenario()).sentence == example


@pytest.mark.parametrize(
    ("sentence", "expected", "hint"),
    [
        ("hand distance never bellow 50 mm", "a claim of the catalogue", "hand distance never below"),
        ("hand distance never below 50", "length", ""),
        ("hand distance never below 0 mm", "above zero", ""),
        ("hand distance never below -5 mm", "above zero", ""),
        ("TCP speed never above 250 mm", "speed", ""),
        ("gain switch reached within forever", "time", ""),
        ("the robot is nice", "a claim of the catalogue", ""),
        ("hand predictions within 50", "length", ""),
        ("decisions within 100 mm", "time", ""),
        ("joint accelerations never above 500 deg/s", "angular acceleration", ""),
        ("joint accelerations never above 1e9 deg/s2", "at most 100 rad/s2", "another unit"),
        ("TCP acceleration never above 0 m/s2", "above zero", ""),
        ("object in view or recovered within soon", "time", ""),
        ("gain switch reached within 600.5 iterations", "a whole number", ""),
        ("gain switch reached within 0 iterations", "a whole number", ""),
        ("retreats at most three times", "a whole number", ""),
        ("retreats at most 2000000 times", "a whole number from 1 to 1000000", ""),
        ("task pauses at most 2 h", "time", ""),
    ],
)
def test_a_claim_that_is_none_is_refused(sentence: str, expected: str, hint: str) -> None:
    claim = Claim(
        sentence=sentence, expected=Verdict.HOLDS, place=Place(file=Path("f.yaml"), line=9, field="claims")
    )
    with pytest.raises(Exception, match=r"f\.yaml:9") as caught:
        property_of(claim, scenario())
    assert expected in str(caught.value)
    assert hint in str(caught.value)
