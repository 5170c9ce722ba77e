from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pytest
from examples import hand, scenario

from safety_harness.admission.poses import start_joint_position
from safety_harness.base.exceptions import SettingsError
from safety_harness.base.geometry.transforms import inverse_transform
from safety_harness.base.settings import DEFAULTS, HandSensorKind, ImageSource, ObjectKind, Settings
from safety_harness.cell.controller.records import observation_dtype, overhead_transform_sensor_to_base
from safety_harness.cell.perception.camera import transform_camera_to_tcp
from safety_harness.cell.perception.hand_boxes import sensor_principal_point_px
from safety_harness.cell.perception.moments import MOMENT_COUNT
from safety_harness.cell.robot.capsules import load_capsules
from safety_harness.cell.robot.distance import place_capsules
from safety_harness.cell.robot.kinematics import TCP
from safety_harness.cell.robot.robots import arm_model
from safety_harness.cell.simulation.cameras import RING, object_polygon_in_base, sensors
from safety_harness.cell.simulation.exact_views import exact_boxes, exact_object
from safety_harness.cell.simulation.hand_programs import hands_at_start
from safety_harness.cell.simulation.records import clock_dtype
from safety_harness.cell.simulation.steps import (
    hand_frame_due,
    hand_over,
    object_frame_due,
    send_hand_frame,
    send_object_frame,
)
from safety_harness.cell.simulation.truth import cell_capsules
from safety_harness.scenario.fault_table import fault_table
from safety_harness.scenario.robots import Robot
from safety_harness.trace.records import TICK, as_compiled
from tests.cell.robot.arms import transforms_of

PERIOD_S = DEFAULTS.clock.control_period_s
CENTRE_DEPTH_M = 1.2
BOXES = 4  # of a frame of two hands


def with_sensor(**changes: object) -> Settings:
    return replace(DEFAULTS, hand_sensor=replace(DEFAULTS.hand_sensor, **changes))


def with_camera(**changes: object) -> Settings:
    return replace(DEFAULTS, camera=replace(DEFAULTS.camera, **changes))


@dataclass
class Delivery:
    """One frame as it arrived."""

    tick: int
    time_s: float
    captured_s: float
    boxes: np.ndarray


NO_FAULTS = fault_table(())


def clock_at(tick: int) -> np.ndarray:
    clock = np.zeros(1, clock_dtype(6))
    clock["tick"], clock["control_period_s"] = tick, PERIOD_S
    return clock


def watch(settings: Settings, ticks: int, *, seed: int = 1, count: int = 1) -> list[Delivery]:
    """Show ``count`` boxes, whose u is the time of the tick, for ``ticks`` ticks; what arrives?"""
    cameras = sensors(settings, seed, ticks, overhead_transform_sensor_to_base(settings))
    observation, truth = np.zeros(1, observation_dtype(2)), as_compiled(np.zeros(1, TICK))
    boxes = np.zeros((BOXES, 5))
    arrived = []
    for tick in range(ticks):
        time_s, clock = tick * PERIOD_S, clock_at(tick)
        if hand_frame_due(clock, cameras.state):
            boxes[:] = (time_s, 100.0, CENTRE_DEPTH_M, 3000.0, 1.0)
            boxes[:, 1] += 10.0 * np.arange(BOXES)
            send_hand_frame(
                truth,
                clock,
                NO_FAULTS,
                cameras.state,
                cameras.hand_frames,
                cameras.normals,
                cameras.uniforms,
                boxes,
                count,
            )
        hand_over(truth, clock, observation, *cameras[:3])
        o = observation[0]
        assert o["time_s"] == time_s
        if o["boxes_new"]:
            arrived.append(
                Delivery(tick, time_s, float(o["boxes_time_s"]), o["boxes"][: o["box_count"]].copy())
            )
    return arrived


def test_without_a_rate_every_tick_has_its_frame_at_once() -> None:
    arrived = watch(DEFAULTS, 50)
    assert [delivery.tick for delivery in arrived] == list(range(50))
    assert all(delivery.captured_s == delivery.time_s for delivery in arrived)


@pytest.mark.parametrize("rate_hz", [15.0, 25.0, 30.0, 60.0, 125.0])
def test_frames_are_taken_at_the_first_tick_at_or_after_their_time(rate_hz: float) -> None:
    arrived = watch(with_sensor(rate_hz=rate_hz), 1000)
    due_s = np.arange(int(1000 * PERIOD_S * rate_hz) + 1) / rate_hz
    expected = np.ceil(due_s / PERIOD_S - 1e-6)
    expected = expected[expected < 1000]
    assert [delivery.tick for delivery in arrived] == expected.tolist()


@pytest.mark.parametrize("latency_s", [0.0, 0.008, 0.033, 0.1, 0.4])
def test_a_30_hz_sensor_delivers_late_by_its_latency_what_was_then(latency_s: float) -> None:
    arrived = watch(with_sensor(rate_hz=30.0, latency_s=latency_s), 400)
    assert len(arrived) == pytest.approx((400 * PERIOD_S - latency_s) * 30.0, abs=1.0)
    for delivery in arrived:
        late_s = delivery.time_s - delivery.captured_s
        assert latency_s - 1e-9 <= late_s < latency_s + PERIOD_S - 1e-9
        assert delivery.boxes[0, 0] == delivery.captured_s  # the scene of the capture, not of the arrival
    captured = [delivery.captured_s for delivery in arrived]
    assert all(first < second for first, second in pairwise(captured))
    assert np.diff(captured).min() > 1.0 / 30.0 - PERIOD_S


def test_the_object_camera_has_a_clock_of_its_own() -> None:
    settings = replace(with_camera(rate_hz=30.0, latency_s=0.033), hand_sensor=with_sensor().hand_sensor)
    cameras = sensors(settings, 1, 100, overhead_transform_sensor_to_base(settings))
    observation, truth = np.zeros(1, observation_dtype(2)), as_compiled(np.zeros(1, TICK))
    hands = hands_at_start(scenario()).state
    arrived = []
    for tick in range(100):
        clock = clock_at(tick)
        if object_frame_due(clock, cameras.state):
            send_object_frame(
                truth,
                hands,
                clock,
                NO_FAULTS,
                cameras.state,
                cameras.object_frames,
                cameras.polygon_in_base_m,
                tick % 2 == 0,
                np.full(MOMENT_COUNT, tick * PERIOD_S),
            )
        hand_over(truth, clock, observation, *cameras[:3])
        if observation[0]["image_new"]:
            arrived.append((tick, observation[0]["moments"][0], bool(observation[0]["object_visible"])))
    taken = [round(moment / PERIOD_S) for _, moment, _ in arrived]
    assert taken[:4] == [0, 5, 9, 13]  # 0, 33.3, 66.7 and 100 ms at ticks of 8 ms
    assert [tick - then for (tick, _, _), then in zip(arrived, taken, strict=True)] == [5] * len(taken)
    assert [visible for _, _, visible in arrived] == [then % 2 == 0 for then in taken]


@pytest.mark.parametrize("field", ["camera", "hand_sensor"])
def test_more_frames_under_way_than_there_is_room_for_are_refused(field: str) -> None:
    longest = replace(DEFAULTS, **{field: replace(getattr(DEFAULTS, field), latency_s=(RING - 2) * PERIOD_S)})
    sensors(longest, 1, 10, np.eye(4))
    too_long = replace(
        DEFAULTS, **{field: replace(getattr(DEFAULTS, field), latency_s=(RING - 1) * PERIOD_S)}
    )
    with pytest.raises(SettingsError, match="latency"):
        sensors(too_long, 1, 10, np.eye(4))


def test_at_the_longest_latency_no_frame_is_lost() -> None:
    arrived = watch(with_sensor(latency_s=(RING - 2) * PERIOD_S), 300)
    assert [round(delivery.captured_s / PERIOD_S) for delivery in arrived] == list(range(300 - RING + 2))
    assert all(delivery.boxes[0, 0] == delivery.captured_s for delivery in arrived)


def test_boxes_drop_out_as_often_as_they_should() -> None:
    probability, ticks = 0.3, 2000
    arrived = watch(with_sensor(dropout_probability=probability), ticks, count=BOXES)
    kept = sum(len(delivery.boxes) for delivery in arrived)
    expected = (1.0 - probability) * ticks * BOXES
    assert kept == pytest.approx(expected, abs=4.5 * np.sqrt(probability * expected))
    together = [len(delivery.boxes) for delivery in arrived].count(0)
    assert together == pytest.approx(ticks * probability**4, abs=4.5 * np.sqrt(ticks * probability**4))


def test_a_box_that_drops_out_leaves_the_others_as_they_are() -> None:
    for delivery in watch(with_sensor(dropout_probability=0.5), 100, count=BOXES):
        assert set(delivery.boxes[:, 1]) <= {100.0, 110.0, 120.0, 130.0}
        assert list(delivery.boxes[:, 1]) == sorted(delivery.boxes[:, 1])


def errors(settings: Settings, ticks: int = 4000, seed: int = 1) -> np.ndarray:
    """(ticks, 5) of the first box: what came less what was."""
    arrived = watch(settings, ticks, seed=seed)
    true = np.array([(d.captured_s, 100.0, CENTRE_DEPTH_M, 3000.0, 1.0) for d in arrived])
    return np.array([d.boxes[0] for d in arrived]) - true


def test_the_noise_has_its_sigma_no_mean_and_no_memory() -> None:
    error = errors(with_sensor(pixel_noise_px=1.5, depth_noise_per_m=0.0025))
    sigma = np.array([1.5, 1.5, 0.0025 * CENTRE_DEPTH_M**2])  # grows with the square of the depth
    n = len(error)
    assert error[:, :3].std(axis=0) == pytest.approx(sigma, rel=4.5 / np.sqrt(2 * n))
    assert np.abs(error[:, :3].mean(axis=0) / sigma).max() < 4.5 / np.sqrt(n)
    assert not error[:, 3:].any()
    correlation = np.corrcoef(np.concatenate([error[1:, :3].T, error[:-1, :3].T]))
    assert np.abs(correlation - np.eye(6)).max() < 4.5 / np.sqrt(n)


def test_one_seed_is_one_noise() -> None:
    noisy = with_sensor(pixel_noise_px=1.0, depth_noise_per_m=0.001)
    assert np.array_equal(errors(noisy, 50), errors(noisy, 50))
    assert not (errors(noisy, 50)[:, :3] == errors(noisy, 50, seed=2)[:, :3]).any()


def test_a_longer_run_begins_like_the_shorter_one() -> None:
    noisy = with_sensor(pixel_noise_px=1.0, depth_noise_per_m=0.001, dropout_probability=0.3)
    short, long = (watch(noisy, ticks, count=BOXES) for ticks in (60, 90))
    for a, b in zip(short, long, strict=False):
        assert np.array_equal(a.boxes, b.boxes)


def test_a_perfect_sensor_adds_nothing() -> None:
    assert not errors(DEFAULTS, 50).any()


# What the sensors see --------------------------------------------------------------------------------


def seen(
    kind: HandSensorKind,
    *hands: tuple[float, float, float] | np.ndarray,
    offset: tuple[float, float, float] = (0, 0, 0),
) -> np.ndarray:
    """(k, 5) boxes of the hands, the arm standing at an offset from the desired pose."""
    settings = with_sensor(kind=kind)
    arm = arm_model(Robot.UR10)
    transforms = transforms_of(arm, start_joint_position(scenario(offset=offset), arm))
    capsules = cell_capsules(load_capsules(arm.name), settings)
    placed = np.empty((len(capsules.names), 2, 3))
    place_capsules(capsules.records, transforms, placed)
    state = hands_at_start(
        scenario(*(hand(at=tuple(position)) for position in hands), settings=settings)
    ).state
    cameras = sensors(settings, 1, 0, overhead_transform_sensor_to_base(settings))
    boxes = np.zeros((BOXES, 5))
    count = exact_boxes(cameras.state, state, transforms[TCP], capsules.records, placed, boxes)
    return boxes[:count]


OVERHEAD = DEFAULTS.hand_sensor.overhead_position_in_base_m
BESIDE = (OVERHEAD[0], OVERHEAD[1], 0.1)  # right below the overhead camera, beside the arm
UNDER_THE_WRIST = (0.70, 0.02, 0.05)  # 300 mm below the flange
FAR = (1.6, -1.2, 0.1)  # outside the overhead camera's image


def test_the_overhead_camera_sees_a_hand_beside_the_arm_where_it_is() -> None:
    ((u_px, v_px, z_m, area_px2, aspect),) = seen(HandSensorKind.OVERHEAD, BESIDE)
    assert (u_px, v_px) == pytest.approx(sensor_principal_point_px(DEFAULTS.hand_sensor), abs=1e-6)
    height_m = OVERHEAD[2] - BESIDE[2]
    assert z_m == pytest.approx(height_m - DEFAULTS.hand.radius_m)
    assert np.sqrt(area_px2) == pytest.approx(2 * 615 * DEFAULTS.hand.radius_m / height_m, rel=0.01)
    assert aspect == pytest.approx(1.0)


def test_a_hand_under_the_arm_is_hidden_from_above_but_not_from_the_ideal_sensor() -> None:
    assert len(seen(HandSensorKind.OVERHEAD, UNDER_THE_WRIST)) == 0
    assert len(seen(HandSensorKind.IDEAL, UNDER_THE_WRIST)) == 1
    both = seen(HandSensorKind.OVERHEAD, UNDER_THE_WRIST, BESIDE)
    assert np.array_equal(both, seen(HandSensorKind.OVERHEAD, BESIDE))


def test_it_is_the_arm_that_hides_the_hand() -> None:
    assert len(seen(HandSensorKind.OVERHEAD, UNDER_THE_WRIST, offset=(0.0, 0.45, 0.0))) == 1


def test_a_hand_outside_the_image_is_seen_by_the_ideal_sensor_only() -> None:
    assert len(seen(HandSensorKind.OVERHEAD, FAR)) == 0
    assert len(seen(HandSensorKind.IDEAL, FAR)) == 1


def test_where_the_overhead_camera_sees_it_agrees_with_the_ideal_one() -> None:
    assert seen(HandSensorKind.OVERHEAD, BESIDE) == pytest.approx(seen(HandSensorKind.IDEAL, BESIDE))


def test_no_sensor_sees_behind_itself() -> None:
    above = (*BESIDE[:2], OVERHEAD[2] + 0.2)
    for kind in (HandSensorKind.OVERHEAD, HandSensorKind.IDEAL):
        assert len(seen(kind, above)) == 0


@pytest.mark.parametrize(
    ("sideways_m", "visible"),
    [((0.0, 0.0), True), ((0.0, -0.15), True), ((0.0, -0.35), False), ((0.25, 0.0), False)],
)
def test_the_hand_eye_camera_sees_only_what_is_in_front_of_its_lens(
    sideways_m: tuple[float, float], visible: bool
) -> None:
    """At 0.45 m its field is 468 mm along y and 351 mm along x."""
    desired = np.array(DEFAULTS.cell.desired_tcp_position_in_base_m)
    at = np.add(desired, (sideways_m[0], sideways_m[1] + 0.045, -0.45))
    boxes = seen(HandSensorKind.EYE_IN_HAND, at)
    assert len(boxes) == visible
    if visible:
        camera_to_base = np.eye(4)
        camera_to_base[:3, :3], camera_to_base[:3, 3] = np.diag([1.0, -1.0, -1.0]), desired
        camera_to_base = camera_to_base @ transform_camera_to_tcp(DEFAULTS.camera, calibrated=False)
        x, y, z = (inverse_transform(camera_to_base) @ (*at, 1.0))[:3]
        c_u, c_v = sensor_principal_point_px(DEFAULTS.hand_sensor)
        assert boxes[0, :2] == pytest.approx((615 * x / z + c_u, 615 * y / z + c_v), abs=4.0)
        assert boxes[0, 2] == pytest.approx(z - DEFAULTS.hand.radius_m, abs=6e-3)


def test_a_hand_above_the_flange_is_invisible_to_the_hand_eye_camera() -> None:
    assert len(seen(HandSensorKind.EYE_IN_HAND, (0.7, -0.2, 0.5))) == 0


def object_at(offset: tuple[float, float, float], settings: Settings = DEFAULTS) -> tuple[bool, np.ndarray]:
    pose = np.eye(4)
    pose[:3, :3] = np.diag([1.0, -1.0, -1.0])
    pose[:3, 3] = np.array(DEFAULTS.cell.desired_tcp_position_in_base_m) + offset
    cameras = sensors(settings, 1, 0, overhead_transform_sensor_to_base(settings))
    moments = np.full(MOMENT_COUNT, np.nan)
    return exact_object(cameras.state, cameras.polygon_in_base_m, pose, moments), moments


def test_the_object_lies_on_its_plane_turned_by_its_yaw() -> None:
    polygon = object_polygon_in_base(DEFAULTS)
    assert polygon[:, 2] == pytest.approx(DEFAULTS.cell.table_height_m)
    flat = np.array(DEFAULTS.object.polygon_m)
    relative = (polygon - DEFAULTS.object.position_in_base_m)[:, :2]
    angle = np.arctan2(relative[:, 1], relative[:, 0]) - np.arctan2(flat[:, 1], flat[:, 0])
    assert np.mod(angle, 2 * np.pi) == pytest.approx(np.full(len(flat), DEFAULTS.object.yaw_rad))
    assert np.linalg.norm(relative, axis=1) == pytest.approx(np.linalg.norm(flat, axis=1))


@pytest.mark.parametrize("source", [ImageSource.EXACT, ImageSource.RASTER])
def test_an_object_that_is_not_wholly_in_the_image_is_not_seen(source: ImageSource) -> None:
    settings = with_camera(source=source)
    assert object_at((0.0, 0.0, 0.0), settings)[0]
    assert not object_at((0.0, 0.30, 0.0), settings)[0]  # cut by the border
    assert not object_at((0.0, 0.80, 0.0), settings)[0]
    assert not object_at((0.0, 0.0, -0.7), settings)[0]  # below the table


def test_a_set_of_points_has_the_moments_of_points() -> None:
    settings = replace(DEFAULTS, servo=replace(DEFAULTS.servo, object_kind=ObjectKind.DISCRETE))
    visible, moments = object_at((0.0, 0.0, 0.0), settings)
    assert visible
    assert moments[0] == len(DEFAULTS.object.polygon_m)  # m00 counts the points
