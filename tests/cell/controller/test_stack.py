"""What the controller demands of the arm: gains, limits, straight ways, and what it believes wrongly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bench import AWAY, Bench, with_avoidance, with_motion
from examples import VISIT, hand, run, scenario

from safety_harness.base.geometry.rotations import vector_from_rotation
from safety_harness.base.settings import DEFAULTS, HandSensorKind, Settings, Vector3
from safety_harness.cell.robot.kinematics import geometric_jacobian
from safety_harness.cell.robot.robots import arm_model
from safety_harness.scenario.moves import FollowTcp, MoveTo, Wait, Withdraw
from safety_harness.scenario.robots import Robot
from safety_harness.trace.records import Limit, Mode
from safety_harness.trace.trace import Trace
from tests.cell.robot.arms import transforms_of

PERIOD_S = DEFAULTS.clock.control_period_s
MOTION = DEFAULTS.motion
DESIRED = np.array(DEFAULTS.cell.desired_tcp_position_in_base_m)


def jacobian_at(joints: np.ndarray) -> np.ndarray:
    jacobian = np.empty((6, 6))
    geometric_jacobian(
        arm_model(Robot.UR10).joint_axes,
        transforms_of(arm_model(Robot.UR10), joints),
        jacobian,
    )
    return jacobian


def demanded_twists(trace: Trace) -> np.ndarray:
    """(n, 6) what the demanded joint velocities mean at the TCP."""
    ticks = trace.ticks
    rows = zip(ticks["joint_position_rad"], ticks["demanded_joint_velocity_radps"], strict=True)
    return np.array([jacobian_at(joints) @ rates for joints, rates in rows])


def positions(trace: Trace) -> np.ndarray:
    """(n, 3) of the TCP."""
    result: np.ndarray = trace.ticks["transform_tcp_to_base"][:, :3, 3]
    return result


def off_the_line(path: np.ndarray, end: np.ndarray) -> float:
    """Largest distance [m] of a path from the straight line between its beginning and ``end``."""
    along = (end - path[0]) / np.linalg.norm(end - path[0])
    away = path - path[0]
    return float(np.linalg.norm(away - np.outer(away @ along, along), axis=1).max())


def repulsions(trace: Trace) -> list[tuple[np.ndarray, np.ndarray]]:
    """Of each decision the ticks of its way, and where it leads."""
    ends = [*trace.decisions["tick"][1:], len(trace.ticks)]
    found = []
    for decision, end in zip(trace.decisions, ends, strict=True):
        ticks = trace.ticks[decision["tick"] : end]
        found.append((ticks[ticks["mode"] == Mode.REPULSING], decision["chosen_position_in_base_m"]))
    return found


@pytest.fixture(scope="module")
def random_runs() -> list[Trace]:
    """Hands that come from anywhere, starts that are shifted and tilted."""
    rng = np.random.default_rng(11)
    runs = []
    for k in range(6):
        goal = tuple(DESIRED + rng.uniform(-0.25, 0.25, 3))
        moves = (
            MoveTo(position_in_base_m=goal, speed_mps=float(rng.uniform(0.5, 2.0))),
            Wait(duration_s=0.3),
            Withdraw(speed_mps=1.0) if k % 2 else FollowTcp(speed_mps=1.0, distance_m=0.1, duration_s=1.0),
        )
        offset, tilt = rng.uniform(-0.05, 0.05, 3) * (1.0, 2.0, 1.0), rng.uniform(-0.08, 0.08, 3)
        runs.append(run(scenario(hand(*moves), duration_s=2.5, offset=tuple(offset), tilt=tuple(tilt))))
    return runs


@pytest.mark.parametrize(
    ("distance_m", "gain"), [(0.0700, DEFAULTS.servo.gain_near), (0.0715, DEFAULTS.servo.gain_far)]
)
def test_the_gain_switches_at_the_threshold_of_the_squared_error(distance_m: float, gain: float) -> None:
    """sse = 0.005 is 70.7 mm when the camera looks straight down."""
    row = Bench(offset=tuple(distance_m * np.array([0.6, -0.8, 0.0]))).tick()
    assert row["sse"] == pytest.approx(distance_m**2, rel=1e-6)
    assert row["gain"] == gain


def test_the_gain_is_the_near_one_exactly_where_the_error_is_small(visit: Trace) -> None:
    servoing = visit.ticks[visit.ticks["mode"] == Mode.SERVOING]
    near = servoing["sse"] < DEFAULTS.servo.gain_switch_sse
    assert 0 < near.sum() < len(near)
    assert np.array_equal(servoing["gain"], np.where(near, DEFAULTS.servo.gain_near, DEFAULTS.servo.gain_far))
    assert not visit.ticks["gain"][visit.ticks["mode"] != Mode.SERVOING].any()


def test_speed_and_acceleration_never_exceed_their_limits(random_runs: list[Trace]) -> None:
    for trace in random_runs:
        assert not np.isin(trace.ticks["mode"], [Mode.PROTECTIVE_STOP]).any()
        assert len(trace.decisions) > 0
        twists = np.concatenate([np.zeros((1, 6)), demanded_twists(trace)])
        for half, speed, acceleration in (
            (slice(0, 3), MOTION.max_tcp_speed_mps, MOTION.max_tcp_acceleration_mps2),
            (slice(3, 6), MOTION.max_tcp_angular_speed_radps, MOTION.max_tcp_angular_acceleration_radps2),
        ):
            assert np.linalg.norm(twists[:, half], axis=1).max() <= speed + 1e-9
            steps = np.linalg.norm(np.diff(twists[:, half], axis=0), axis=1)
            assert steps.max() <= acceleration * PERIOD_S + 1e-9
        assert trace.ticks["tcp_speed_mps"].max() <= MOTION.max_tcp_speed_mps  # in truth, too


def test_the_limits_are_used_up_and_not_merely_kept(random_runs: list[Trace]) -> None:
    for trace in random_runs:
        speeds = np.linalg.norm(demanded_twists(trace)[:, :3], axis=1)
        assert speeds.max() >= 0.98 * MOTION.max_tcp_speed_mps


def test_the_orientation_is_kept_while_giving_way(visit: Trace) -> None:
    for ticks, _ in repulsions(visit):
        rotations = ticks["transform_tcp_to_base"][:, :3, :3]
        turned = [np.linalg.norm(vector_from_rotation(rotation @ rotations[0].T)) for rotation in rotations]
        assert max(turned) < np.radians(1e-5)


def test_a_turn_under_way_is_braked_within_its_acceleration(random_runs: list[Trace]) -> None:
    """From w the TCP turns on by no more than w^2 / 2a (and a tick), then no further."""
    for trace in random_runs:
        twists = demanded_twists(trace)
        for ticks, _ in repulsions(trace):
            first = round(float(ticks["time_s"][0]) / PERIOD_S)
            before = np.linalg.norm(twists[first - 1, 3:])
            rotations = ticks["transform_tcp_to_base"][:, :3, :3]
            turned = max(np.linalg.norm(vector_from_rotation(r @ rotations[0].T)) for r in rotations)
            bound = before**2 / (2.0 * MOTION.max_tcp_angular_acceleration_radps2) + before * PERIOD_S
            assert turned <= bound + 5e-5


def test_the_way_to_the_repulsive_position_is_straight(random_runs: list[Trace], visit: Trace) -> None:
    """Within 5 mm when the servo's velocity has to be turned first (up to 0.05 m/s), 0.1 mm from rest."""
    for trace in (*random_runs, visit):
        for ticks, target in repulsions(trace):
            assert off_the_line(ticks["transform_tcp_to_base"][:, :3, 3], target) < 5e-3
    from_rest = run(scenario(VISIT, duration_s=2.5, offset=(0.0, 0.0, 0.0)))
    ((ticks, target),) = repulsions(from_rest)
    path = ticks["transform_tcp_to_base"][:, :3, 3]
    assert off_the_line(path, target) < 1e-4
    assert np.linalg.norm(np.diff(path, axis=0), axis=1).sum() == pytest.approx(0.1, abs=2e-3)


def test_the_way_ends_at_the_repulsive_position_without_overshoot(visit: Trace) -> None:
    for ticks, target in repulsions(visit):
        gap = np.linalg.norm(ticks["transform_tcp_to_base"][:, :3, 3] - target, axis=1)
        assert gap[-1] < 2e-3
        assert (np.diff(gap[3:]) < 0.0).all()


def test_a_slower_repulsion_is_slower() -> None:
    settings = with_avoidance(repulsion_speed_mps=0.1, repulsion_acceleration_mps2=0.4)
    trace = run(scenario(VISIT, duration_s=2.5, settings=settings))
    moving = trace.ticks["mode"] == Mode.REPULSING
    assert moving.any()
    speeds = np.linalg.norm(demanded_twists(trace)[:, :3], axis=1)[moving]
    assert 0.098 <= speeds.max() <= 0.1
    assert np.abs(np.diff(speeds)).max() <= 0.4 * PERIOD_S + 1e-9


def flags(trace: Trace, limit: Limit) -> np.ndarray:
    return (trace.ticks["limits"] & limit) > 0


def test_a_limit_is_recorded_exactly_when_it_acts() -> None:
    fast = replace(DEFAULTS, servo=replace(DEFAULTS.servo, gain_far=4.0, gain_near=4.0))
    trace = run(scenario(duration_s=2.5, settings=fast))
    wanted = np.linalg.norm(trace.ticks["camera_twist"][:, :3], axis=1)  # upright: the TCP's own
    assert np.array_equal(flags(trace, Limit.TCP_SPEED), wanted > 0.99 * MOTION.max_tcp_speed_mps)
    assert flags(trace, Limit.TCP_SPEED).any()
    assert flags(trace, Limit.TCP_ACCELERATION)[:20].all()  # from rest to 0.25 m/s takes 31 ticks
    speeds = np.linalg.norm(demanded_twists(trace)[:, :3], axis=1)
    steps = np.diff(speeds, prepend=0.0)
    full = MOTION.max_tcp_acceleration_mps2 * PERIOD_S
    assert steps[flags(trace, Limit.TCP_ACCELERATION)][:20] == pytest.approx(full, rel=1e-6)
    slow = run(scenario(duration_s=1.0, offset=(0.01, 0.0, 0.0)))
    assert not slow.ticks["limits"].any()


def test_the_joint_speed_limit_slows_all_joints_alike() -> None:
    arm = replace(arm_model(Robot.UR10), velocity_limit_radps=np.full(6, 0.02))
    free, bound = Bench(), Bench(arm=arm)
    for bench in (free, bound):
        row = bench.tick(bench.beside(0.3), count=20)
    assert Limit.JOINT_SPEED in Limit(int(row["limits"]))
    slow, fast = row["demanded_joint_velocity_radps"], free.command["joint_velocity_radps"][0]
    assert np.abs(slow).max() == pytest.approx(0.02)
    assert np.abs(fast).max() > 0.02
    jacobian = jacobian_at(bound.joints)
    direction = [twist[:3] / np.linalg.norm(twist[:3]) for twist in (jacobian @ slow, jacobian @ fast)]
    assert direction[0] == pytest.approx(direction[1], abs=1e-9)


def test_the_singularity_limit_is_recorded() -> None:
    bench = Bench(settings=with_motion(min_singular_value=0.02))
    bench.joints[4] = 0.0
    row = bench.tick(AWAY)
    assert Limit(int(row["limits"])) & Limit.SINGULARITY
    assert Mode(int(row["mode"])) is Mode.PROTECTIVE_STOP


def calibrated(rotation_rad: Vector3 = (0.0, 0.0, 0.0), offset_m: Vector3 = (0.0, 0.0, 0.0)) -> Settings:
    camera = replace(
        DEFAULTS.camera, calibration_error_rotation_rad=rotation_rad, calibration_error_offset_m=offset_m
    )
    return replace(DEFAULTS, camera=camera)


def test_a_wrong_hand_eye_calibration_bends_the_way_of_the_servo() -> None:
    """A camera believed turned by 0.15 rad about its axis: 7 mm off the line instead of 20 um."""
    true, wrong = (
        run(scenario(duration_s=8.0, settings=settings))
        for settings in (DEFAULTS, calibrated(rotation_rad=(0.0, 0.0, 0.15)))
    )
    assert off_the_line(positions(true), DESIRED) < 5e-5
    assert off_the_line(positions(wrong), DESIRED) > 5e-3
    assert np.linalg.norm(positions(wrong)[-1] - DESIRED) < 0.05  # it gets there all the same


def test_the_servo_makes_the_error_fall_as_its_closed_form() -> None:
    """|e(t)| = |e(0)| exp(-lambda t) but for the first ramp: the rate of fall is the gain."""
    trace = run(scenario(duration_s=3.0))
    error = np.sqrt(trace.ticks["sse"])
    rate = -np.diff(np.log(error[50:])) / PERIOD_S
    gain = trace.ticks["gain"][50:-1]
    settled = gain == DEFAULTS.servo.gain_far
    assert settled.sum() > 50
    assert rate[settled] == pytest.approx(DEFAULTS.servo.gain_far, rel=0.01)


@pytest.mark.parametrize("offset_m", [(0.0, 0.0, 0.0), (0.02, 0.0, 0.0), (0.0, -0.01, 0.015)])
def test_a_wrong_calibration_displaces_what_the_hand_eye_camera_sees(offset_m: Vector3) -> None:
    settings = calibrated(offset_m=offset_m)
    sensor = replace(DEFAULTS.hand_sensor, kind=HandSensorKind.EYE_IN_HAND)
    bench = Bench(settings=replace(settings, hand_sensor=sensor))
    seen = np.add(bench.tcp, (0.03, 0.02, -0.45))
    row = bench.tick(seen)
    assert row["track_valid"][0]
    displaced = row["predicted_hand_in_base_m"][0] - seen
    assert displaced == pytest.approx(bench.pose[:3, :3] @ np.array(offset_m), abs=3e-3)


def test_the_nearest_of_several_hands_counts() -> None:
    bench = Bench()
    row = bench.tick(AWAY, bench.beside(0.5))
    assert row["track_valid"].sum() == 2
    assert row["predicted_distance_m"] == pytest.approx(0.5, abs=5e-3)
    assert np.isnan(row["predicted_hand_in_base_m"][~row["track_valid"]]).all()


def test_between_images_the_last_features_stand() -> None:
    bench = Bench()
    seen = bench.tick().copy()
    for _ in range(3):
        observation = bench.observation(())
        observation["image_new"] = False
        observation["moments"] = np.nan
        command = bench.controller.step(observation)
    assert bench.controller.records.state["sse"][0] == seen["sse"]
    assert np.abs(command["joint_velocity_radps"]).max() > 0.0


def test_after_a_stop_it_starts_from_what_the_arm_does_and_not_from_what_it_wanted() -> None:
    """While the drives rule, the acceleration limit is counted from the arm's true velocity."""
    bench = Bench()
    bench.tick(count=40)
    kept = bench.joints[4]
    bench.joints[4] = 0.0  # singular: a stop
    bench.tick(count=5)
    bench.joints[4] = kept
    rows = [bench.tick().copy() for _ in range(100)]
    modes = [Mode(int(row["mode"])) for row in rows]
    first = modes.index(Mode.SERVOING)
    assert set(modes[:first]) == {Mode.PROTECTIVE_STOP}
    twist = jacobian_at(bench.joints) @ rows[first]["demanded_joint_velocity_radps"]
    assert np.linalg.norm(twist[:3]) <= MOTION.max_tcp_acceleration_mps2 * PERIOD_S + 1e-12
