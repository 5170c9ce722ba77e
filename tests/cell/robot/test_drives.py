"""Drives of an own arm: dead time, lag, limited torque and payload, alike in both worlds."""

from __future__ import annotations

import hashlib
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from examples import VISIT, run, scenario

from safety_harness import admit, read_scenario, run_kinematic
from safety_harness.base.exceptions import InadmissibleError
from safety_harness.base.settings import DEFAULTS
from safety_harness.cell.controller.records import COMMAND
from safety_harness.cell.robot.capsules import capsule_file, hashes_of
from safety_harness.cell.robot.description import DATA, load_arm, urdf_file
from safety_harness.cell.robot.drive import DriveModel, drive, drive_tick
from safety_harness.cell.robot.dynamics import joint_torques
from safety_harness.cell.robot.kinematics import links_in_base
from safety_harness.cell.robot.robots import arm_model, drive_model
from safety_harness.cell.simulation.kinematic_world import KinematicWorld
from safety_harness.cell.simulation.pybullet_world import PyBulletWorld
from safety_harness.scenario.model import Claim, Verdict
from safety_harness.scenario.robots import AnyRobot, Drives, OwnRobot, Payload, Robot, Seat, StopTimes
from safety_harness.scenario.write import write_scenario
from safety_harness.trace.records import TICK

PERIOD_S = DEFAULTS.clock.control_period_s
START = np.array([0.2, -1.2, 1.6, -2.0, -1.5, 0.3])
SWEEP = np.array([0.8, -0.9, 0.7, 0.5, -0.6, 0.4])
STOP = StopTimes(reaction_time_s=0.1, stop_time_s=0.1)  # short of what the torques allow
HEAVY = Payload(mass_kg=6.0, centre_m=(0.0, 0.05, 0.1))


def capsules_of(urdf: bytes) -> bytes:
    """The UR10's, as fitted to a URDF of these contents."""
    _, meshes = hashes_of(load_arm("ur10"))
    fitted = {"base": "base_link", "tcp": "tool0", "meshes_sha256": meshes}
    fitted["urdf_sha256"] = hashlib.sha256(urdf).hexdigest()
    return json.dumps(json.loads(capsule_file("ur10").read_bytes()) | fitted).encode()


def files_in(folder: Path, urdf: bytes) -> tuple[Path, Path]:
    """A URDF beside the UR10's meshes, and its capsules."""
    (folder / "robots").symlink_to(DATA)
    files = folder / "arm.urdf", folder / "arm.json"
    files[0].write_bytes(urdf)
    files[1].write_bytes(capsules_of(urdf))
    return files


def own(drives: Drives | None, seat: Seat | None = None, folder: Path | None = None) -> OwnRobot:
    """The UR10 as an arm of the user's own; without a ``folder`` it has no meshes."""
    urdf = urdf_file("ur10").read_bytes()
    files = (urdf_file("ur10"), capsule_file("ur10")) if folder is None else files_in(folder, urdf)
    return OwnRobot(
        urdf=files[0].name,
        base="base_link",
        tcp="tool0",
        capsules=files[1].name,
        braking=STOP,
        seat=seat,
        drives=drives,
        urdf_sha256=hashlib.sha256(urdf).hexdigest(),
        files=files,
        urdf_text=urdf,
        capsules_text=capsules_of(urdf),
    )


def followed(model: DriveModel | None, demands: np.ndarray, stops: range = range(0)) -> np.ndarray:
    """The set points, one row a tick; a stop is asked for at the ticks ``stops``."""
    drives, rows = drive(DEFAULTS, demands.shape[1], model), []
    for k, demand in enumerate(demands):
        drive_tick(drives, demand, k in stops, 0.5, k * PERIOD_S)
        rows.append(drives["setpoint_radps"][0].copy())
    return np.array(rows)


def moved(
    robot: AnyRobot, demands: np.ndarray, stop_at: int | None = None, world: type = KinematicWorld
) -> np.ndarray:
    """(ticks + 1,) TICK of an arm that is told ``demands``, then from ``stop_at`` on to stop."""
    what = replace(scenario(), robot=robot)
    if isinstance(robot, OwnRobot):
        what = replace(what, settings=replace(DEFAULTS, braking=robot.braking.settings))
    ticks, command = np.zeros(len(demands) + 1, TICK), np.zeros(1, COMMAND)
    with world(what, arm_model(robot), START) as one:
        for k, demand in enumerate(demands):
            one.true_state(ticks[k : k + 1])
            command["joint_velocity_radps"] = demand
            command["protective_stop"] = stop_at is not None and k >= stop_at
            one.step(command)
        one.true_state(ticks[-1:])
    return ticks


def square(ticks: int, half: int = 30) -> np.ndarray:
    """A square wave of all joints: more than the torques can follow."""
    return np.array([SWEEP * (1.0 if k // half % 2 == 0 else -1.0) for k in range(ticks)])


def demands_at_random(ticks: int) -> np.ndarray:
    return np.random.default_rng(3).normal(0.0, 0.5, (ticks, 6))


@pytest.mark.parametrize(("dead_time_s", "ticks"), [(0.0, 0), (0.008, 1), (0.020, 3), (0.024, 3), (0.1, 13)])
def test_a_demand_acts_a_dead_time_later_in_whole_periods(dead_time_s: float, ticks: int) -> None:
    demands = demands_at_random(60)
    rows = followed(DriveModel(dead_time_s=dead_time_s), demands)
    assert not rows[:ticks].any()
    assert np.array_equal(rows[ticks:], demands[: 60 - ticks])


@pytest.mark.parametrize("lag_s", [0.003, 0.020, 0.4])
def test_a_step_is_approached_as_a_first_order_lag_does(lag_s: float) -> None:
    rows = followed(DriveModel(lag_s=lag_s), np.tile(SWEEP, (50, 1)))
    times_s = np.arange(1, 51) * PERIOD_S
    assert rows == pytest.approx(np.outer(1.0 - np.exp(-times_s / lag_s), SWEEP), abs=1e-12)


def test_what_was_on_its_way_does_not_outlive_a_stop() -> None:
    demands = np.tile(SWEEP, (130, 1))
    rows = followed(DriveModel(dead_time_s=0.04), demands, stops=range(10, 110))
    assert not rows[100:115].any()  # released at 110: five periods until it is obeyed
    assert np.array_equal(rows[115:], demands[115:])


@pytest.mark.parametrize("stop_at", [None, 40])
def test_without_the_key_an_own_arm_moves_as_the_shipped_one_bit_for_bit(stop_at: int | None) -> None:
    demands = demands_at_random(100)
    robots = Robot.UR10, replace(own(None), braking=SHIPPED), replace(own(Drives()), braking=SHIPPED)
    shipped, *others = (moved(robot, demands, stop_at) for robot in robots)
    for other in others:
        assert other.tobytes() == shipped.tobytes()


SHIPPED = StopTimes(  # as the settings' defaults
    reaction_time_s=DEFAULTS.braking.reaction_time_s,
    stop_time_s=DEFAULTS.braking.stop_time_base_s,
    stop_time_per_speed_s2pm=DEFAULTS.braking.stop_time_per_speed_s2pm,
)


def reached(ticks: np.ndarray) -> np.ndarray:
    """(ticks, n) velocities at the ticks, of drives that the motors are told the means of."""
    rates = [np.zeros(6)]
    for mean in ticks[1:]["joint_velocity_radps"]:
        rates.append(2.0 * mean - rates[-1])
    return np.array(rates)


def torques_of(robot: OwnRobot, ticks: np.ndarray) -> np.ndarray:
    """(ticks, n) [N m] that the motion of a run took, by the model's masses."""
    model, arm, rows = drive_model(robot), arm_model(robot), []
    assert model is not None
    rates = reached(ticks)
    for tick, before, after in zip(ticks[:-1], rates[:-1], rates[1:], strict=True):
        links, row = links_in_base(arm, tick["joint_position_rad"]), np.empty(6)
        joint_torques(arm.joint_axes, links, model.masses, before, (after - before) / PERIOD_S, row)
        rows.append(row)
    return np.array(rows)


@pytest.mark.parametrize("seat", [None, Seat(tilt_rad=(np.pi / 2, 0.0, 0.0), position_in_base_m=(0, 0, 1))])
def test_no_joint_takes_more_torque_than_there_is_and_the_one_that_limits_takes_all(
    seat: Seat | None,
) -> None:
    robot = own(Drives(torque_share=0.7, payload=HEAVY), seat)
    ticks, demands = moved(robot, square(120)), square(120)
    load = np.abs(torques_of(robot, ticks)) / (0.7 * arm_model(robot).effort_limit)
    assert load.max() <= 1.0 + 1e-9
    late = np.abs(reached(ticks)[1:] - demands).max(axis=1) > 1e-12
    assert 10 < late.sum() < 110
    assert load[late].max(axis=1) == pytest.approx(1.0, abs=1e-9)


def test_what_is_scaled_back_keeps_its_direction() -> None:
    rates = reached(moved(own(Drives(torque_share=0.5)), square(60)))
    change, wanted = np.diff(rates, axis=0), square(60) - rates[:-1]
    for made, asked in zip(change, wanted, strict=True):
        share = made @ asked / (asked @ asked) if np.abs(asked).max() > 1e-9 else 1.0
        assert 0.0 <= share <= 1.0
        assert made == pytest.approx(share * asked, abs=1e-12)


def test_the_heavier_the_payload_the_longer_it_brakes() -> None:
    """And never shorter than the stop time, which is not of the torques."""
    demands = np.tile(2.0 * SWEEP, (200, 1))
    standing_s = []
    for mass_kg in (0.0, 8.0, 10.0):
        robot = own(Drives(torque_share=0.7, payload=Payload(mass_kg=mass_kg, centre_m=(0.0, 0.0, 0.1))))
        ticks = moved(robot, demands, stop_at=50)
        moving = np.abs(ticks["joint_velocity_radps"]).max(axis=1) > 0.0
        standing_s.append((np.flatnonzero(moving)[-1] - 50) * PERIOD_S)
        assert not moving[-1]
    assert STOP.reaction_time_s + STOP.stop_time_s - PERIOD_S <= standing_s[0]
    assert standing_s[0] < standing_s[1] < standing_s[2]


@pytest.mark.parametrize("stop_at", [None, 45])
def test_both_worlds_agree_where_a_drive_is_saturated(stop_at: int | None, tmp_path: Path) -> None:
    drives = Drives(dead_time_s=0.016, lag_s=0.02, torque_share=0.5, payload=HEAVY)
    robot = own(drives, folder=tmp_path)
    exact, engine = (moved(robot, square(100), stop_at, world) for world in (KinematicWorld, PyBulletWorld))
    at_once = moved(own(None), square(100), stop_at)
    field = "joint_position_rad"
    assert np.abs(exact[field] - at_once[field]).max() > 0.05
    assert np.abs(exact[field] - engine[field]).max() < 1e-6


def text_of(folder: Path, drives: str, urdf: bytes) -> Path:
    """A scenario of a UR10 as an own arm whose meshes lie beside its URDF."""
    files_in(folder, urdf)
    posture = [angle + 0.001 for angle in DEFAULTS.cell.preferred_joint_position_rad]
    robot = f"""\
robot:
  urdf: arm.urdf
  base: base_link
  tcp: tool0
  capsules: arm.json
  braking: {{reaction time: 100 ms, stop time: 300 ms}}
  drives: {drives}
settings:
  cell: {{preferred joint position: [{", ".join(f"{angle!r} rad" for angle in posture)}]}}
"""
    claim = Claim(sentence="hand distance never below 50 mm", expected=Verdict.HOLDS)
    text = write_scenario(replace(scenario(VISIT), claims=(claim,)))
    (folder / "a.yaml").write_text(text.replace("robot: UR10\n", robot))
    return folder / "a.yaml"


def test_a_scenario_with_drives_runs_alike_in_both_worlds_and_is_written_as_read(tmp_path: Path) -> None:
    drives = "{dead time: 8 ms, lag: 20 ms, torque limit: 50 %, payload: {mass: 5 kg}}"
    what = read_scenario(text_of(tmp_path, drives, urdf_file("ur10").read_bytes()))
    assert isinstance(what.robot, OwnRobot)
    expected = Drives(dead_time_s=0.008, lag_s=0.02, torque_share=0.5, payload=Payload(mass_kg=5.0))
    assert what.robot.drives == expected
    (tmp_path / "b.yaml").write_text(write_scenario(what))
    assert read_scenario(tmp_path / "b.yaml").robot == what.robot
    exact, engine = run_kinematic(admit(what)), run(what)
    assert len(exact.decisions) == len(engine.decisions) > 0
    for field in ("joint_position_rad", "hand_distance_m"):
        assert exact.ticks[field] == pytest.approx(engine.ticks[field], abs=1e-6)


@pytest.mark.parametrize("key", ["torque limit: 50 %", "payload: {mass: 1 kg}"])
def test_torques_of_an_arm_with_a_massless_link_are_refused(key: str, tmp_path: Path) -> None:
    forearm = rb'(?s)(<link name="forearm_link">.*?)<inertial>.*?</inertial>'
    urdf, found = re.subn(forearm, rb"\1", urdf_file("ur10").read_bytes())
    assert found == 1
    with pytest.raises(InadmissibleError, match=r"arm\.urdf:\d+.*forearm_link.*<inertial>"):
        admit(read_scenario(text_of(tmp_path, f"{{{key}}}", urdf)))


def test_a_payload_that_the_drives_cannot_hold_is_refused(tmp_path: Path) -> None:
    file = text_of(tmp_path, "{payload: {mass: 100 kg}}", urdf_file("ur10").read_bytes())
    with pytest.raises(
        InadmissibleError, match=r"hold the arm where it starts.*elbow_joint.*150 N m"
    ) as caught:
        admit(read_scenario(file))
    assert caught.value.place.line
