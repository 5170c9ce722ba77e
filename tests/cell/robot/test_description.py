import hashlib
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from safety_harness.base.exceptions import ArmModelError
from safety_harness.cell.robot import description
from safety_harness.cell.robot.description import load_arm, resolved_urdf
from tests.cell.robot.arms import ARMS, transforms_of


@pytest.fixture
def fresh_cache() -> Iterator[None]:
    load_arm.cache_clear()
    yield
    load_arm.cache_clear()


@pytest.mark.parametrize("name", ARMS)
def test_every_arm_has_six_unit_axes_rigid_frames_and_sensible_limits(name: str) -> None:
    arm = load_arm(name)
    np.testing.assert_allclose(np.linalg.norm(arm.joint_axes, axis=1), 1.0, atol=1e-15)
    for frame in [*arm.joint_origins, arm.flange]:
        np.testing.assert_allclose(frame[:3, :3] @ frame[:3, :3].T, np.eye(3), atol=1e-14)
        np.testing.assert_array_equal(frame[3], [0.0, 0.0, 0.0, 1.0])
    assert (arm.position_lower_rad < 0.0).all()
    assert (arm.position_upper_rad > 0.0).all()
    assert (arm.velocity_limit_radps > 0.0).all()
    assert (arm.effort_limit > 0.0).all()
    assert [name.split("_joint")[0] for name in arm.joint_names] == [
        "shoulder_pan",
        "shoulder_lift",
        "elbow",
        "wrist_1",
        "wrist_2",
        "wrist_3",
    ]


def test_the_numbers_are_those_of_the_urdf() -> None:
    """Read a second time, by another road: regular text search in the resolved URDF."""
    robot = ElementTree.fromstring(resolved_urdf(load_arm("ur10"), visuals=False))
    arm = load_arm("ur10")
    for i, name in enumerate(arm.joint_names):
        joint = robot.find(f"joint[@name='{name}']")
        assert joint is not None
        origin, limit = joint.find("origin"), joint.find("limit")
        assert origin is not None
        assert limit is not None
        assert arm.joint_origins[i, :3, 3].tolist() == [float(x) for x in origin.attrib["xyz"].split()]
        assert arm.velocity_limit_radps[i] == float(limit.attrib["velocity"])
        assert arm.position_lower_rad[i] == float(limit.attrib["lower"])
        assert arm.position_upper_rad[i] == float(limit.attrib["upper"])
        assert arm.effort_limit[i] == float(limit.attrib["effort"])


def test_the_reach_of_the_arms_is_that_of_their_names_in_order() -> None:
    reach = [np.linalg.norm(transforms_of(load_arm(name), np.zeros(6))[7, :3, 3]) for name in ARMS]
    assert reach == sorted(reach, reverse=True)


def test_an_arm_cannot_be_changed() -> None:
    arm = load_arm("ur10")
    with pytest.raises(ValueError, match="read-only"):
        arm.joint_origins[0, 0, 0] = 2.0
    assert load_arm("ur10") is arm


@pytest.mark.parametrize("name", ARMS)
def test_resolved_urdf_names_files_that_exist_and_keeps_visuals_only_on_demand(name: str) -> None:
    for visuals, kinds in ((True, {".stl", ".dae"}), (False, {".stl"})):
        robot = ElementTree.fromstring(resolved_urdf(load_arm(name), visuals=visuals))
        files = [Path(mesh.attrib["filename"]) for mesh in robot.iter("mesh")]
        assert {file.suffix for file in files} == kinds
        assert all(file.is_absolute() and file.is_file() for file in files)
        assert bool(list(robot.iter("visual"))) == visuals


@pytest.mark.parametrize("name", ARMS)
def test_every_link_has_a_collision_and_a_visual_mesh(name: str) -> None:
    meshes = load_arm(name).links
    assert [link.index for link in meshes] == list(range(7))
    assert tuple(link.link for link in meshes) == load_arm(name).link_names
    for link in meshes:
        for shapes, suffix in ((link.collision, ".stl"), (link.visual, ".dae")):
            (file,) = [shape.file for shape in shapes if shape.kind == "mesh"]
            assert file is not None
            assert file.suffix == suffix
            assert file.is_file()


def test_an_unknown_arm_is_refused_with_the_list_of_known_ones() -> None:
    with pytest.raises(ArmModelError, match=r"ur11.*ur10, ur3, ur5"):
        load_arm("ur11")


def test_the_files_are_those_of_example_robot_data_byte_for_byte() -> None:
    """As its version 6.0.0 installs them: names and contents, in alphabetical order."""
    digest = hashlib.sha256()
    for file in sorted((description.DATA / "ur_description").rglob("*.*")):
        digest.update(file.relative_to(description.DATA).as_posix().encode())
        digest.update(file.read_bytes())
    assert digest.hexdigest() == "7e0b66fca1b56c22aeb6d34e87e05d3aa0ed32b08cf12e7cd320359ad781efbc"


def test_the_licence_of_the_files_lies_beside_them() -> None:
    assert "Redistribution and use in source and binary forms" in (description.DATA / "LICENSE").read_text()
    assert "ros-industrial/universal_robot" in (description.DATA / "README.md").read_text()


@pytest.mark.usefixtures("fresh_cache")
@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ('type="revolute"', 'type="prismatic"', "revolute, continuous or fixed"),
        ('xyz="0 0 1"', 'xyz="0 0"', "three numbers"),
        ('link="tool0"', 'link="tool"', "a link of the file"),
        ("</robot>", "", "a URDF, which is XML"),
    ],
)
def test_a_damaged_urdf_is_refused(
    old: str, new: str, complaint: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    text = description.urdf_file("ur10").read_text()
    assert old in text
    (tmp_path / "damaged.urdf").write_text(text.replace(old, new))
    monkeypatch.setattr(description, "urdf_file", lambda name: tmp_path / "damaged.urdf")
    with pytest.raises(ArmModelError, match=complaint):
        load_arm("ur10")


@pytest.mark.usefixtures("fresh_cache")
def test_a_missing_mesh_is_reported(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    text = description.urdf_file("ur10").read_text()
    (tmp_path / "damaged.urdf").write_text(text.replace("collision/base.stl", "collision/bass.stl"))
    monkeypatch.setattr(description, "urdf_file", lambda name: tmp_path / "damaged.urdf")
    with pytest.raises(ArmModelError, match=r"bass\.stl"):
        load_arm("ur10")
