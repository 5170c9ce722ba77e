"""The arm as numbers: joint frames, axes and limits, read from its URDF.

The robot descriptions lie in ``data`` beside this file, which says where they come from.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from safety_harness.exceptions import ArmModelError
from safety_harness.geometry.rotations import rotation_about
from safety_harness.geometry.transforms import transform_from

DATA = Path(__file__).with_name("data")
ORIGIN = "package://example-robot-data/robots/"  # what the URDFs call that folder
BASE_LINK = "base_link"
TCP_LINK = "tool0"
JOINTS = 6


def chain_of(joints: int) -> np.dtype[np.void]:
    """The record of a chain of so many joints: its size is part of the type of code compiled for it."""
    return np.dtype(
        [
            ("joint_origins", np.float64, (joints, 4, 4)),
            ("joint_axes", np.float64, (joints, 3)),
            ("flange", np.float64, (4, 4)),
        ],
        align=True,
    )


ChainRecords = NDArray[np.void]  # (1,) of chain_of(n)


class Chain(Protocol):
    """One record of a chain, as compiled code reads it; the arrays are those of ``ArmModel``."""

    joint_origins: NDArray[np.float64]  # (n, 4, 4)
    joint_axes: NDArray[np.float64]  # (n, 3)
    flange: NDArray[np.float64]  # (4, 4)


@dataclass(frozen=True, eq=False, kw_only=True)
class ArmModel:
    """A six-joint arm from ``base_link`` to the tool flange ``tool0``; arrays are read-only.

    ``joint_origins`` (6, 4, 4): frame of link i + 1 at q = 0 to the frame of link i.
    ``joint_axes`` (6, 3): unit axis of joint i in the frame of the link that it moves.
    ``flange`` (4, 4): ``transform_tcp_to_wrist3``.
    The limits are (6,); ``effort_limit`` is in N m.
    """

    name: str
    joint_names: tuple[str, ...]
    link_names: tuple[str, ...]  # base_link, then the six moving links
    joint_origins: NDArray[np.float64]
    joint_axes: NDArray[np.float64]
    flange: NDArray[np.float64]
    position_lower_rad: NDArray[np.float64]
    position_upper_rad: NDArray[np.float64]
    velocity_limit_radps: NDArray[np.float64]
    effort_limit: NDArray[np.float64]

    def __post_init__(self) -> None:
        for value in vars(self).values():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)

    @cached_property
    def chain(self) -> ChainRecords:
        """(1,) of ``chain_of(n)``: joint frames, axes and flange for compiled code, read-only."""
        chain = np.zeros(1, chain_of(len(self.joint_names)))
        for name in chain.dtype.names or ():
            chain[name] = getattr(self, name)
        chain.setflags(write=False)
        return chain


@dataclass(frozen=True, eq=False, kw_only=True)
class MeshFile:
    """One mesh of a link: its file, and where it sits in the link's frame."""

    file: Path
    transform_mesh_to_link: NDArray[np.float64]  # (4, 4)


@dataclass(frozen=True, eq=False, kw_only=True)
class LinkMeshes:
    """The meshes of one link; ``index`` counts base_link as 0, as forward kinematics does."""

    link: str
    index: int
    collision: MeshFile
    visual: MeshFile


def urdf_file(name: str) -> Path:
    """The URDF of the arm ``name`` ("ur3", "ur5", "ur10")."""
    folder = DATA / "ur_description" / "urdf"
    file = folder / f"{name}_robot.urdf"
    if not file.is_file():
        known = sorted(path.name.removesuffix("_robot.urdf") for path in folder.glob("*_robot.urdf"))
        raise ArmModelError(f"there is no arm named {name!r}; there are {', '.join(known)}")
    return file


def resolved_urdf(name: str, *, visuals: bool) -> str:
    """The arm's URDF with absolute mesh paths; without ``visuals`` it has no <visual> elements."""
    tree = _parse(name)
    for mesh in tree.iter("mesh"):
        mesh.set("filename", str(_mesh_file(mesh)))
    if not visuals:
        for link in tree.iter("link"):
            for visual in link.findall("visual"):
                link.remove(visual)
    return ElementTree.tostring(tree, encoding="unicode")


@lru_cache
def load_arm(name: str = "ur10") -> ArmModel:
    """Read the arm ``name`` from its URDF; ``ArmModelError`` unless it is six turning joints and a flange."""
    chain = _chain(_parse(name), name)
    moving, fixed = chain[:JOINTS], chain[JOINTS:]
    types = [joint.get("type") for joint in chain]
    if types != ["revolute"] * JOINTS + ["fixed"]:
        raise ArmModelError(f"{name}: expected six revolute joints, then a fixed one; got {types}")
    axes = np.array([_vector(_child(joint, "axis").get("xyz")) for joint in moving])
    return ArmModel(
        name=name,
        joint_names=tuple(joint.get("name", "") for joint in moving),
        link_names=(BASE_LINK, *(_child(joint, "child").get("link", "") for joint in moving)),
        joint_origins=np.array([_origin(joint) for joint in moving]),
        joint_axes=axes / np.linalg.norm(axes, axis=1, keepdims=True),
        flange=_origin(fixed[0]),
        position_lower_rad=_limits(moving, "lower"),
        position_upper_rad=_limits(moving, "upper"),
        velocity_limit_radps=_limits(moving, "velocity"),
        effort_limit=_limits(moving, "effort"),
    )


def mesh_paths(name: str) -> tuple[LinkMeshes, ...]:
    """Collision and visual mesh of base_link and of the six moving links, in this order."""
    tree = _parse(name)
    links = {link.get("name"): link for link in tree.iter("link")}
    return tuple(
        LinkMeshes(
            link=link,
            index=index,
            collision=_mesh_of(links[link], "collision"),
            visual=_mesh_of(links[link], "visual"),
        )
        for index, link in enumerate(load_arm(name).link_names)
    )


def _parse(name: str) -> ElementTree.Element:
    file = urdf_file(name)
    try:
        return ElementTree.parse(file).getroot()
    except ElementTree.ParseError as error:
        raise ArmModelError(f"{file}: not a URDF: {error}") from error


def _chain(robot: ElementTree.Element, name: str) -> list[ElementTree.Element]:
    """The joints from the base link to the TCP link, base first."""
    joint_above = {_child(joint, "child").get("link"): joint for joint in robot.findall("joint")}
    chain: list[ElementTree.Element] = []
    link: str | None = TCP_LINK
    while link != BASE_LINK:
        if link not in joint_above or len(chain) > len(joint_above):
            raise ArmModelError(f"{name}: no chain of joints leads from {BASE_LINK} to {TCP_LINK}")
        chain.append(joint_above[link])
        link = _child(chain[-1], "parent").get("link")
    return chain[::-1]


def _mesh_of(link: ElementTree.Element, kind: str) -> MeshFile:
    part = _child(link, kind)
    mesh = part.find("geometry/mesh")
    if mesh is None or mesh.get("scale") is not None:
        raise ArmModelError(f"link {link.get('name')!r}: its {kind} shape is not an unscaled mesh")
    return MeshFile(file=_mesh_file(mesh), transform_mesh_to_link=_origin(part))


def _mesh_file(mesh: ElementTree.Element) -> Path:
    uri = mesh.get("filename", "")
    file = DATA / uri.removeprefix(ORIGIN)
    if not (uri.startswith(ORIGIN) and file.is_file()):
        raise ArmModelError(f"there is no mesh file for {uri!r}")
    return file


def _child(element: ElementTree.Element, tag: str) -> ElementTree.Element:
    child = element.find(tag)
    if child is None:
        raise ArmModelError(f"<{element.tag} name={element.get('name')!r}> has no <{tag}>")
    return child


def _vector(text: str | None, default: str | None = None) -> NDArray[np.float64]:
    try:
        vector = np.array([float(word) for word in (text or default or "").split()])
    except ValueError as error:
        raise ArmModelError(f"expected three numbers, got {text!r}") from error
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise ArmModelError(f"expected three numbers, got {text!r}")
    return vector


def _limits(joints: list[ElementTree.Element], key: str) -> NDArray[np.float64]:
    try:
        return np.array([float(_child(joint, "limit").get(key, "")) for joint in joints])
    except ValueError as error:
        raise ArmModelError(f"a joint's limit has no usable {key!r}") from error


def _origin(element: ElementTree.Element) -> NDArray[np.float64]:
    """The (4, 4) transform of an <origin>: fixed-axis roll, pitch, yaw, so R = Rz Ry Rx."""
    origin = element.find("origin")
    if origin is None:
        return np.eye(4)
    rotation = np.eye(3)
    turn = np.empty((3, 3))
    for axis, angle in zip(np.eye(3), _vector(origin.get("rpy"), "0 0 0"), strict=True):
        rotation_about(axis, angle, turn)
        rotation = turn @ rotation
    return transform_from(rotation, _vector(origin.get("xyz"), "0 0 0"))
