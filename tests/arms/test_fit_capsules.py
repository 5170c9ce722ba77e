"""Capsules of any arm: they hold every shape, a seed decides, and a set is used with its own meshes only."""

from __future__ import annotations

import json
import pickle
import re
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from safety_harness.base.exceptions import InputError, MissingPackageError
from safety_harness.cell.robot.capsules import CapsuleSet, load_capsules, read_capsules
from safety_harness.cell.robot.description import ArmModel, LinkShapes, Shape, load_arm, read_arm
from safety_harness.cell.robot.urdf import ArmFileError
from safety_harness.extensions.arms import fit_capsules as module
from safety_harness.extensions.arms.fit_capsules import (
    PIECE_M,
    excess,
    fit_arm,
    fit_link,
    link_surface,
    write_capsules,
)
from tests.cell.robot.test_capsules import depth
from tests.cell.robot.urdfs import OTHERS, SMALL, small_arm_in

PANDA = Path(__file__).with_name("panda.capsules.json")  # of ``safety-harness robot fit``
POINTS = 2_000


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> ArmModel:
    return read_arm(small_arm_in(tmp_path_factory.mktemp("arm")), base="foot", tcp="hand")


@pytest.fixture(scope="module")
def fitted(small: ArmModel) -> Path:
    """The file of its capsules, each link's of one start."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "STARTS", 1)
        write_capsules(small.file.with_name("small.json"), small, fit_arm(small))
    return small.file.with_name("small.json")


def points_of(shape: Shape, rng: np.random.Generator) -> np.ndarray:
    """Random points (n, 3) of a shape's surface in the link's frame, primitives by their own formulas."""
    if shape.kind == "mesh":
        mesh = trimesh.load_mesh(shape.file)
        points = trimesh.sample.sample_surface(mesh, POINTS, seed=rng)[0] * shape.size
    elif shape.kind == "box":
        points = rng.uniform(-0.5, 0.5, (POINTS, 3))
        points = points / np.abs(points).max(axis=1, keepdims=True) / 2.0 * shape.size
    elif shape.kind == "cylinder":
        turn = rng.uniform(0.0, 2.0 * np.pi, POINTS)
        points = np.column_stack((np.cos(turn), np.sin(turn), rng.choice([-0.5, 0.5], POINTS)))
        points *= [shape.size[0], shape.size[0], shape.size[1]]
    else:
        points = rng.normal(size=(POINTS, 3))
        points *= shape.size[0] / np.linalg.norm(points, axis=1, keepdims=True)
    return points @ shape.transform_shape_to_link[:3, :3].T + shape.transform_shape_to_link[:3, 3]


def least_depth(arm: ArmModel, capsules: CapsuleSet) -> list[float]:
    """How deep the outermost of 2,000 points of each shape lies in its link's capsules [m]."""
    rng = np.random.default_rng(2)
    return [
        float(depth(points_of(shape, rng), capsules, link.index).max(axis=1).min())
        for link in arm.links
        for shape in (*link.collision, *link.visual)
    ]


def test_capsules_hold_scaled_meshes_and_primitives(small: ArmModel, fitted: Path) -> None:
    depths = least_depth(small, read_capsules(fitted, small))
    assert len(depths) == 5
    assert min(depths) >= 0.0
    assert min(depths) < 2e-3  # and are no larger than they need be


def test_the_stored_capsules_of_a_panda_hold_its_meshes() -> None:
    file, base, tcp = OTHERS["panda"]
    arm = read_arm(file, base=base, tcp=tcp)
    capsules = read_capsules(PANDA, arm)
    depths = least_depth(arm, capsules)
    assert len(depths) == 18
    assert min(depths) >= 0.0
    assert capsules.frames == 9
    assert set(capsules.link_index.tolist()) == set(range(8))
    assert capsules.with_capsule("tool", 8, (0, 0, 0), (0, 0, 0.1), 0.05).link_index[-1] == 8


@pytest.mark.parametrize("name", ["ur10", "ur5", "ur3"])
def test_an_arm_of_the_shipped_ones_has_primitives_that_its_capsules_hold(name: str) -> None:
    arm, rng = load_arm(name), np.random.default_rng(3)
    (box,) = [shape for shape in arm.links[6].collision if shape.kind == "box"]
    assert depth(points_of(box, rng), load_capsules(name), 6).max(axis=1).min() > 0.0


def test_a_link_can_be_fitted_in_another_process(small: ArmModel, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, few in (("STARTS", 1), ("MOST_CAPSULES", 2), ("ROUNDS", 3), ("POLISH_ROUNDS", 1)):
        monkeypatch.setattr(module, name, few)
    one = replace(small, links=small.links[2:3])

    def elsewhere(function: Any, links: Any) -> list[Any]:  # as a pool does
        return [pickle.loads(pickle.dumps(function))(pickle.loads(pickle.dumps(link))) for link in links]

    assert repr(fit_arm(one)) == repr(fit_arm(one, each=elsewhere))


def test_a_seed_decides_what_is_fitted(small: ArmModel) -> None:
    surface = link_surface(small.links[2], PIECE_M)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "STARTS", 1)
        patch.setattr(module, "MOST_CAPSULES", 2)
        once, again, other = (
            fit_link(surface, np.random.default_rng(seed)) for seed in ((0, 1), (0, 1), (5, 1))
        )
    as_text = [
        [[part.tolist() for part in map(np.asarray, one)] for one in fit] for fit in (once, again, other)
    ]
    assert as_text[0] == as_text[1] != as_text[2]


def long_l() -> LinkShapes:
    """Two long bars that meet at a right angle."""
    there = np.eye(4)
    there[:3, 3] = [0.25, 0.0, 0.25]
    bars = [
        Shape(kind="box", size=np.array([0.05, 0.05, 0.5]), transform_shape_to_link=np.eye(4)),
        Shape(kind="box", size=np.array([0.5, 0.05, 0.05]), transform_shape_to_link=there),
    ]
    return LinkShapes(link="l", index=0, collision=tuple(bars), visual=())


def test_a_bar_gets_one_capsule_and_an_l_two_or_more_and_the_excess_is_told() -> None:
    whole = long_l()
    bar = LinkShapes(link="bar", index=0, collision=whole.collision[:1], visual=())
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "STARTS", 2)
        counts, means = [], []
        for link in (bar, whole):
            surface = link_surface(link, PIECE_M)
            capsules = fit_link(surface, np.random.default_rng(1))
            largest, mean = excess(capsules, surface, np.random.default_rng(1))
            counts.append(len(capsules))
            means.append(mean)
            assert 0.0 < mean < largest < 0.15
    assert counts[0] == 1
    assert counts[1] >= 2
    assert max(means) < 0.04


def test_a_set_of_other_meshes_another_urdf_or_other_ends_is_refused(small: ArmModel, fitted: Path) -> None:
    mesh, urdf = small.file.parent / "small" / "wedge.stl", small.file.read_bytes()
    before = mesh.read_bytes()
    try:
        mesh.write_bytes(before.replace(b"vertex 1 0 0", b"vertex 2 0 0"))
        with pytest.raises(ArmFileError, match=r"mesh package://small/wedge\.stl with the SHA-256"):
            read_capsules(fitted, small)
        mesh.write_bytes(before)
        small.file.write_bytes(urdf + b" ")
        with pytest.raises(ArmFileError, match=r"small\.urdf with the SHA-256"):
            read_capsules(fitted, small)
    finally:
        mesh.write_bytes(before)
        small.file.write_bytes(urdf)
    for base, tcp, complaint in (("world", "hand", "the base world"),):
        with pytest.raises(ArmFileError, match=complaint):
            read_capsules(fitted, read_arm(small.file, base=base, tcp=tcp))
    read_capsules(fitted, small)


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (lambda stored: stored.update(capsules=stored["capsules"][:1]), "capsules of the link 'upper'"),
        (lambda stored: stored["capsules"].clear(), "capsules of foot, upper, lower, hand"),
        (lambda stored: stored["capsules"][0].update(radius_m=0.0), "radii finite and positive"),
        (lambda stored: stored["capsules"][0].update(radius_m="0.1"), "a file of capsules"),
        (lambda stored: stored["capsules"][0].update(link="knee"), "knee"),
        (lambda stored: stored["capsules"][0].update(end_in_link_m=[0.0, 1.0]), "a file of capsules"),
        (lambda stored: stored.pop("urdf_sha256"), "with the SHA-256"),
        (lambda stored: stored["meshes_sha256"].clear(), "to none; fit them again"),
        (lambda stored: stored.update(other=1), "a file of capsules"),
    ],
)
def test_a_damaged_set_is_refused(
    change, complaint: str, small: ArmModel, fitted: Path, tmp_path: Path
) -> None:  # type: ignore[no-untyped-def]
    stored = json.loads(fitted.read_text())
    change(stored)
    (tmp_path / "damaged.json").write_text(json.dumps(stored))
    with pytest.raises(ArmFileError, match=complaint) as error:
        read_capsules(tmp_path / "damaged.json", small)
    assert error.value.place.file == tmp_path / "damaged.json"


@pytest.mark.parametrize("text", ["", "{", "[]", '{"arm": NaN}', "\ufeff", '{"arm": "x", "capsules": "NaN"}'])
def test_what_is_no_set_is_refused(text: str, small: ArmModel, tmp_path: Path) -> None:
    (tmp_path / "no.json").write_text(text)
    with pytest.raises(ArmFileError, match=r"no\.json"):
        read_capsules(tmp_path / "no.json", small)


@pytest.mark.parametrize(
    ("mesh", "complaint"),
    [
        ("nothing of a mesh", "a mesh that can be read|triangles with finite corners"),
        ("solid a\nendsolid a\n", "a mesh that can be read|triangles with finite corners"),
        ("solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 nan\nvertex 0 1 0\nvertex 1 0 0\nendloop\n"
         "endfacet\nendsolid a\n", "a mesh that can be read|finite corners"),
        ("solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 0 999 0\nvertex 999 0 0\nendloop\n"
         "endfacet\nendsolid a\n", "scale it by 0.001"),
    ],
)  # fmt: skip
def test_a_mesh_that_cannot_be_used_is_refused_by_its_name(mesh: str, complaint: str, tmp_path: Path) -> None:
    arm = read_arm(small_arm_in(tmp_path), base="foot", tcp="hand")
    (tmp_path / "small" / "wedge.stl").write_text(mesh)
    with pytest.raises(ArmFileError, match=complaint) as error:
        link_surface(arm.links[2], PIECE_M)
    assert error.value.place.file is not None
    assert error.value.place.file.name == "wedge.stl"


def test_an_arm_without_shapes_is_refused(tmp_path: Path) -> None:
    bare = re.sub(r"<(visual|collision)>.*?</\1>", "", SMALL, flags=re.DOTALL)
    arm = read_arm(small_arm_in(tmp_path, bare), base="foot", tcp="hand")
    with pytest.raises(ArmFileError, match="an arm with shapes"):
        fit_arm(arm)


@pytest.mark.parametrize("up_axis", ["Z_UP", "Y_UP"])
def test_the_unit_of_a_collada_mesh_is_applied_and_its_up_axis_is_not(up_axis: str, tmp_path: Path) -> None:
    file = tmp_path / "box.dae"
    trimesh.creation.box(extents=(100.0, 200.0, 300.0)).export(str(file))
    asset = f'<asset><unit meter="0.001" name="millimeter"/><up_axis>{up_axis}</up_axis>'
    file.write_text(
        file.read_text().replace("<asset>", asset).replace("<up_axis>Y_UP</up_axis></asset>", "</asset>")
    )
    shape = Shape(kind="mesh", size=np.ones(3), transform_shape_to_link=np.eye(4), uri="box.dae", file=file)
    surface = link_surface(LinkShapes(link="a", index=1, collision=(shape,), visual=()), PIECE_M)
    np.testing.assert_allclose(np.ptp(surface.vertices, axis=0), [0.1, 0.2, 0.3], atol=1e-9)


def test_without_trimesh_the_extra_is_named(small: ArmModel, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "trimesh", None)
    with pytest.raises(
        MissingPackageError, match=r"robot fit: needs trimesh.*safety-harness\[fitting\]"
    ) as error:
        link_surface(small.links[0], PIECE_M)
    assert isinstance(error.value, InputError)


def test_without_pycollada_a_dae_names_the_extra_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "collada", None)
    with pytest.raises(MissingPackageError, match=r"robot fit: needs collada.*safety-harness\[fitting\]"):
        link_surface(load_arm("ur3").links[6], PIECE_M)
