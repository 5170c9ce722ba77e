"""Each fault does what it says, when it says, and nothing else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from examples import VISIT, run, scenario

from safety_harness.base.geometry.transforms import inverse_transform
from safety_harness.base.settings import DEFAULTS, HandSensorKind
from safety_harness.cell.perception.hand_boxes import position_from_box, sphere_box
from safety_harness.cell.robot.drive import drive_dtype
from safety_harness.scenario.fault_table import fault_table
from safety_harness.scenario.faults import (
    EVERY_FAULT,
    AvoiderLate,
    AvoiderNaN,
    AvoiderSilent,
    CameraBlind,
    CameraFrozen,
    CameraHidden,
    CameraKnocked,
    CameraLate,
    FalseHand,
    Fault,
    FaultKind,
    HandSensorBlind,
    HandSensorFrozen,
    HandSensorLate,
    HandSensorOff,
    Joint,
    JointStuck,
)
from safety_harness.scenario.model import MovingHand, Scenario
from safety_harness.scenario.moves import MoveTo, Wait
from safety_harness.trace.compare import first_difference
from safety_harness.trace.records import Check, DecisionOutcome, Mode
from safety_harness.trace.trace import Trace

FROM_S, END_S = 1.0, 1.4
PERIOD_S = DEFAULTS.clock.control_period_s
FIRST, AFTER = round(FROM_S / PERIOD_S), round(END_S / PERIOD_S)
NEAR = MovingHand(  # comes nearer and passes between camera and object
    name="right",
    starts_at_in_base_m=(1.1, -0.75, 0.2),
    elbow_towards_in_base_m=(1.6, -1.2, 0.3),
    moves=(
        MoveTo(position_in_base_m=(0.75, -0.02, -0.12), speed_mps=1.0),
        Wait(duration_s=0.3),
    ),
)
FAULTS: tuple[Fault, ...] = (
    HandSensorBlind(),
    HandSensorFrozen(),
    HandSensorLate(delay_s=0.2),
    HandSensorOff(offset_in_base_m=(0.02, -0.03, 0.05)),
    FalseHand(position_in_base_m=(0.8, 0.2, 0.3)),
    CameraBlind(),
    CameraFrozen(),
    CameraLate(delay_s=0.2),
    CameraKnocked(turned_in_camera_rad=(0.0, 0.02, 0.0), shifted_in_tcp_m=(0.0, 0.0, 0.01)),
    CameraHidden(),
    JointStuck(joint=Joint.ELBOW),
    AvoiderLate(delay_s=0.08),
    AvoiderSilent(),
    AvoiderNaN(),
)


def noisy() -> Scenario:
    """An overhead sensor with noise and dropouts at 30 Hz, and a hand that comes near."""
    sensor = replace(
        DEFAULTS.hand_sensor,
        kind=HandSensorKind.OVERHEAD,
        pixel_noise_px=1.0,
        depth_noise_per_m=0.0025,
        dropout_probability=0.1,
        rate_hz=30.0,
        latency_s=0.02,
    )
    return scenario(VISIT, duration_s=2.0, settings=replace(DEFAULTS, hand_sensor=sensor))


WITHOUT: dict[str, Trace] = {}


def without(what: Scenario, name: str) -> Trace:
    if name not in WITHOUT:
        WITHOUT[name] = run(what)
    return WITHOUT[name]


def during(fault: Fault, from_s: float = FROM_S, end_s: float | None = END_S) -> Fault:
    return replace(fault, from_s=from_s, until_s=end_s)


def with_faults(what: Scenario, *faults: Fault) -> Trace:
    return run(replace(what, faults=faults))


def acted(trace: Trace, k: int = 0) -> np.ndarray:
    return (trace.ticks["faults"] >> k & 1) != 0


def test_every_fault_has_a_phrase_a_record_and_a_test_here() -> None:
    assert {type(fault) for fault in FAULTS} == set(EVERY_FAULT)
    assert len({kind.phrase.kind for kind in EVERY_FAULT}) == len(EVERY_FAULT) == len(FAULTS)
    assert {kind.phrase.kind for kind in EVERY_FAULT} == set(FaultKind)


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: type(fault).__name__)
def test_until_it_acts_a_run_is_bit_for_bit_the_run_without_it(fault: Fault) -> None:
    what = noisy() if not isinstance(fault, CameraHidden) else scenario(NEAR, duration_s=2.0)
    healthy = without(what, "hidden" if isinstance(fault, CameraHidden) else "noisy")
    begin = FROM_S
    if isinstance(fault, AvoiderLate | AvoiderSilent | AvoiderNaN):
        begin = float(healthy.decisions["time_s"][0]) - 0.04
    trace = with_faults(what, during(fault, begin, begin + 0.4))
    difference = first_difference(healthy, trace)
    assert difference is not None
    assert difference.time_s >= begin - 1e-9
    assert acted(trace).any()
    ticks = np.flatnonzero(acted(trace)) * PERIOD_S
    wait_s = DEFAULTS.avoidance.decision_deadline_s if begin != FROM_S else 0.0
    assert ticks.min() >= begin - 1e-9
    assert ticks.max() < begin + 0.4 + wait_s + PERIOD_S


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: type(fault).__name__)
def test_a_fault_whose_time_is_over_before_the_first_picture_changes_nothing(fault: Fault) -> None:
    """Its time lies between two ticks: nothing is looked at, asked or told then."""
    trace = with_faults(noisy(), during(fault, FROM_S + 0.25 * PERIOD_S, FROM_S + 0.75 * PERIOD_S))
    assert first_difference(without(noisy(), "noisy"), trace) is None


def test_two_runs_with_faults_are_the_same_bit_by_bit() -> None:
    several = [during(fault, 0.5 + 0.1 * k, 1.5) for k, fault in enumerate(FAULTS) if k != 12]
    first, second = (with_faults(noisy(), *several) for _ in range(2))
    assert first.ticks.tobytes() == second.ticks.tobytes()
    assert acted(first, 3).any()


# the hand sensor


def test_of_a_blind_sensor_a_hand_is_gone_when_its_track_is_given_up() -> None:
    trace = with_faults(scenario(VISIT, duration_s=2.0), HandSensorBlind(from_s=0.1))
    seen = trace.ticks["track_valid"].any(axis=1)
    timeout = DEFAULTS.hand_filter.track_timeout_s
    last = 0.096 + timeout  # the last picture with a hand, and its timeout
    assert seen[: round(last / PERIOD_S)].all()
    assert not seen[round(last / PERIOD_S) + 2 :].any()
    assert (trace.decisions["time_s"] < last + 2 * PERIOD_S).all()  # of a hand that is only extrapolated


def test_a_frozen_sensor_shows_a_hand_that_stands_where_it_was() -> None:
    trace = with_faults(scenario(VISIT, duration_s=2.0), HandSensorFrozen(from_s=0.1))
    seen_m = trace.ticks["predicted_hand_in_base_m"][-1, 0]
    where_m = trace.ticks["hand_position_in_base_m"][round(0.096 / PERIOD_S), 0]
    assert seen_m == pytest.approx(where_m, abs=0.005)
    assert np.linalg.norm(trace.ticks["hand_position_in_base_m"][90, 0] - where_m) > 0.3


def test_a_sensor_that_is_frozen_from_the_beginning_never_saw_a_hand() -> None:
    trace = with_faults(scenario(VISIT, duration_s=0.5), HandSensorFrozen())
    assert not trace.ticks["track_valid"].any()


def test_a_late_picture_arrives_so_much_later_and_none_overtakes_it() -> None:
    """No picture arrives for 200 ms; the first after it is the one that was taken when that began."""
    what = scenario(VISIT, duration_s=1.0)
    trace = with_faults(what, HandSensorLate(delay_s=0.2))
    first = int(np.argmax(trace.ticks["track_valid"].any(axis=1)))
    assert first == round(0.2 / PERIOD_S)
    eased = with_faults(what, HandSensorLate(delay_s=0.2, until_s=0.4))
    # the last late one of tick 49 arrives at tick 74, with all that waited behind it
    healthy = without(what, "short visit")
    later = slice(round(0.6 / PERIOD_S) + 12, None)
    np.testing.assert_allclose(
        eased.ticks["predicted_hand_in_base_m"][later, 0],
        healthy.ticks["predicted_hand_in_base_m"][later, 0],
        atol=0.02,
    )


def test_a_sensor_that_is_off_is_off_by_that_in_base() -> None:
    by = np.array([0.02, -0.03, 0.05])
    what = scenario(replace(VISIT, moves=()), duration_s=0.5)
    trace = with_faults(what, HandSensorOff(offset_in_base_m=tuple(by)))
    seen = trace.ticks["predicted_hand_in_base_m"][-1, 0] - trace.ticks["hand_position_in_base_m"][-1, 0]
    bias = run(what).ticks["predicted_hand_in_base_m"][-1, 0] - trace.ticks["hand_position_in_base_m"][-1, 0]
    assert seen - bias == pytest.approx(by, abs=1.5e-3)  # the pinhole conversion errs by the angle of view


def test_a_false_hand_is_seen_where_it_is_said_to_be_beside_the_true_one() -> None:
    at = (0.8, 0.2, 0.3)
    what = scenario(replace(VISIT, moves=()), duration_s=0.5)
    trace = with_faults(what, FalseHand(position_in_base_m=at))
    assert trace.ticks["track_valid"][-1].sum() == 2
    assert trace.ticks["predicted_hand_in_base_m"][-1, 1] == pytest.approx(np.array(at), abs=3e-3)
    assert trace.ticks["hand_present"][-1].sum() == 1
    healthy = run(what)
    assert np.array_equal(
        healthy.ticks["predicted_hand_in_base_m"][:, 0], trace.ticks["predicted_hand_in_base_m"][:, 0]
    )


def test_a_false_hand_out_of_the_view_of_a_camera_that_is_carried_does_not_act() -> None:
    settings = replace(DEFAULTS, hand_sensor=replace(DEFAULTS.hand_sensor, kind=HandSensorKind.EYE_IN_HAND))
    what = scenario(duration_s=0.2, settings=settings)
    trace = with_faults(
        what, FalseHand(position_in_base_m=(0.8, 0.6, 0.6)), FalseHand(position_in_base_m=(0.7, 0.0, -0.2))
    )
    assert not acted(trace, 0).any()
    assert acted(trace, 1).all()


def test_a_false_box_is_that_of_a_true_hand() -> None:
    """An independent way there and back: the box of a sphere, and the place that a box means."""
    sensor = DEFAULTS.hand_sensor
    pose = np.eye(4)
    pose[:3, :3] = [[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]
    pose[:3, 3] = sensor.overhead_position_in_base_m
    at = np.array([0.75, -0.25, 0.4])  # on the optical axis, where the conversion is exact
    box, place = np.empty(5), np.empty(3)
    centre = (inverse_transform(pose) @ np.append(at, 1.0))[:3]
    assert sphere_box(centre, DEFAULTS.hand.radius_m, sensor.focal_px, 319.5, 239.5, box)
    position_from_box(box, sensor.focal_px, 319.5, 239.5, DEFAULTS.hand.radius_m, place)
    trace = with_faults(scenario(duration_s=0.1), FalseHand(position_in_base_m=tuple(at)))
    assert (pose @ np.append(place, 1.0))[:3] == pytest.approx(at, abs=1e-9)
    assert trace.ticks["predicted_hand_in_base_m"][-1, 0] == pytest.approx(at, abs=1e-6)


# the servoing camera


def test_a_blind_camera_loses_the_object_for_just_its_time() -> None:
    trace = with_faults(scenario(duration_s=2.0), during(CameraBlind()))
    lost = trace.ticks["mode"] == Mode.OBJECT_LOST
    assert np.array_equal(np.flatnonzero(lost), np.arange(FIRST, AFTER))
    assert np.array_equal(~trace.ticks["object_visible"], lost)
    assert np.array_equal(acted(trace), lost)


def test_a_frozen_camera_shows_the_features_of_the_moment_before() -> None:
    trace = with_faults(scenario(duration_s=2.0), during(CameraFrozen()))
    features = trace.ticks["features"]
    assert (features[FIRST:AFTER] == features[FIRST - 1]).all()
    assert (features[AFTER] != features[FIRST - 1]).all()


def test_a_camera_that_is_frozen_from_the_beginning_never_saw_the_object() -> None:
    trace = with_faults(scenario(duration_s=0.2), CameraFrozen())
    assert not trace.ticks["object_visible"].any()


def test_a_late_camera_shows_what_was_so_long_ago() -> None:
    """The features of the same poses, 25 ticks later."""
    trace = with_faults(scenario(duration_s=2.0), CameraLate(delay_s=0.2))
    assert not trace.ticks["object_visible"][:25].any()
    again = run(scenario(duration_s=0.008))
    assert np.array_equal(trace.ticks["features"][25], again.ticks["features"][0])


def test_a_knocked_camera_sees_what_a_camera_mounted_so_would_see() -> None:
    """The first picture of a camera whose mount is shifted by the same offset, from the same place."""
    shift = (0.01, -0.02, 0.005)
    trace = with_faults(scenario(duration_s=0.1), CameraKnocked(shifted_in_tcp_m=shift))
    camera = DEFAULTS.camera
    moved = tuple(np.array(camera.mount_offset_in_tcp_m) + shift)
    other = replace(DEFAULTS, camera=replace(camera, mount_offset_in_tcp_m=moved))
    believed = run(scenario(duration_s=0.1, settings=other))
    # the same picture; a_n is in units of the desired depth and area, which the mount moves too
    assert trace.ticks["features"][0, 3:] == pytest.approx(believed.ticks["features"][0, 3:], rel=1e-9)


def test_a_camera_turned_about_its_axis_sees_the_object_turned_back() -> None:
    turn = 0.1
    healthy = run(scenario(duration_s=0.008)).ticks["features"][0]
    knocked = with_faults(
        scenario(duration_s=0.008),
        CameraKnocked(turned_in_camera_rad=(0.0, 0.0, 0.04)),
        CameraKnocked(turned_in_camera_rad=(0.0, 0.0, 0.06)),
    ).ticks["features"][0]
    apart = knocked[5] - healthy[5] + turn  # a direction without a sense: half a turn is none
    assert np.sin(apart) == pytest.approx(0.0, abs=1e-9)
    assert knocked[2:5] == pytest.approx(healthy[2:5], abs=1e-9)
    c, s = np.cos(turn), np.sin(turn)
    assert knocked[:2] == pytest.approx(np.array([[c, s], [-s, c]]) @ healthy[:2], abs=1e-9)


def test_a_knocked_camera_that_watches_the_hands_misplaces_them_too() -> None:
    """The camera has moved 50 mm along base -y and is not known to: hands seem to be 50 mm towards +y."""
    settings = replace(DEFAULTS, hand_sensor=replace(DEFAULTS.hand_sensor, kind=HandSensorKind.EYE_IN_HAND))
    still = replace(NEAR, starts_at_in_base_m=(0.72, -0.1, -0.1), moves=())
    what = scenario(still, duration_s=0.01, settings=settings)
    healthy, knocked = run(what), with_faults(what, CameraKnocked(shifted_in_tcp_m=(0.0, 0.05, 0.0)))
    apart = (
        knocked.ticks["predicted_hand_in_base_m"][-1, 0] - healthy.ticks["predicted_hand_in_base_m"][-1, 0]
    )
    assert apart == pytest.approx([0.0, 0.05, 0.0], abs=4e-3)


def test_hands_are_transparent_without_the_fault_and_hide_the_object_with_it() -> None:
    what = scenario(NEAR, duration_s=2.0)
    healthy, hidden = without(what, "hidden"), with_faults(what, CameraHidden())
    assert healthy.ticks["object_visible"].all()
    assert np.array_equal(~hidden.ticks["object_visible"], acted(hidden))
    assert acted(hidden)[-1]
    assert not acted(hidden)[0]


def test_a_forearm_hides_the_object_as_a_hand_does() -> None:
    """The hand is beyond the object, its forearm lies across."""
    across = replace(
        NEAR, starts_at_in_base_m=(0.7, 0.23, -0.1), elbow_towards_in_base_m=(0.7, -0.6, -0.1), moves=()
    )
    beside = replace(across, elbow_towards_in_base_m=(0.7, 0.9, -0.1))
    assert acted(with_faults(scenario(across, duration_s=0.05), CameraHidden())).all()
    assert not acted(with_faults(scenario(beside, duration_s=0.05), CameraHidden())).any()


def test_a_hand_below_or_beside_the_view_hides_nothing() -> None:
    above = replace(NEAR, starts_at_in_base_m=(0.75, -0.02, 1.2), moves=())
    assert not acted(with_faults(scenario(above, duration_s=0.05), CameraHidden())).any()


# a joint


@pytest.mark.parametrize("joint", list(Joint)[:6])
def test_a_stuck_joint_stands_still_and_the_others_do_not(joint: Joint) -> None:
    what = scenario(duration_s=1.0, tilt=(0.05, 0.08, 0.1))
    trace = with_faults(what, JointStuck(joint=joint, from_s=0.4, until_s=0.6))
    number = list(Joint).index(joint)
    # one tick for the motor to stop it
    rates = np.abs(trace.ticks["joint_velocity_radps"][round(0.4 / PERIOD_S) + 2 : round(0.6 / PERIOD_S)])
    assert rates[:, number].max() < 1e-5
    others = np.delete(rates, number, axis=1)
    assert others.max() > 1e-3
    demanded = trace.ticks["demanded_joint_velocity_radps"][round(0.5 / PERIOD_S), number]
    assert abs(demanded) > 1e-4  # the controller does not know
    assert np.array_equal(np.flatnonzero(acted(trace)), np.arange(50, 75))


def test_a_stuck_joint_is_held_behind_the_drives() -> None:
    """The drive goes on as told, so that the joint takes up its speed when it comes free."""
    assert "setpoint_radps" in (drive_dtype(6).names or ())
    trace = with_faults(scenario(duration_s=1.0), JointStuck(joint=Joint.ELBOW, from_s=0.4, until_s=0.6))
    after = trace.ticks["joint_velocity_radps"][round(0.6 / PERIOD_S) + 2, 2]
    assert after == pytest.approx(trace.ticks["demanded_joint_velocity_radps"][77, 2], rel=0.05)


# the avoider


def test_a_late_answer_counts_so_much_later_and_the_arm_goes_on_meanwhile() -> None:
    what = scenario(VISIT, duration_s=2.0)
    healthy, late = without(what, "visit"), with_faults(what, AvoiderLate(delay_s=0.08))
    asked = int(healthy.decisions["tick"][0])
    assert late.decisions["tick"][0] == asked + 10
    assert (late.ticks["mode"][asked : asked + 10] == Mode.SERVOING).all()
    assert late.ticks["mode"][asked + 10] == Mode.REPULSING
    assert acted(late)[asked : asked + 11].all()
    assert late.decisions["outcome"][0] == DecisionOutcome.PROPOSED
    assert late.decisions["proposed_failed"][0] == Check.NONE
    assert late.decisions["trigger"][0] == healthy.decisions["trigger"][0]
    # the answer is to the question of then, of the same seed
    assert np.array_equal(
        late.decisions["proposed_position_in_base_m"][0], healthy.decisions["proposed_position_in_base_m"][0]
    )
    assert not np.array_equal(
        late.decisions["tcp_position_in_base_m"][0], healthy.decisions["tcp_position_in_base_m"][0]
    )


@pytest.mark.parametrize("fault", [AvoiderSilent(), AvoiderLate(delay_s=0.101), AvoiderLate(delay_s=5.0)])
def test_beyond_the_deadline_there_is_no_answer_and_the_deadline_has_passed(fault: Fault) -> None:
    what = scenario(VISIT, duration_s=2.0)
    healthy, silent = without(what, "visit"), with_faults(what, fault)
    decision = silent.decisions[0]
    assert decision["tick"] == healthy.decisions["tick"][0] + 13  # 100 ms, at the next tick
    assert decision["proposed_failed"] == Check.LATE
    assert decision["outcome"] == DecisionOutcome.OPPOSITE
    assert decision["fault"] == "no answer within 100 ms"


def test_an_answer_at_the_deadline_is_in_time() -> None:
    what = scenario(VISIT, duration_s=2.0)
    assert with_faults(what, AvoiderLate(delay_s=0.1)).decisions["outcome"][0] == DecisionOutcome.PROPOSED


def test_an_answer_counts_though_the_hand_has_left_meanwhile() -> None:
    settings = replace(DEFAULTS, avoidance=replace(DEFAULTS.avoidance, decision_deadline_s=2.0))
    what = scenario(VISIT, duration_s=3.5, settings=settings)
    trace = with_faults(what, AvoiderLate(delay_s=1.6))
    decision = trace.decisions[0]
    gone_m = trace.ticks["predicted_distance_m"][decision["tick"]]
    assert gone_m > DEFAULTS.avoidance.critical_distance_m
    assert decision["outcome"] == DecisionOutcome.PROPOSED
    assert trace.ticks["mode"][decision["tick"]] == Mode.REPULSING


def test_an_answer_of_nan_is_a_fault_at_once_with_the_opposite_pose_in_its_place() -> None:
    what = scenario(VISIT, duration_s=2.0)
    healthy, trace = without(what, "visit"), with_faults(what, AvoiderNaN())
    decision = trace.decisions[0]
    assert decision["tick"] == healthy.decisions["tick"][0]
    assert decision["proposed_failed"] == Check.NOT_FINITE
    assert decision["outcome"] == DecisionOutcome.OPPOSITE
    assert np.isnan(decision["proposed_position_in_base_m"]).all()
    assert "not finite" in decision["fault"]
    assert np.array_equal(acted(trace), trace.ticks["decision"] >= 0)


def test_a_question_that_is_asked_before_the_fault_is_answered_at_once() -> None:
    what = scenario(VISIT, duration_s=2.0)
    healthy = without(what, "visit")
    begin = float(healthy.decisions["time_s"][0]) + PERIOD_S
    late = with_faults(what, AvoiderSilent(from_s=begin))
    assert late.decisions["tick"][0] == healthy.decisions["tick"][0]


def test_the_table_has_a_record_for_each_fault_in_its_order() -> None:
    table = fault_table(FAULTS)
    assert table["kind"].tolist() == [int(fault.phrase.kind) for fault in FAULTS]
    assert np.isinf(table["end_s"]).all()
    assert fault_table((CameraBlind(from_s=1.0, for_s=0.5),))["end_s"][0] == 1.5
