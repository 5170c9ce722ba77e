"""Read the axis and the limits of a URDF's turning joint, and note the numbers that are unknown.

A URDF for display leaves out some numbers or sets them to 0. Most files of industrial arms do so for efforts
and speeds. Here such a number is unknown (NaN), and a command that needs the number asks the user to state it
(``Lack``). The specification of the URDF's <joint> element states defaults for the axis and for the lower and
upper limit.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.elementary import length
from safety_harness.cell.robot.urdf import LARGEST, Urdf

NO_LIMIT = 1e3  # rad, rad/s: exporters write such numbers for "no limit"
DEGREES = (90.0, 180.0, 270.0, 360.0)  # such position limits are degrees if the speed exceeds ...
FAST_RADPS = 30.0
# Exporters write huge numbers for "no limit"; up to this one they are read and then clipped to LARGEST.
LARGEST_LIMIT = 1e300


class Use(StrEnum):
    """A use that needs certain numbers of an arm."""

    RUN = "a run"
    TORQUES = "drives with a torque limit"
    PHYSICS = "a world with motors (PyBullet, MuJoCo)"


@dataclass(frozen=True)
class Lack:
    """A quantity that an arm's URDF does not state.

    ``uses`` are the uses that need it, and ``supply`` explains how the user can state it.
    """

    what: str
    uses: tuple[Use, ...]
    supply: str


@dataclass(frozen=True, eq=False, kw_only=True)
class JointData:
    """A turning joint.

    Unknown numbers are NaN. A continuous joint has the limits -inf and inf. ``axis`` (3,) may have any length
    above 0. ``soft_rad`` (lower, upper) are the limits of <safety_controller>. ``degrees`` states whether the
    position limits look like degrees.
    """

    axis: NDArray[np.float64]
    lower_rad: float
    upper_rad: float
    speed_radps: float
    effort_nm: float
    soft_rad: tuple[float, float]
    degrees: bool
    note: str


def joint_data(urdf: Urdf, joint: Element) -> JointData:
    """Return the data of a turning joint.

    Raise ``ArmFileError`` if the joint has another type, is a mimic joint, or has impossible limits.
    """
    kind = joint.get("type")
    if kind not in ("revolute", "continuous"):
        raise urdf.error(joint, "revolute, continuous or fixed joints in the arm", f"{kind!r}")
    if (mimic := joint.find("mimic")) is not None:
        raise urdf.error(
            mimic, "a joint that moves by itself", f"{joint.get('name')!r}, which mimics another"
        )
    axis = np.array([1.0, 0.0, 0.0])
    if joint.find("axis") is not None:
        axis = urdf.numbers(urdf.child(joint, "axis"), "xyz", 3)
        if not length(axis) > 1e-6:
            raise urdf.error(urdf.child(joint, "axis"), "an axis that has a direction", f"{axis.tolist()}")
    lower, upper, speed, effort, note = -np.inf, np.inf, np.nan, np.nan, ""
    if kind == "revolute" or joint.find("limit") is not None:
        limit = urdf.child(joint, "limit")
        speed, effort = (_known(urdf, limit, key) for key in ("velocity", "effort"))
        speed = np.nan if speed > NO_LIMIT else speed
        if kind == "revolute":
            lower, upper = _ends(urdf, limit)
        elif {"lower", "upper"} & set(limit.keys()):
            note = f"{joint.get('name')} is continuous: its lower and upper limit are not used"
    degrees = not speed <= FAST_RADPS and (abs(lower) in DEGREES or abs(upper) in DEGREES)
    return JointData(
        axis=axis,
        lower_rad=lower,
        upper_rad=upper,
        speed_radps=speed,
        effort_nm=effort,
        soft_rad=_soft_limits(urdf, joint),
        degrees=degrees,
        note=note,
    )


def _known(urdf: Urdf, limit: Element, key: str) -> float:
    """Return the speed or effort ``key`` of a <limit>, or NaN if it is unknown.

    A missing number or 0 means that the quantity is unknown.
    """
    number = urdf.number(limit, key, "0")
    if number < 0.0:
        raise urdf.error(limit, f"{key} 0, which is unknown, or above", f"{number:g}")
    return number or np.nan


def _ends(urdf: Urdf, limit: Element) -> tuple[float, float]:
    """Return the lower and the upper position limit [rad], clipped to ``LARGEST``.

    If the lower limit is below -``NO_LIMIT`` and the upper limit is above ``NO_LIMIT``, return -inf and inf.
    """
    lower, upper = (float(urdf.numbers(limit, key, 1, "0", LARGEST_LIMIT)[0]) for key in ("lower", "upper"))
    if not lower < upper:
        raise urdf.error(limit, "a lower limit below the upper one", f"{lower:g} and {upper:g}")
    if lower < -NO_LIMIT and upper > NO_LIMIT:
        return -np.inf, np.inf
    return max(lower, -LARGEST), min(upper, LARGEST)


def _soft_limits(urdf: Urdf, joint: Element) -> tuple[float, float]:
    """Return the position limits [rad] of <safety_controller>, or NaN if it states no limits."""
    if joint.find("safety_controller") is None:
        return np.nan, np.nan
    controller = urdf.child(joint, "safety_controller")
    lower, upper = (urdf.number(controller, f"soft_{end}_limit", "0") for end in ("lower", "upper"))
    return (lower, upper) if lower < upper else (np.nan, np.nan)
