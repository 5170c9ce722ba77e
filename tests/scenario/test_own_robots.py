"""An arm of the user's own in a scenario: its files, what is said beside them, and what is refused."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from safety_harness.admission.admit import admit
from safety_harness.base.exceptions import ArmModelError, InadmissibleError, InputError
from safety_harness.base.shipped.contents import ShippedKind, located, shipped_files
from safety_harness.cell.robot.robots import arm_capsules, arm_model, refuse_unfit
from safety_harness.scenario.model import Scenario
from safety_harness.scenario.read import read_scenario
from safety_harness.scenario.robots import OwnRobot
from safety_harness.scenario.write import write_scenario

SHIPPED = [one.name for one in shipped_files() if one.kind is ShippedKind.ROBOTS]
TEXT = located("shipped:robot-ur10e").read_text()
UR10E = {name: located(f"shipped:robots/ur10e.{name}") for name in ("urdf", "yaml", "capsules.json")}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """The UR10e's files and a scenario with it, ``mine.yaml``."""
    for file in UR10E.values():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    text = TEXT.replace("shipped:ur10e", "ur10e.yaml").replace(
        "extends: robot-iiwa14.yaml", "extends: shipped:robot-iiwa14"
    )
    (tmp_path / "mine.yaml").write_text(text)
    return tmp_path


def changed(folder: Path, name: str, old: str, new: str) -> None:
    text = (folder / name).read_text()
    assert old in text
    (folder / name).write_text(text.replace(old, new, 1))


def own(scenario: Scenario) -> OwnRobot:
    assert isinstance(scenario.robot, OwnRobot)
    return scenario.robot


@pytest.mark.parametrize("name", SHIPPED)
def test_a_shipped_robot_is_admitted_in_its_cell_and_writes_itself(name: str, tmp_path: Path) -> None:
    scenario = read_scenario(located(f"shipped:robot-{name}"))
    robot = own(scenario)
    refuse_unfit(robot)
    assert len(admit(scenario).joint_position_rad) == len(arm_model(robot).joint_names)
    assert arm_capsules(robot).frames == len(arm_model(robot).joint_names) + 2
    text = write_scenario(scenario)
    (tmp_path / "scenarios").mkdir()
    for file in robot.files[:2]:
        if "site-packages" not in file.parts:
            target = tmp_path / "robots" / file.name
            target.parent.mkdir(exist_ok=True)
            target.write_bytes(file.read_bytes())
    again = tmp_path / "scenarios" / "again.yaml"
    again.write_text(text)
    assert own(read_scenario(again)) == robot


def test_what_is_said_beside_an_arms_file_comes_first(folder: Path) -> None:
    beside = "robot: {arm: ur10e.yaml, braking: {reaction time: 20 ms, stop time: 200 ms}}"
    changed(folder, "mine.yaml", "robot: ur10e.yaml", beside)
    robot = own(read_scenario(folder / "mine.yaml"))
    assert robot.braking.reaction_time_s == 0.02
    assert robot.seat is not None
    assert robot.seat.yaw_rad == pytest.approx(np.pi)


def test_joint_speed_limits_stand_in_place_of_the_urdfs(folder: Path) -> None:
    limits = ", ".join(["60 deg/s"] * 6)
    changed(folder, "ur10e.yaml", "base:", f"joint speed limits: [{limits}]\nbase:")
    robot = own(read_scenario(folder / "mine.yaml"))
    np.testing.assert_allclose(np.degrees(arm_model(robot).velocity_limit_radps), 60.0)


REFUSED = [
    ("ur10e.yaml", "urdf: ur10e.urdf\n", "", '"urdf" or "package".*neither'),
    ("ur10e.yaml", "urdf: ur10e.urdf", "package: no-such-package/arm", "not installed"),
    ("ur10e.yaml", "urdf: ur10e.urdf", "package: pybullet", "DISTRIBUTION/NAME"),
    ("ur10e.yaml", "urdf: ur10e.urdf", "package: pybullet/kuka_iiwa/modell", r"kuka_iiwa/model\b"),
    ("ur10e.yaml", "urdf: ur10e.urdf", "urdf: other.urdf", "other.urdf"),
    ("ur10e.yaml", "base: base_link", "base: floor", "floor"),
    ("ur10e.yaml", "braking: {reaction time: 100 ms, stop time: 350 ms}\n", "", "braking"),
    ("ur10e.yaml", "yaw: 180 deg", "yaw: 180", "angle"),
    ("ur10e.yaml", "base:", f"urdf sha256: {'0' * 64}\nbase:", "SHA-256"),
    ("ur10e.yaml", "base:", "joint speed limits: [1 rad/s, 1 rad/s, 1 rad/s]\nbase:", "6 joints.*3"),
    ("ur10e.urdf", 'effort="330"', 'effort="33"', "sha256|SHA-256"),
    ("ur10e.urdf", 'type="revolute"', 'type="prismatic"', "prismatic"),
    ("ur10e.capsules.json", '"radius_m"', '"radius"', "radius"),
    ("mine.yaml", "robot: ur10e.yaml", "robot: shipped:ur10", "ur10e"),
    ("mine.yaml", "robot: ur10e.yaml", "robot: nobody.yaml", "nobody.yaml"),
    ("mine.yaml", "-14 deg, ", "", "6 angles"),
    ("mine.yaml", "seed: 76", "seed: 76\nfaults: [{joint: is stuck, which: seventh}]", "6 joints.*seventh"),
]


@pytest.mark.parametrize(("file", "old", "new", "complaint"), REFUSED)
def test_a_mistake_is_refused_and_told(file: str, old: str, new: str, complaint: str, folder: Path) -> None:
    changed(folder, file, old, new)
    with pytest.raises((InputError, ArmModelError), match=f"(?s){complaint}"):
        admit(read_scenario(folder / "mine.yaml"))


def test_capsules_of_another_arm_are_refused(folder: Path) -> None:
    (folder / "ur10e.capsules.json").write_bytes(located("shipped:robots/xarm6.capsules.json").read_bytes())
    with pytest.raises(InadmissibleError, match=r"base base_link.*got to world"):
        admit(read_scenario(folder / "mine.yaml"))


def test_files_that_changed_after_they_were_read_are_refused(folder: Path) -> None:
    robot = own(read_scenario(folder / "mine.yaml"))
    changed(folder, "ur10e.urdf", 'effort="330"', 'effort="33"')
    with pytest.raises(ArmModelError, match="changed since"):
        refuse_unfit(robot)


def test_a_robot_says_its_files_by_their_hashes(folder: Path) -> None:
    robot = own(read_scenario(folder / "mine.yaml"))
    assert set(robot.texts.values()) == {UR10E["urdf"].read_bytes(), UR10E["capsules.json"].read_bytes()}
    assert json.loads(robot.capsules_text)["urdf_sha256"] == robot.urdf_sha256
    assert robot.label == "ur10e"
    assert replace(robot, files=()) == robot
