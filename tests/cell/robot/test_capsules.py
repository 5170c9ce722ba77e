"""The capsules enclose the arm: every vertex and every triangle of both kinds of mesh."""

import json
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
import trimesh

from safety_harness.base.exceptions import ArmModelError
from safety_harness.cell.robot import capsules as capsules_module
from safety_harness.cell.robot.capsules import CapsuleSet, load_capsules
from safety_harness.cell.robot.description import LinkShapes, Shape, load_arm
from tests.cell.robot.arms import ARMS, transforms_of

ALL_LINKS = [
    pytest.param(name, link, id=f"{name}-{link.link}") for name in ARMS for link in load_arm(name).links
]
SMALLEST_PIECE_M = 1e-4


def meshes_of(link: LinkShapes) -> list[Shape]:
    return [shape for shape in (*link.collision, *link.visual) if shape.kind == "mesh"]


@lru_cache
def triangles(part: Shape) -> np.ndarray:
    """Corners (n, 3, 3) in the link's frame."""
    mesh = trimesh.load_mesh(part.file)
    corners = np.asarray(mesh.vertices)[np.asarray(mesh.faces)] * part.size
    return corners @ part.transform_shape_to_link[:3, :3].T + part.transform_shape_to_link[:3, 3]


def depth(points: np.ndarray, capsules: CapsuleSet, link: int) -> np.ndarray:
    """How deep points (..., 3) lie in each capsule of a link: (..., k), negative outside."""
    chosen = capsules.link_index == link
    start, end, radius = (
        capsules.start_in_link[chosen],
        capsules.end_in_link[chosen],
        capsules.radius_m[chosen],
    )
    axis = end - start
    squared = np.maximum((axis**2).sum(axis=1), 1e-300)
    t = np.clip(((points[..., None, :] - start) * axis).sum(axis=-1) / squared, 0.0, 1.0)
    return radius - np.linalg.norm(points[..., None, :] - start - t[..., None] * axis, axis=-1)


def not_enclosed(corners: np.ndarray, capsules: CapsuleSet, link: int) -> np.ndarray:
    """The triangles that are not proved to lie in the union of a link's capsules.

    A capsule is convex: with its three corners it holds the triangle.  Others are quartered until
    each piece lies in one capsule, or a corner lies in none, or a piece is so small that it is
    given up.
    """
    while len(corners):
        held = depth(corners, capsules, link) >= 0.0
        bare = ~held.any(axis=2).all(axis=1)
        if bare.any():
            return corners[bare]
        corners = corners[~held.all(axis=1).any(axis=1)]
        a, b, c = np.moveaxis(corners, 1, 0)
        size = np.linalg.norm([b - a, c - b, a - c], axis=2).max(axis=0)
        if (size < SMALLEST_PIECE_M).any():
            return corners
        ab, bc, ca = (a + b) / 2.0, (b + c) / 2.0, (c + a) / 2.0
        pieces = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        corners = np.concatenate([np.stack(piece, axis=1) for piece in pieces])
    return corners


@pytest.mark.parametrize(("name", "link"), ALL_LINKS)
def test_the_union_of_a_links_capsules_holds_every_triangle_of_its_meshes(
    name: str, link: LinkShapes
) -> None:
    for part in meshes_of(link):
        corners = triangles(part)
        assert len(corners) > 100
        assert len(not_enclosed(corners, load_capsules(name), link.index)) == 0


@pytest.mark.parametrize(("name", "link"), ALL_LINKS)
def test_no_radius_can_be_a_millimetre_smaller(name: str, link: LinkShapes) -> None:
    """Shrink one capsule at a time: some triangle is then outside, so none is larger than it need be."""
    capsules = load_capsules(name)
    for index in np.flatnonzero(capsules.link_index == link.index):
        radius = capsules.radius_m.copy()
        radius[index] -= 1e-3
        smaller = CapsuleSet(
            names=capsules.names,
            link_index=capsules.link_index,
            start_in_link=capsules.start_in_link,
            end_in_link=capsules.end_in_link,
            radius_m=radius,
        )
        outside = [not_enclosed(triangles(part), smaller, link.index) for part in meshes_of(link)]
        assert sum(map(len, outside)) > 0, capsules.names[index]


@pytest.mark.parametrize("name", ARMS)
def test_meshes_are_in_metres_and_the_size_of_the_arm(name: str) -> None:
    """A mesh in the wrong unit would make the enclosure worthless."""
    links = load_arm(name).links
    forearm = triangles(links[3].visual[0]).reshape(-1, 3)
    length = np.linalg.norm(load_arm(name).joint_origins[3, :3, 3])
    assert length < np.ptp(forearm[:, 2]) < 1.35 * length
    for link in links:
        a, b = (triangles(part).reshape(-1, 3) for part in meshes_of(link))
        np.testing.assert_allclose(np.ptp(a, axis=0), np.ptp(b, axis=0), atol=0.03)


@pytest.mark.parametrize("name", ARMS)
def test_the_flange_is_inside_the_last_links_capsules(name: str) -> None:
    arm = load_arm(name)
    assert depth(arm.flange[:3, 3], load_capsules(name), 6).max() > 0.0


@pytest.mark.parametrize("name", ARMS)
def test_every_link_has_capsules_with_names_of_their_own(name: str) -> None:
    capsules = load_capsules(name)
    assert set(capsules.link_index.tolist()) == set(range(7))
    assert len(set(capsules.names)) == len(capsules.names) <= 16


def test_a_tool_is_added_to_a_new_set() -> None:
    arm_only = load_capsules("ur10")
    with_tool = arm_only.with_capsule("camera", 7, (0.0, -0.045, 0.0), (0.0, -0.045, 0.02), 0.05)
    assert with_tool.names == (*arm_only.names, "camera")
    assert with_tool.link_index[-1] == 7
    assert with_tool.end_in_link[-1].tolist() == [0.0, -0.045, 0.02]
    assert with_tool.radius_m[-1] == 0.05
    assert "camera" not in load_capsules("ur10").names
    with pytest.raises(ValueError, match="read-only"):
        with_tool.radius_m[0] = 0.0


@pytest.mark.parametrize(
    ("link", "end", "radius"),
    [(8, 0.0, 0.1), (-1, 0.0, 0.1), (7, np.nan, 0.1), (7, 0.0, 0.0), (7, 0.0, np.nan)],
)
def test_an_impossible_capsule_is_refused(link: int, end: float, radius: float) -> None:
    with pytest.raises(ArmModelError, match="capsules"):
        load_capsules("ur10").with_capsule("bad", link, (0.0, 0.0, 0.0), (0.0, 0.0, end), radius)


def test_an_arm_without_fitted_capsules_names_the_command_that_fits_them() -> None:
    with pytest.raises(ArmModelError, match="'ur5_gripper'; to fit them: safety-harness robot fit"):
        load_capsules("ur5_gripper")


def test_what_is_loaded_is_what_is_on_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    entry = {
        "name": "x",
        "link": "tool0",
        "start_in_link_m": [0.0, 0.1, 0.2],
        "end_in_link_m": [0.3, 0.4, 0.5],
        "radius_m": 0.6,
    }
    (tmp_path / "ur10.json").write_text(json.dumps({"arm": "ur10", "capsules": [entry]}))
    monkeypatch.setattr(capsules_module, "capsule_file", lambda name: tmp_path / f"{name}.json")
    load_capsules.cache_clear()
    try:
        loaded = load_capsules("ur10")
    finally:
        load_capsules.cache_clear()
    assert loaded.names == ("x",)
    assert loaded.link_index.tolist() == [7]
    assert loaded.start_in_link.tolist() == [entry["start_in_link_m"]]
    assert loaded.end_in_link.tolist() == [entry["end_in_link_m"]]
    assert loaded.radius_m.tolist() == [0.6]


@pytest.mark.parametrize("name", ARMS)
def test_neighbouring_links_overlap_so_that_no_gap_is_left_at_a_joint(name: str) -> None:
    """At every joint the moving link's capsules touch those of the link below."""
    capsules = load_capsules(name)
    transforms = transforms_of(load_arm(name), np.array([0.1, -1.0, 1.2, 0.4, -0.8, 0.3]))
    for upper in range(1, 7):
        best = -np.inf
        for index in np.flatnonzero(capsules.link_index == upper):
            s = np.linspace(0.0, 1.0, 50)[:, None]
            a, b = capsules.start_in_link[index], capsules.end_in_link[index]
            points = np.column_stack((a + s * (b - a), np.ones(50)))
            below = (points @ (np.linalg.inv(transforms[upper - 1]) @ transforms[upper]).T)[:, :3]
            best = max(best, depth(below, capsules, upper - 1).max() + capsules.radius_m[index])
        assert best > 0.0
