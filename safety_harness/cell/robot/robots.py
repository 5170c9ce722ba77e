"""Make the model, capsules, drives and inverse kinematics of a scenario's arm.

The functions cache their results.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache, update_wrapper
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.elementary import product
from safety_harness.base.exceptions import Place
from safety_harness.base.geometry.rotations import rotation_from_vector
from safety_harness.base.geometry.transforms import inverse_transform, transform_from
from safety_harness.cell.robot.capsules import (
    CapsuleSet,
    load_capsules,
    read_capsules,
    tcp_beyond,
    unenclosed_links,
)
from safety_harness.cell.robot.description import ArmModel, load_arm, read_arm, urdf_file
from safety_harness.cell.robot.drive import DriveModel
from safety_harness.cell.robot.dynamics import link_masses
from safety_harness.cell.robot.inverse import InverseKinematics
from safety_harness.cell.robot.joint_data import Use
from safety_harness.cell.robot.urdf import ArmFileError
from safety_harness.scenario.robots import AnyRobot, EquippedArm, OwnRobot, Piece, Robot, Seat, Tool, YesNo

Made = TypeVar("Made")
# A finger fits into a larger gap.  There, beyond the capsules, may be a part that no distance includes.
TCP_BEYOND_M = 0.02


class _OnceEach(Generic[Made]):
    """A function with a cache.

    The key of the cache is the robot together with the paths of the robot's files. The paths are part of the
    key because the comparison of two robots ignores them.
    """

    def __init__(self, make: Callable[[AnyRobot], Made]) -> None:
        update_wrapper(self, make)
        self._cached = lru_cache(maxsize=16)(lambda robot, files: make(robot))
        self.cache_clear = self._cached.cache_clear

    def __call__(self, robot: AnyRobot) -> Made:
        return self._cached(robot, robot.files if isinstance(robot, OwnRobot) else ())


@_OnceEach
def arm_model(robot: AnyRobot) -> ArmModel:
    """Return the arm in the base frame of the scenario.

    For a user's own arm, the function uses the texts of the arm's files, which a trace contains. So the mesh
    files need not exist. Raise ``ArmFileError`` if a run cannot use the user's arm.
    """
    if isinstance(robot, Robot):
        return load_arm(robot.arm_name)
    if isinstance(robot, EquippedArm):
        arm = load_arm(robot.arm.arm_name)
    else:
        arm = _own(robot, meshes=False)
        arm.require(Use.RUN)
    if robot.tool is not None:
        arm = replace(arm, flange=product(arm.flange, transform_tool(robot.tool)))
    return arm if robot.seat is None else arm.seated(transform_seat(robot.seat))


@_OnceEach
def arm_capsules(robot: AnyRobot) -> CapsuleSet:
    """Return the capsules of the robot's arm.

    Raise ``ArmFileError`` if the capsules belong to another arm.
    """
    if isinstance(robot, Robot):
        return load_capsules(robot.arm_name)
    if isinstance(robot, EquippedArm):
        capsules = load_capsules(robot.arm.arm_name)
    else:
        capsules = read_capsules(
            robot.files[1], arm_model(robot), text=robot.capsules_text, urdf_sha256=str(robot.urdf_sha256)
        )
    tcp = capsules.frames - 1
    if robot.tool is not None:
        to_tcp = inverse_transform(transform_tool(robot.tool))
        capsules = _with_pieces(capsules, "tool", robot.tool.pieces).carried_by(tcp, to_tcp)
    if robot.seat is not None:
        capsules = capsules.carried_by(0, transform_seat(robot.seat))
    return _with_pieces(capsules, "part", robot.part or ())


@_OnceEach
def drive_model(robot: AnyRobot) -> DriveModel | None:
    """Return the dynamics of the drives of a user's arm, or None if the drives follow a demand at once.

    Raise ``ArmFileError`` if the drives' torques are limited but a link has no mass.
    """
    if not isinstance(robot, OwnRobot) or robot.drives is None:
        return None
    drives, model = robot.drives, DriveModel(dead_time_s=robot.drives.dead_time_s, lag_s=robot.drives.lag_s)
    if drives.torque_limit is None:
        return model
    arm, carried = _own(robot, meshes=False), drives.payload
    arm.require(Use.TORQUES)
    masses = link_masses(arm)
    if carried is not None:
        at_m = product(arm.flange[:3, :3], np.array(carried.centre_m)) + arm.flange[:3, 3]
        masses = link_masses(arm, carried.mass_kg, at_m)
    return replace(model, torque_limit_nm=drives.torque_limit * arm.effort_limit, masses=masses)


def transform_seat(seat: Seat) -> NDArray[np.float64]:
    """Return the transform (4, 4) from the arm's base link to the base frame.

    The rotation is Rz(yaw) R(tilt), and the translation is the seat's position.
    """
    turn = rotation_from_vector(np.array([0.0, 0.0, seat.yaw_rad]))
    return transform_from(
        product(turn, rotation_from_vector(np.array(seat.tilt_rad))), np.array(seat.position_in_base_m)
    )


def transform_tool(tool: Tool) -> NDArray[np.float64]:
    """Return the transform (4, 4) from the TCP to the frame of the link that carries the tool."""
    return transform_from(rotation_from_vector(np.array(tool.tilt_rad)), np.array(tool.position_m))


def _with_pieces(capsules: CapsuleSet, name: str, pieces: Sequence[Piece]) -> CapsuleSet:
    for number, piece in enumerate(pieces, start=1):
        ends = piece.start_m, piece.end_m
        capsules = capsules.with_capsule(f"{name} {number}", capsules.frames - 1, *ends, piece.radius_m)
    return capsules


@_OnceEach
def inverse_kinematics(robot: AnyRobot) -> InverseKinematics:
    """Return the inverse kinematics of the arm."""
    return InverseKinematics(arm_model(robot))


@_OnceEach
def refuse_unfit(robot: AnyRobot) -> None:
    """Raise ``ArmFileError`` if the URDF of a user's arm has changed since the program read the scenario.

    The function raises the same error if the capsules were fitted to other meshes. The function also raises
    each error that ``refuse_unenclosed`` raises.
    """
    refuse_unenclosed(robot)
    if not isinstance(robot, OwnRobot):
        return
    sha256 = _sha256_of(robot.files[0])
    if sha256 != robot.urdf_sha256:
        expected = f"the URDF that the scenario was read with (sha256 {str(robot.urdf_sha256)[:12]}...)"
        got = "a file that has changed since" if sha256 else "no file of that name"
        raise ArmFileError.of_file(robot.files[0], expected, got)
    read_capsules(robot.files[1], _own(robot, meshes=True), text=robot.capsules_text)


@_OnceEach
def refuse_unenclosed(robot: AnyRobot) -> None:
    """Raise ``ArmFileError`` if a link has no capsule, or if the TCP is too far from all capsules.

    The user can accept both conditions in the arm's file.
    """
    if isinstance(robot, Robot):
        return
    arm, capsules = arm_model(robot), arm_capsules(robot)
    accepted: Sequence[str] = ()
    place = Place(field="robot")
    if isinstance(robot, OwnRobot):
        accepted = robot.without_geometry or ()
        place = Place(file=(robot.files or (None,))[-1], field="robot")
    beyond_mm = 1e3 * tcp_beyond(arm, capsules)
    most_mm = 1e3 * (TCP_BEYOND_M if robot.tcp_beyond_m is None else robot.tcp_beyond_m)
    if links := ", ".join(unenclosed_links(arm, capsules.link_index.tolist(), accepted)):
        expected, got = "capsules of every link between others that have them", f"none of {links}"
        hint = f"without geometry: [{links}] accepts that distances ignore them"
    elif beyond_mm > most_mm:
        expected = f"a TCP within {most_mm:g} mm of a capsule of the arm, its tool or its part"
        got, accepts = f"one {beyond_mm:.1f} mm away", f"tcp beyond capsules: {np.ceil(beyond_mm):.0f} mm"
        hint = f"add capsules for the whole tool, or state {accepts} if no solid part reaches the TCP"
    else:
        return
    raise ArmFileError(place=place, expected=expected, got=got, hint=hint)


@_OnceEach
def urdf_sha256_of(robot: AnyRobot) -> str:
    """Return the SHA-256 of the arm's URDF."""
    if isinstance(robot, OwnRobot):
        return str(robot.urdf_sha256)
    return _sha256_of(urdf_file((robot if isinstance(robot, Robot) else robot.arm).arm_name))


def _sha256_of(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest() if file.is_file() else ""


def _own(robot: OwnRobot, *, meshes: bool) -> ArmModel:
    """Return the arm of a user's URDF.

    Limits in the arm's file replace the limits in the URDF.
    """
    arm = read_arm(
        robot.files[0],
        base=robot.base,
        tcp=robot.tcp,
        text=robot.urdf_text,
        meshes=meshes,
    )
    speeds, torques = robot.joint_speed_limits_radps, robot.joint_torque_limits_nm
    if speeds is not None:
        arm = replace(arm, velocity_limit_radps=_of_each(arm, "joint speed limits", speeds))
    if torques is not None:
        arm = replace(arm, effort_limit=_of_each(arm, "joint torque limits", torques))
    if robot.angles is not None:
        arm = replace(arm, in_degrees=False)
    return _softly_limited(arm) if robot.soft_limits is YesNo.YES else arm


def _of_each(arm: ArmModel, key: str, numbers: tuple[float, ...]) -> NDArray[np.float64]:
    """Return ``numbers`` as an array (n,), one for each joint.

    Raise an ``ArmFileError`` that states ``key`` if the number of entries differs from the number of joints.
    """
    if len(numbers) != len(arm.joint_names):
        expected = f"{key} of its {len(arm.joint_names)} joints"
        raise ArmFileError.of_file(arm.file, expected, str(len(numbers)))
    return np.array(numbers)


def _softly_limited(arm: ArmModel) -> ArmModel:
    """Return the same arm, but with position limits that also respect its <safety_controller>."""
    lower, upper = arm.soft_limits_rad.T
    if np.isnan(lower).all():
        expected = "a <safety_controller> with soft limits"
        raise ArmFileError.of_file(arm.file, expected, "none", "drop `soft limits`")
    return replace(
        arm,
        position_lower_rad=np.fmax(arm.position_lower_rad, lower),
        position_upper_rad=np.fmin(arm.position_upper_rad, upper),
    )
