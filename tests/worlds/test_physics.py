"""The scenarios of examples/physics, where the references agree and the kinematic world differs."""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from safety_harness.admission.admit import Admitted, admit
from safety_harness.admission.trial import run_trial
from safety_harness.base.exceptions import InadmissibleError
from safety_harness.cell.simulation.worlds import KINEMATIC, PYBULLET, WorldEntry
from safety_harness.claims.properties.base import Evaluation
from safety_harness.extensions.worlds.mujoco_entry import MUJOCO
from safety_harness.scenario.model import Verdict
from safety_harness.scenario.read import read_scenario
from safety_harness.search.confirm import physics_of
from safety_harness.trace.trace import Trace

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "examples/physics"
URDFS = ((ROOT / "robots", "ur10e.urdf"), (FOLDER, "ur10e-with-part.urdf"))
HOLDS, VIOLATED = Verdict.HOLDS, Verdict.VIOLATED
HAND, RETREAT = "hand distance never below 50 mm", "repulsion moves away from every hand"
TOUCH, SPEED = "no moving part touches a hand", "TCP speed never above 250 mm/s"
SHOCK, SUNK, DEPTH = (
    "TCP acceleration never above 2 m/s2",
    "always TCP height > 300 mm",
    "always TCP height > -40 mm",
)


@dataclass(frozen=True)
class Case:
    """What physics makes of a scenario.

    ``apart_rad`` is the largest difference of a joint between PyBullet and the kinematic world.
    ``references_rad`` bounds the difference between both references. ``margins`` are those of the kinematic
    world and of both references, in the unit of the report.
    """

    name: str
    apart_rad: float
    references_rad: float
    margins: dict[str, tuple[float, float, float]]


CASES = (
    Case("weak-motors", 0.143, 0.005, {HAND: (28.3, -21.0, -21.8), RETREAT: (200.0, -15.0, -16.0)}),
    Case(
        "payload",
        0.578,
        0.005,
        {HAND: (166.4, -65.6, -65.5), SPEED: (248.0, -508.8, -505.8), SUNK: (67.2, -186.5, -186.3)},
    ),
    Case("pressing", 0.154, 0.05, {SHOCK: (1.0, -12.3, -14.5), DEPTH: (-55.8, 40.6, 39.7)}),
    Case("full-stop", 0.098, 0.002, {HAND: (45.4, -70.9, -71.5), TOUCH: (95.4, -20.9, -21.5)}),
)
WORLDS = (KINEMATIC, PYBULLET, MUJOCO)


@cache
def admitted(name: str) -> Admitted:
    return admit(read_scenario(FOLDER / f"{name}.yaml"))


@cache
def run_in(world: WorldEntry, name: str) -> Trace:
    return run_trial(admitted(name), world=world)


def judged(world: WorldEntry, name: str) -> list[Evaluation]:
    return [prop.evaluate(run_in(world, name)) for prop in admitted(name).properties]


def apart_rad(first: Trace, second: Trace) -> float:
    return float(np.abs(first.ticks["joint_position_rad"] - second.ticks["joint_position_rad"]).max())


def test_every_scenario_of_the_folder_has_a_case() -> None:
    assert {path.stem for path in FOLDER.glob("*.yaml")} == {case.name for case in CASES}


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_both_references_agree_and_the_kinematic_world_says_the_opposite(case: Case) -> None:
    kinematic, pybullet, mujoco = (judged(world, case.name) for world in WORLDS)
    expected = [claim.expected for claim in run_in(PYBULLET, case.name).scenario.claims]
    opposite = [VIOLATED if verdict is HOLDS else HOLDS for verdict in expected]
    assert [one.verdict for one in pybullet] == [one.verdict for one in mujoco] == expected
    assert [one.verdict for one in kinematic] == opposite


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_the_joints_differ_by_physics(case: Case) -> None:
    kinematic, pybullet, mujoco = (run_in(world, case.name) for world in WORLDS)
    assert apart_rad(pybullet, kinematic) == pytest.approx(case.apart_rad, rel=0.1)
    assert apart_rad(pybullet, mujoco) < case.references_rad
    assert all(physics_of(run, kinematic)[0] for run in (pybullet, mujoco))


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_the_page_has_the_margins_of_the_runs(case: Case) -> None:
    for number, world in enumerate(WORLDS):
        found = {one.sentence: float(one.margin_text().split()[0]) for one in judged(world, case.name)}
        stated = {claim: margins[number] for claim, margins in case.margins.items()}
        assert found == pytest.approx(stated, abs=0.5)
    page = (ROOT / "docs/explanation/worlds.md").read_text()
    rows = [line.split(" | ") for line in page.splitlines() if line.startswith(f"| [{case.name}]")]
    assert rows
    for _, _, claim, *verdicts in rows:
        numbers = [float(re.findall(r"by ([\d.]+)", verdict)[0]) for verdict in verdicts]
        signs = [1.0 if verdict.startswith("holds") else -1.0 for verdict in verdicts]
        assert tuple(np.multiply(signs, numbers)) == case.margins[claim.strip("`")]


@pytest.mark.parametrize("name", ["weak-motors", "full-stop"])
def test_drives_that_state_the_torques_give_all_worlds_the_verdicts_of_the_references(
    name: str, tmp_path: Path
) -> None:
    stated = admit(read_scenario(written(name, "  arm: shipped:ur10e\n", tmp_path)))
    runs = [run_trial(stated, world=world) for world in (KINEMATIC, MUJOCO)]
    assert apart_rad(*runs) < 1e-9
    assert {prop.evaluate(run).verdict for run in runs for prop in stated.properties} == {VIOLATED}


def test_an_arm_whose_drives_state_the_torques_is_refused_if_it_cannot_hold_the_part(tmp_path: Path) -> None:
    with pytest.raises(InadmissibleError, match=r"hold the arm where it starts: 212 N m at elbow_joint"):
        admit(read_scenario(written("payload", "  base: base_link\n", tmp_path)))


def written(name: str, after: str, folder: Path) -> Path:
    """Return a copy of a scenario that also states drives with a torque limit."""
    text = (FOLDER / f"{name}.yaml").read_text()
    assert text.count(after) == 1
    text = text.replace(after, f"{after}  drives: {{torque limit: 100 %}}\n")
    for file in ("controllers.py", "ur10e-with-part.urdf", "ur10e-with-part.capsules.json"):
        text = text.replace(f" {file}", f" {FOLDER / file}")
    path = folder / f"{name}.yaml"
    path.write_text(text)
    return path


def test_the_arm_with_a_part_is_the_shipped_arm_and_a_mass() -> None:
    """Its URDF has no visual shapes, so that the copy is short."""
    shipped, part = ((folder / file).read_text() for folder, file in URDFS)
    shipped = re.sub(r"\n    <visual>.*", "", shipped)
    mass = re.search(r'  <link name="part">.*?</link>\n  <joint name="grip".*?</joint>\n', part, re.DOTALL)
    assert mass is not None
    bare = part.replace(mass[0], "")
    assert re.sub(r"<!--.*?-->", "", bare, flags=re.DOTALL) == re.sub(
        r"<!--.*?-->", "", shipped, flags=re.DOTALL
    )


def test_the_capsules_of_the_arm_with_a_part_are_those_of_the_shipped_arm() -> None:
    old, new = (hashlib.sha256((folder / file).read_bytes()).hexdigest() for folder, file in URDFS)
    shipped = (ROOT / "robots/ur10e.capsules.json").read_text()
    assert (FOLDER / "ur10e-with-part.capsules.json").read_text() == shipped.replace(old, new)
