"""Read an arm from a URDF as numbers: joint frames, axes, limits and link shapes.

The shipped robot descriptions and their sources lie in the folder ``data`` beside this file.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache, reduce
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.elementary import product
from safety_harness.base.exceptions import ArmModelError
from safety_harness.base.geometry.linear import eigen
from safety_harness.cell.robot.joint_data import Lack, Use, joint_data
from safety_harness.cell.robot.urdf import ArmFileError, Urdf, read_bytes

DATA = Path(__file__).with_name("data")
PACKAGES = {"example-robot-data/robots": DATA}  # the name of that folder in the shipped URDFs
BASE_LINK = "base_link"
TCP_LINK = "tool0"
FEWEST, MOST = 3, 8  # turning joints
MOMENT_EXCESS = 1.2  # principal moment / sum of the other two, at most: URDFs reach 1.16 (xArm6)
SIZES = {"mesh": "scale", "box": "size", "cylinder": "radius length", "sphere": "radius"}


def chain_of(joints: int) -> np.dtype[np.void]:
    """Return the record type of a chain of ``joints`` joints.

    The number of joints is part of the type, so that numba compiles code for each number.
    """
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
    """A record of a chain, in the form that compiled code reads.

    ``ArmModel`` explains its arrays.
    """

    joint_origins: NDArray[np.float64]  # (n, 4, 4)
    joint_axes: NDArray[np.float64]  # (n, 3)
    flange: NDArray[np.float64]  # (4, 4)


@dataclass(frozen=True, eq=False, kw_only=True)
class Shape:
    """A shape of a link, placed in the link's frame.

    ``size`` depends on ``kind``: a mesh's scale (3,), a box's edges (3,) [m], a cylinder's radius and length
    (2,) [m] along z, or a sphere's radius (1,) [m]. A mesh also has its name in the URDF, ``uri``, and its
    ``file``.
    """

    kind: str  # of SIZES
    size: NDArray[np.float64]
    transform_shape_to_link: NDArray[np.float64]  # (4, 4)
    uri: str = ""
    file: Path | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class LinkShapes:
    """The shapes of a link and of everything fixed to it.

    ``index`` is the number of the link, and the base has the number 0.
    """

    link: str
    index: int
    collision: tuple[Shape, ...]
    visual: tuple[Shape, ...]


@dataclass(frozen=True, eq=False, kw_only=True)
class ArmModel:
    """An arm with n turning joints between its base and its tcp.

    All arrays are read-only. ``joint_origins`` (n, 4, 4) are the transforms from the frame of link i + 1 to
    the frame of link i, with all joints at zero. ``joint_axes`` (n, 3) are the unit axes of the joints, each
    in the frame of the link that it moves. ``flange`` (4, 4) transforms from the tcp to the last moving link.
    The arrays of limits have the shape (n,). The entries of ``effort_limit`` are in N m. A continuous joint
    has the position limits -inf and inf. ``left_out`` contains the names of links that have shapes but are
    not fixed to any link of the arm. ``transform_seat`` (4, 4) transforms from the base link's frame to the
    base frame. This transform is the identity until ``seated`` changes it.
    """

    name: str
    file: Path
    joint_names: tuple[str, ...]
    link_names: tuple[str, ...]  # the base, then the n moving links
    tcp_link: str
    joint_origins: NDArray[np.float64]
    joint_axes: NDArray[np.float64]
    flange: NDArray[np.float64]
    position_lower_rad: NDArray[np.float64]
    position_upper_rad: NDArray[np.float64]
    velocity_limit_radps: NDArray[np.float64]
    effort_limit: NDArray[np.float64]
    links: tuple[LinkShapes, ...]  # of the base, then of the n moving links
    left_out: tuple[str, ...]
    soft_limits_rad: NDArray[np.float64]
    in_degrees: bool
    without_inertia: tuple[str, ...]
    notes: tuple[str, ...]
    text: bytes  # of the URDF
    packages: Mapping[str, Path]
    transform_seat: NDArray[np.float64] = field(default_factory=lambda: np.eye(4))

    def __post_init__(self) -> None:
        for value in vars(self).values():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)

    @cached_property
    def chain(self) -> ChainRecords:
        """The joint frames, axes and flange for compiled code, in a read-only record (1,).

        Its type is ``chain_of(n)``.
        """
        chain = np.zeros(1, chain_of(len(self.joint_names)))
        for name in chain.dtype.names or ():
            chain[name] = getattr(self, name)
        chain.setflags(write=False)
        return chain

    def seated(self, transform: NDArray[np.float64]) -> ArmModel:
        """Return the same arm with its base at another place.

        ``transform`` (4, 4) transforms from the arm's base link to the base frame.
        """
        origins = np.concatenate((product(transform, self.joint_origins[0])[None], self.joint_origins[1:]))
        return replace(self, joint_origins=origins, transform_seat=product(transform, self.transform_seat))

    @property
    def lacks(self) -> tuple[Lack, ...]:
        """The quantities that the URDF does not state. Each quantity comes with the uses that need it."""
        missing = [
            (self._joints(self.velocity_limit_radps), "speed", (Use.RUN,), "joint speed limits"),
            (self._joints(self.effort_limit), "effort", (Use.TORQUES, Use.PHYSICS), "joint torque limits"),
        ]
        lacks = [
            Lack(f"the {quantity} of {names}", uses, f"the arm's key `{key}`")
            for names, quantity, uses, key in missing
            if names
        ]
        if self.in_degrees:
            supply = "the arm's key `angles: rad`; else write them in rad (180 deg is 3.14159)"
            lacks.append(Lack("the unit of the limits, which look like degrees", (Use.RUN,), supply))
        if self.without_inertia:
            quantity = f"a mass and inertia that a body can have, of {', '.join(self.without_inertia)}"
            lacks.append(Lack(quantity, (Use.TORQUES, Use.PHYSICS), "<inertial> in the URDF"))
        return tuple(lacks)

    def _joints(self, numbers: NDArray[np.float64]) -> str:
        return ", ".join(np.array(self.joint_names)[np.isnan(numbers)])

    def require(self, use: Use) -> None:
        """Raise ``ArmFileError`` if the arm lacks a number that ``use`` needs."""
        for lack in self.lacks:
            if use in lack.uses:
                raise ArmFileError.of_file(self.file, f"{lack.what}, for {use}", "none", lack.supply)

    @property
    def farthest_reach_m(self) -> float:
        """An upper bound [m] of the distance between tcp and second joint in any pose.

        The bound is the sum of the distances between successive frames.
        """
        frames = np.concatenate((self.joint_origins[2:], self.flange[None]))
        return float(np.linalg.norm(frames[:, :3, 3], axis=1).sum())


def urdf_file(name: str) -> Path:
    """Return the URDF of the shipped arm ``name`` ("ur3", "ur5", "ur10").

    Raise ``ArmModelError`` if no shipped arm has this name.
    """
    folder = DATA / "ur_description" / "urdf"
    file = folder / f"{name}_robot.urdf"
    if not file.is_file():
        known = sorted(path.name.removesuffix("_robot.urdf") for path in folder.glob("*_robot.urdf"))
        raise ArmModelError(f"there is no arm named {name!r}; there are {', '.join(known)}")
    return file


def resolved_urdf(arm: ArmModel, *, visuals: bool) -> str:
    """Return an arm's URDF with absolute mesh paths.

    The result contains only the links that are fixed to the arm. The arm's base becomes the root. If
    ``visuals`` is False, the result has no <visual> elements.
    """
    urdf = Urdf.read(arm.file, arm.text)
    for joint in urdf.root.findall("joint"):
        child = urdf.text(urdf.child(joint, "child"), "link")
        if urdf.carrier(child, arm.link_names)[0] is None or child == arm.link_names[0]:
            urdf.root.remove(joint)
    for name, link in urdf.links.items():
        if urdf.carrier(name, arm.link_names)[0] is None:
            urdf.root.remove(link)
            continue
        for part in (*link.findall("visual"), *link.findall("collision")):
            if is_empty(urdf, part) or (part.tag == "visual" and not visuals):
                link.remove(part)
        for mesh in link.iter("mesh"):
            mesh.set("filename", str(urdf.mesh_file(mesh, arm.packages)))
    return ElementTree.tostring(urdf.root, encoding="unicode")


@lru_cache
def load_arm(name: str = "ur10") -> ArmModel:
    """Return the shipped arm ``name`` ("ur3", "ur5", "ur10")."""
    return read_arm(urdf_file(name), base=BASE_LINK, tcp=TCP_LINK, packages=PACKAGES)


def read_arm(
    file: Path,
    *,
    base: str | None = None,
    tcp: str | None = None,
    packages: Mapping[str, Path] | None = None,
    text: bytes | None = None,
    meshes: bool = True,
) -> ArmModel:
    """Return the arm between two links of a URDF.

    The arm has three to eight turning joints and any number of fixed joints.

    Args:
        file: The URDF.
        base: The link that does not move. None means the only link that is not the child of a joint.
        tcp: The link at the end of the arm. None means the only link that is not the parent of a joint.
        packages: The folder of each NAME in package://NAME/PATH. The function seeks other packages in the
            URDF's folder and the folders above it, as NAME/PATH, then as PATH.
        text: The contents of the URDF. None means that the function reads the file.
        meshes: Whether mesh files must exist. If they need not exist, the shape of a missing mesh has no
            ``file``.

    Raises:
        ArmFileError: The file has no such arm, or the arm is unusable. The error states file and line.

    """
    text = read_bytes(file) if text is None else text
    urdf = Urdf.read(file, text)
    base, tcp, joints = urdf.chain(base, tcp)
    origins: list[NDArray[np.float64]] = []
    moving, since = [], list[NDArray[np.float64]]()  # the frames since the last moving joint
    for joint in joints:
        since.append(urdf.origin(joint))
        if joint.get("type") != "fixed":
            moving.append(joint)
            origins.append(reduce(product, since))
            since = []
    data = [joint_data(urdf, joint) for joint in moving]
    if not FEWEST <= len(moving) <= MOST:
        expected = f"{FEWEST} to {MOST} turning joints from {base!r} to {tcp!r}"
        raise urdf.error(urdf.links[tcp], expected, str(len(moving)))
    axes = np.array([numbers.axis for numbers in data])
    names = (base, *(urdf.child(joint, "child").get("link", "") for joint in moving))
    shapes = _Shapes(urdf, names, packages or {}, meshes)
    return ArmModel(
        name=urdf.root.get("name") or file.stem,
        file=file,
        joint_names=tuple(joint.get("name", "") for joint in moving),
        link_names=names,
        tcp_link=tcp,
        joint_origins=np.array(origins),
        # The kernels take axes of length 1, which a URDF need not have.
        joint_axes=axes / np.linalg.norm(axes, axis=1, keepdims=True),
        flange=reduce(product, since) if since else np.eye(4),
        position_lower_rad=np.array([numbers.lower_rad for numbers in data]),
        position_upper_rad=np.array([numbers.upper_rad for numbers in data]),
        velocity_limit_radps=np.array([numbers.speed_radps for numbers in data]),
        effort_limit=np.array([numbers.effort_nm for numbers in data]),
        soft_limits_rad=np.array([numbers.soft_rad for numbers in data]),
        in_degrees=any(numbers.degrees for numbers in data),
        links=shapes.links(),
        left_out=tuple(shapes.left_out),
        without_inertia=tuple(shapes.without_inertia),
        notes=(*(numbers.note for numbers in data if numbers.note), *shapes.notes, *_below(urdf, base)),
        text=text,
        packages=packages or {},
    )


def _below(urdf: Urdf, base: str) -> Iterator[str]:
    """Yield a note for each joint that could move the base, because the model has a fixed base."""
    link, passed = base, {base}
    while (joint := urdf.above.get(link)) is not None and (link := urdf.parent(joint)) not in passed:
        passed.add(link)
        if joint.get("type") != "fixed":
            kind, name = joint.get("type"), joint.get("name")
            yield f"the {kind} joint {name} below {base} is left out: the base stands still"


class _Shapes:
    """A collector of shapes.

    The collector takes the shapes of the links ``names`` and of all links that are fixed to these.
    """

    def __init__(
        self, urdf: Urdf, names: tuple[str, ...], packages: Mapping[str, Path], meshes: bool
    ) -> None:
        self._names, self._found = names, dict[tuple[str, str], list[Shape]]()
        self.left_out, self.without_inertia, self.notes = list[str](), list[str](), list[str]()
        for name, link in urdf.links.items():
            carrier, frames = urdf.carrier(name, names)
            if carrier is None:
                has_shapes = link.find("visual") is not None or link.find("collision") is not None
                self.left_out += [name] if has_shapes else []
                continue
            try:
                inertial(urdf, link)
            except ArmFileError:  # uses that need the inertia report this; the base stands still
                self.without_inertia += [name] if carrier != names[0] else []
            for kind in ("collision", "visual"):
                for part in link.findall(kind):
                    if is_empty(urdf, part):
                        self.notes.append(f"an empty <{kind}> of {name} is left out: its size is 0")
                        continue
                    frame = reduce(product, [*frames, urdf.origin(part)])
                    shape = _shape(urdf, part, frame, packages, meshes)
                    self._found.setdefault((carrier, kind), []).append(shape)

    def links(self) -> tuple[LinkShapes, ...]:
        """Return the base and the moving links, each with its shapes."""
        return tuple(
            LinkShapes(
                link=name,
                index=index,
                collision=tuple(self._found.get((name, "collision"), ())),
                visual=tuple(self._found.get((name, "visual"), ())),
            )
            for index, name in enumerate(self._names)
        )


def is_empty(urdf: Urdf, part: ElementTree.Element) -> bool:
    """Return whether a <collision> or <visual> has size 0, for example a box of size "0 0 0"."""
    for element in urdf.child(part, "geometry"):
        if (keys := SIZES.get(element.tag)) and all(element.get(key) for key in keys.split()):
            sizes = [urdf.numbers(element, key, 3 if key in ("scale", "size") else 1) for key in keys.split()]
            return not np.concatenate(sizes).any()
    return False


def _shape(
    urdf: Urdf,
    part: ElementTree.Element,
    frame: NDArray[np.float64],
    packages: Mapping[str, Path],
    meshes: bool,
) -> Shape:
    """Return the shape in a <collision> or <visual> element.

    ``frame`` (4, 4) transforms from the shape to the link.
    """
    inside = list(urdf.child(part, "geometry"))
    if len(inside) != 1 or inside[0].tag not in SIZES:
        tags = [element.tag for element in inside]
        raise urdf.error(part, f"one shape, a {', '.join(SIZES)}", f"{tags}")
    element, kind = inside[0], inside[0].tag
    if kind == "mesh":
        scale, file = urdf.numbers(element, "scale", 3, "1 1 1"), None
        try:
            file = urdf.mesh_file(element, packages)
        except ArmFileError:
            if meshes:
                raise
        if not np.abs(scale).min() > 0.0:
            raise urdf.error(element, "a scale that leaves something", f"{scale.tolist()}")
        uri = element.get("filename", "")
        return Shape(kind=kind, size=scale, transform_shape_to_link=frame, uri=uri, file=file)
    keys = SIZES[kind].split()
    size = np.concatenate([urdf.numbers(element, key, 3 if kind == "box" else 1) for key in keys])
    if not size.min() > 0.0:
        raise urdf.error(element, "a size above 0", f"{size.tolist()}")
    return Shape(kind=kind, size=size, transform_shape_to_link=frame)


def inertial(
    urdf: Urdf, link: ElementTree.Element
) -> tuple[float, NDArray[np.float64], NDArray[np.float64]] | None:
    """Return a link's mass [kg], the frame (4, 4) of its centre of mass, and its inertia [kg m^2].

    The inertia (3, 3) is about the centre of mass. Return None if the link has no <inertial>. Raise
    ``ArmFileError`` if the stated inertia is impossible for a body of the stated mass. A link without mass
    may have any inertia.
    """
    if link.find("inertial") is None:
        return None
    inertial = urdf.child(link, "inertial")
    frame = urdf.origin(inertial)
    mass = urdf.number(urdf.child(inertial, "mass"), "value")
    inertia = urdf.child(inertial, "inertia")
    xx, xy, xz, yy, yz, zz = (urdf.number(inertia, key) for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"))
    if mass < 0.0:
        raise urdf.error(urdf.child(inertial, "mass"), "a mass of 0 kg or more", f"{mass:g}")
    matrix = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    # No principal moment of a body exceeds the sum of the other two. Some URDFs state such inertias all the
    # same, so up to MOMENT_EXCESS is accepted.
    least, middle, most = eigen(matrix)[0].tolist()
    if mass > 0.0 and not (least > 0.0 and most <= MOMENT_EXCESS * (least + middle)):
        expected = "a possible inertia: moments above 0, the largest hardly above the sum of the two smaller"
        raise urdf.error(inertia, expected, f"{least:.4g}, {middle:.4g}, {most:.4g}")
    return mass, frame, matrix
