"""Link capsules: few simple bodies that enclose every mesh of the arm.

They are fitted once by ``python -m safety_harness.robot.fit_capsules`` and kept as JSON beside
this file.  Distances to capsules are never longer than those to the meshes: the safe side.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from safety_harness.exceptions import ArmModelError
from safety_harness.geometry.arrays import ArrayN
from safety_harness.robot.description import TCP_LINK, ArmModel, ChainRecords, load_arm
from safety_harness.robot.distance import CAPSULE, CapsuleRecords, chain_lengths
from safety_harness.robot.kinematics import FRAMES


@dataclass(frozen=True, eq=False, kw_only=True)
class CapsuleSet:
    """``n`` capsules, each fixed in one frame of forward kinematics; arrays are read-only.

    ``link_index`` (n,) counts base_link as 0, the moving links 1 to 6 and the tcp as 7.
    ``start_in_link`` and ``end_in_link`` (n, 3) [m] are the ends of the axis, in that frame.
    """

    names: tuple[str, ...]
    link_index: NDArray[np.int64]
    start_in_link: NDArray[np.float64]
    end_in_link: NDArray[np.float64]
    radius_m: NDArray[np.float64]

    def __post_init__(self) -> None:
        n = len(self.names)
        if not (
            self.link_index.shape == self.radius_m.shape == (n,)
            and self.start_in_link.shape == self.end_in_link.shape == (n, 3)
        ):
            raise ArmModelError(f"capsules: expected {n} of everything, one for each name")
        if not ((self.link_index >= 0) & (self.link_index < FRAMES)).all():
            raise ArmModelError(f"capsules: link indices must be 0 to {FRAMES - 1}, got {self.link_index}")
        ends = np.concatenate((self.start_in_link, self.end_in_link))
        if not (np.isfinite(ends).all() and np.isfinite(self.radius_m).all() and (self.radius_m > 0.0).all()):
            raise ArmModelError("capsules: ends must be finite and radii finite and positive")
        for array in (self.link_index, self.start_in_link, self.end_in_link, self.radius_m):
            array.setflags(write=False)

    @cached_property
    def records(self) -> CapsuleRecords:
        """(n,) CAPSULE: the same for compiled code, read-only."""
        records = np.zeros(len(self.names), CAPSULE)
        for name in CAPSULE.names or ():
            records[name] = getattr(self, name)
        records.setflags(write=False)
        return records

    def with_capsule(
        self, name: str, link_index: int, start: ArrayLike, end: ArrayLike, radius: float
    ) -> CapsuleSet:
        """A new set with one more capsule (a tool, say) at its end; metres, in the link's frame."""
        return CapsuleSet(
            names=(*self.names, name),
            link_index=np.append(self.link_index, np.int64(link_index)),
            start_in_link=np.vstack((self.start_in_link, np.asarray(start, dtype=np.float64))),
            end_in_link=np.vstack((self.end_in_link, np.asarray(end, dtype=np.float64))),
            radius_m=np.append(self.radius_m, float(radius)),
        )


def capsule_file(arm_name: str) -> Path:
    """Where the fitted capsules of an arm are kept."""
    return Path(__file__).with_name(f"{arm_name}_capsules.json")


@lru_cache
def load_capsules(arm_name: str = "ur10") -> CapsuleSet:
    """The fitted capsules of the arm ``arm_name``; ``ArmModelError`` if none were fitted."""
    file = capsule_file(arm_name)
    if not file.is_file():
        raise ArmModelError(
            f"no capsules for {arm_name!r}; to fit them: "
            f"python -m safety_harness.robot.fit_capsules {arm_name}"
        )
    entries = json.loads(file.read_text(encoding="utf-8"))["capsules"]
    frames = (*load_arm(arm_name).link_names, TCP_LINK)
    return CapsuleSet(
        names=tuple(entry["name"] for entry in entries),
        link_index=np.array([frames.index(entry["link"]) for entry in entries], dtype=np.int64),
        start_in_link=np.array([entry["start_in_link_m"] for entry in entries], dtype=np.float64),
        end_in_link=np.array([entry["end_in_link_m"] for entry in entries], dtype=np.float64),
        radius_m=np.array([entry["radius_m"] for entry in entries], dtype=np.float64),
    )


class Arm(NamedTuple):
    """An arm with everything on it, for a kernel that is called once for a whole trace or way.

    A kernel that is called at every tick takes the records apart: a tuple costs a microsecond a call.
    """

    chain: ChainRecords
    capsules: CapsuleRecords
    reach_m: ArrayN  # of ``chain_lengths``


@lru_cache(maxsize=16)
def arm_with(arm: ArmModel, capsules: CapsuleSet) -> Arm:
    """``arm`` and the capsules on it."""
    return Arm(arm.chain, capsules.records, chain_lengths(arm.chain, capsules.records))
