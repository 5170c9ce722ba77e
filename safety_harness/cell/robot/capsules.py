"""Read the capsules of an arm's links.

The capsules are a few simple bodies that enclose every mesh of the arm.

``safety-harness robot fit`` fits capsules to an arm once and stores them as JSON. The capsules of the shipped
arms lie beside this file. A distance to a capsule is never longer than the distance to the meshes inside. So
a computed distance is never too long.
"""

from __future__ import annotations

import hashlib
from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from safety_harness.base.elementary import product
from safety_harness.base.exceptions import ArmModelError
from safety_harness.base.geometry.arrays import ArrayN
from safety_harness.base.geometry.segments import point_segment_distance
from safety_harness.cell.robot.description import ArmModel, ChainRecords, load_arm
from safety_harness.cell.robot.distance import CAPSULE, CapsuleRecords, chain_lengths
from safety_harness.cell.robot.kinematics import FRAMES
from safety_harness.cell.robot.urdf import ArmFileError, read_bytes


@dataclass(frozen=True, eq=False, kw_only=True)
class CapsuleSet:
    """A set of ``n`` capsules, each fixed in a frame of forward kinematics.

    All arrays are read-only. ``link_index`` (n,) is the number of each capsule's frame. The base has the
    number 0, the moving links follow, and the tcp has the number ``frames`` - 1. ``start_in_link`` and
    ``end_in_link`` (n, 3) [m] are the two ends of each capsule's axis in its frame.
    """

    names: tuple[str, ...]
    link_index: NDArray[np.int64]
    start_in_link: NDArray[np.float64]
    end_in_link: NDArray[np.float64]
    radius_m: NDArray[np.float64]
    frames: int = FRAMES

    def __post_init__(self) -> None:
        n = len(self.names)
        if not (
            self.link_index.shape == self.radius_m.shape == (n,)
            and self.start_in_link.shape == self.end_in_link.shape == (n, 3)
        ):
            raise ArmModelError(f"capsules: expected {n} of everything, one for each name")
        if not ((self.link_index >= 0) & (self.link_index < self.frames)).all():
            raise ArmModelError(
                f"capsules: link indices must be 0 to {self.frames - 1}, got {self.link_index}"
            )
        ends = np.concatenate((self.start_in_link, self.end_in_link))
        if not (np.isfinite(ends).all() and np.isfinite(self.radius_m).all() and (self.radius_m > 0.0).all()):
            raise ArmModelError("capsules: ends must be finite and radii finite and positive")
        for array in (self.link_index, self.start_in_link, self.end_in_link, self.radius_m):
            array.setflags(write=False)

    @cached_property
    def records(self) -> CapsuleRecords:
        """The capsules as read-only records CAPSULE (n,) for compiled code."""
        records = np.zeros(len(self.names), CAPSULE)
        for name in CAPSULE.names or ():
            records[name] = getattr(self, name)
        records.setflags(write=False)
        return records

    def of_links(self, links: Collection[int]) -> CapsuleSet:
        """Return the capsules of the given ``links``.

        The base is link 0.
        """
        kept = [k for k, link in enumerate(self.link_index) if link in links]
        return CapsuleSet(
            names=tuple(self.names[k] for k in kept),
            link_index=self.link_index[kept],
            start_in_link=self.start_in_link[kept],
            end_in_link=self.end_in_link[kept],
            radius_m=self.radius_m[kept],
            frames=self.frames,
        )

    def carried_by(self, link: int, transform: NDArray[np.float64]) -> CapsuleSet:
        """Return the same set, but with the capsules of ``link`` in another frame.

        ``transform`` (4, 4) transforms from the old frame of ``link`` to the new frame.
        """
        mine = (self.link_index == link)[:, None]
        ends = (self.start_in_link, self.end_in_link)
        start, end = (np.where(mine, product(p, transform[:3, :3].T) + transform[:3, 3], p) for p in ends)
        return replace(self, start_in_link=start, end_in_link=end)

    def with_capsule(
        self, name: str, link_index: int, start: ArrayLike, end: ArrayLike, radius: float
    ) -> CapsuleSet:
        """Return a new set with one more capsule at the end, for example for a tool.

        Args:
            name: The capsule's name.
            link_index: The number of the capsule's frame.
            start: The first end of the capsule's axis (3,) [m], in its frame.
            end: The second end of the axis (3,) [m].
            radius: The capsule's radius [m].

        """
        return CapsuleSet(
            names=(*self.names, name),
            link_index=np.append(self.link_index, np.int64(link_index)),
            start_in_link=np.vstack((self.start_in_link, np.asarray(start, dtype=np.float64))),
            end_in_link=np.vstack((self.end_in_link, np.asarray(end, dtype=np.float64))),
            radius_m=np.append(self.radius_m, float(radius)),
            frames=self.frames,
        )


class StoredCapsule(msgspec.Struct, kw_only=True, forbid_unknown_fields=True):
    """A capsule in a file, with the ends of its axis [m] in the frame of ``link``."""

    name: str
    link: str
    start_in_link_m: tuple[float, float, float]
    end_in_link_m: tuple[float, float, float]
    radius_m: float


class StoredCapsules(msgspec.Struct, kw_only=True, forbid_unknown_fields=True):
    """The contents of a capsule file.

    The file states the SHA-256 of the URDF and of each mesh to which the capsules were fitted. The shipped
    files have no hashes, because their meshes lie beside them. A second URDF of the same arm may have these
    capsules as its shapes. ``meshless_urdf_sha256`` is the hash of this second URDF.
    """

    arm: str
    capsules: list[StoredCapsule]
    base: str = ""
    tcp: str = ""
    urdf_sha256: str = ""
    meshes_sha256: dict[str, str] = {}
    meshless_urdf_sha256: str = ""

    def on(self, arm: ArmModel, file: Path) -> CapsuleSet:
        """Return the capsules as a ``CapsuleSet`` of ``arm``.

        Raise ``ArmFileError`` if the capsules belong to links that the arm lacks.
        """
        frames = (*arm.link_names, arm.tcp_link)
        unknown = {body.link for body in self.capsules}.difference(frames)
        if unknown or not self.capsules:
            raise ArmFileError.of_file(file, f"capsules of {', '.join(frames)}", ", ".join(unknown) or "none")
        try:
            return CapsuleSet(
                names=tuple(body.name for body in self.capsules),
                link_index=np.array([frames.index(body.link) for body in self.capsules], dtype=np.int64),
                start_in_link=np.array([body.start_in_link_m for body in self.capsules]),
                end_in_link=np.array([body.end_in_link_m for body in self.capsules]),
                radius_m=np.array([body.radius_m for body in self.capsules]),
                frames=len(frames),
            )
        except ArmModelError as error:
            raise ArmFileError.of_file(file, "capsules that can be", str(error)) from error


def capsule_file(arm_name: str) -> Path:
    """Return the file with the fitted capsules of a shipped arm."""
    return Path(__file__).with_name(f"{arm_name}_capsules.json")


@lru_cache
def load_capsules(arm_name: str = "ur10") -> CapsuleSet:
    """Return the fitted capsules of the shipped arm ``arm_name``.

    Raise ``ArmModelError`` if there are no capsules.
    """
    file = capsule_file(arm_name)
    if not file.is_file():
        raise ArmModelError(f"no capsules for {arm_name!r}; to fit them: safety-harness robot fit")
    return _stored(file).on(load_arm(arm_name), file)


def read_capsules(
    file: Path, arm: ArmModel, *, text: bytes | None = None, urdf_sha256: str | None = None
) -> CapsuleSet:
    """Return the capsules in ``file``, provided that they were fitted to the present ``arm``.

    Args:
        file: The file of capsules.
        arm: The arm.
        text: The contents of the file. None means that the function reads the file.
        urdf_sha256: The hash of the arm's URDF, if the caller knows it. The function then reads neither the
            arm's file nor its meshes.

    Raises:
        ArmFileError: The capsules were fitted to another arm. The error states the difference.

    """
    stored = _stored(file, text)
    pairs = [("base", stored.base, arm.link_names[0]), ("tcp", stored.tcp, arm.tcp_link)]
    found_urdf, meshes = (urdf_sha256, stored.meshes_sha256) if urdf_sha256 else hashes_of(arm)
    meshless = found_urdf == stored.meshless_urdf_sha256
    fitted_to = stored.meshless_urdf_sha256 if meshless else stored.urdf_sha256
    pairs.append((f"{arm.file} with the SHA-256", fitted_to, found_urdf))
    named = meshes if meshless else stored.meshes_sha256
    for uri in sorted(named.keys() | meshes.keys()):
        pairs.append((f"mesh {uri} with the SHA-256", named.get(uri, "none"), meshes.get(uri, "none")))
    # Capsules of another file may be too small for this arm, which no later check would notice.
    for part, fitted_to, is_now in pairs:
        if fitted_to != is_now:
            expected = f"capsules fitted to the {part} {is_now}"
            raise ArmFileError.of_file(file, expected, f"to {fitted_to or 'nothing'}; fit them again")
    capsules, held = stored.on(arm, file), {capsule.link for capsule in stored.capsules}
    for link in arm.links:
        if (link.collision or link.visual) and link.link not in held:
            raise ArmFileError.of_file(file, f"capsules of the link {link.link!r}", "none")
    return capsules


def unenclosed_links(arm: ArmModel, enclosed: Collection[int], accepted: Collection[str] = ()) -> list[str]:
    """Return the names of the links without a capsule.

    The function considers the links between the first and the last link with capsules. ``enclosed`` contains
    the numbers of the links with capsules. The base has the number 0. The result leaves out the names in
    ``accepted``.
    """
    names = arm.link_names
    inner = range(min(enclosed), min(max(enclosed), len(names)))
    return [names[k] for k in inner if k not in enclosed and names[k] not in accepted]


def tcp_beyond(arm: ArmModel, capsules: CapsuleSet) -> float:
    """Return the distance [m] of the TCP from the nearest capsule at the arm's end, or 0 inside a capsule.

    The function uses the capsules in the TCP's frame and on the last link that has capsules. The function
    assumes that all joints after that link are at position 0.
    """
    point_m, nearest_m = np.zeros(3), np.inf
    frames = enumerate((arm.flange, *arm.joint_origins[::-1], np.eye(4)))
    for link, origin in ((capsules.frames - 1 - k, frame) for k, frame in frames):
        for k in np.flatnonzero(capsules.link_index == link):
            far_m = point_segment_distance(point_m, capsules.start_in_link[k], capsules.end_in_link[k])
            nearest_m = min(nearest_m, far_m - capsules.radius_m[k])
        if link <= len(arm.joint_names) and (capsules.link_index == link).any():
            break
        point_m = product(origin[:3, :3], point_m) + origin[:3, 3]
    return max(0.0, float(nearest_m))


def hashes_of(arm: ArmModel) -> tuple[str, dict[str, str]]:
    """Return the SHA-256 of an arm's URDF and of its meshes.

    The second result maps the name of each mesh in the URDF to its hash.
    """
    shapes = [shape for link in arm.links for shape in (*link.collision, *link.visual)]
    meshes = {shape.uri: _sha256(shape.file) for shape in shapes if shape.file is not None}
    return _sha256(arm.file), meshes


def _sha256(file: Path) -> str:
    """Return the SHA-256 of a file."""
    return hashlib.sha256(read_bytes(file)).hexdigest()


def _stored(file: Path, text: bytes | None = None) -> StoredCapsules:
    """Return the contents of a capsule file.

    If ``text`` is not None, the function uses ``text`` instead of the file.

    Raise ``ArmFileError`` if the contents are invalid.
    """
    try:
        return msgspec.json.decode(read_bytes(file) if text is None else text, type=StoredCapsules)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise ArmFileError.of_file(file, "a file of capsules", str(error)) from error


class Arm(NamedTuple):
    """The compiled records of an arm and its capsules.

    The records are for kernels that run once for a whole trace or path. Kernels that run at every tick take
    the records as separate arguments, because a tuple costs a microsecond per call.
    """

    chain: ChainRecords
    capsules: CapsuleRecords
    reach_m: ArrayN  # of ``chain_lengths``


@lru_cache(maxsize=16)
def arm_with(arm: ArmModel, capsules: CapsuleSet) -> Arm:
    """Return the ``Arm`` that consists of the model ``arm`` and the given ``capsules``."""
    return Arm(arm.chain, capsules.records, chain_lengths(arm.chain, capsules.records))


@lru_cache(maxsize=16)
def tcp_alone(arm: ArmModel) -> Arm:
    """Return the ``Arm`` of the model ``arm`` with a point at the TCP as its only capsule."""
    point = np.zeros(1, CAPSULE)
    point["link_index"] = len(arm.joint_names) + 1
    point.setflags(write=False)
    return Arm(arm.chain, point, chain_lengths(arm.chain, point))
