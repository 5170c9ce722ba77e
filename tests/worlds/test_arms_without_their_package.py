"""Arms whose meshes lie in the package pybullet load without it: the same arm, with capsules for meshes."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError
from pathlib import Path

import numpy as np
import pytest
from meshless_urdfs import ARMS, meshless

from safety_harness.admission.admit import admit
from safety_harness.admission.trial import judge, run_trial
from safety_harness.base.exceptions import ScenarioError
from safety_harness.cell.robot.dynamics import link_masses
from safety_harness.cell.robot.robots import arm_model
from safety_harness.cell.simulation.worlds import KINEMATIC, WorldEntry
from safety_harness.extensions.assurance.campaign.identity import files_of_plan
from safety_harness.extensions.worlds.mujoco_entry import MUJOCO
from safety_harness.scenario import urdf_packages
from safety_harness.scenario.compose import Library
from safety_harness.scenario.read import read_scenario
from safety_harness.scenario.robots import OwnRobot, robot_named
from tests.assurance.campaign.plans import PLAN, plan_in
from tests.search.short_space import TEXT

ROOT = Path(__file__).parents[2]


@pytest.fixture
def without_package(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Hide the package pybullet, and the arms that were read with it."""

    def missing(name: str) -> dict[str, Path]:
        raise PackageNotFoundError(name)

    arm_model.cache_clear()
    monkeypatch.setattr(urdf_packages, "_urdfs_of", missing)
    yield
    arm_model.cache_clear()


def arm_of(name: str) -> OwnRobot:
    robot = robot_named(str(ROOT / "robots" / f"{name}.yaml"))
    assert isinstance(robot, OwnRobot)
    return robot


@pytest.mark.parametrize("name", ARMS)
def test_the_file_without_meshes_is_what_the_program_writes(name: str) -> None:
    assert (ROOT / "robots" / f"{name}.urdf").read_text() == meshless(name)


@pytest.mark.parametrize("name", ARMS)
def test_joints_limits_and_masses_are_those_of_the_package(name: str, request: pytest.FixtureRequest) -> None:
    theirs = arm_model(arm_of(name))
    request.getfixturevalue("without_package")
    own = arm_model(arm_of(name))
    assert own.file == ROOT / "robots" / f"{name}.urdf"
    assert own.joint_names == theirs.joint_names
    for values in ("joint_origins", "joint_axes", "velocity_limit_radps", "effort_limit"):
        np.testing.assert_array_equal(getattr(own, values), getattr(theirs, values))
    assert link_masses(own).tobytes() == link_masses(theirs).tobytes()


@pytest.mark.parametrize("world", [KINEMATIC, MUJOCO], ids=str)
@pytest.mark.parametrize("name", ARMS)
def test_a_run_without_the_package_has_the_same_bits(
    name: str, world: WorldEntry, request: pytest.FixtureRequest
) -> None:
    file = ROOT / "scenarios" / f"robot-{name}.yaml"
    theirs = run_trial(admit(read_scenario(file)), world=world)
    request.getfixturevalue("without_package")
    own = run_trial(admit(read_scenario(file)), world=world)
    assert own.ticks.tobytes() == theirs.ticks.tobytes()
    assert [one.margin for one in judge(own)] == [one.margin for one in judge(theirs)]
    assert own.system.robot != theirs.system.robot  # the trace says which file it was


def test_an_arm_without_a_file_of_its_own_is_refused_with_the_extra(
    tmp_path: Path, without_package: None
) -> None:
    text = (ROOT / "robots" / "panda.yaml").read_text()
    file = tmp_path / "panda.yaml"
    file.write_text("\n".join(line for line in text.splitlines() if not line.startswith("urdf:")))
    with pytest.raises(ScenarioError, match="an installed package") as error:
        robot_named(str(file))
    assert "the extra pybullet" in error.value.hint


def test_a_plan_packs_the_file_that_took_the_packages_place(tmp_path: Path, without_package: None) -> None:
    for name in ("panda.yaml", "panda.urdf", "panda.capsules.json"):
        (tmp_path / name).write_bytes((ROOT / "robots" / name).read_bytes())
    plan = plan_in(tmp_path, PLAN, TEXT.replace("avoider:", "robot: panda.yaml\navoider:", 1))
    spaces = [stratum.space for stratum in plan.strata]
    names = {file.name for file in files_of_plan(plan.file, Library(), spaces, None)}
    assert "panda.urdf" in names
