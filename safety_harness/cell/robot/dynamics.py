"""Compute the torque of each joint for a motion, from the masses in the arm's URDF and a payload."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import compiled, inlined
from safety_harness.base.elementary import product
from safety_harness.base.geometry.arrays import Array3, Array4x4, ArrayN, ArrayNx3, ArrayNx4x4
from safety_harness.cell.robot.description import ArmModel, inertial
from safety_harness.cell.robot.kinematics import links_in_base
from safety_harness.cell.robot.urdf import Urdf

# A choice; PyBullet's world uses the same number, so both worlds compute the same torques.
GRAVITY_MPS2 = 9.81
Triple = tuple[float, float, float]


@lru_cache
def masses_dtype(joints: int) -> np.dtype[Any]:
    """Return the record type for the masses of ``joints`` links, each in the frame of its link."""
    return np.dtype(
        [
            ("mass_kg", np.float64, (joints,)),
            ("centre_m", np.float64, (joints, 3)),  # of mass
            ("inertia_kgm2", np.float64, (joints, 3, 3)),  # about it
        ],
        align=True,
    )


def link_masses(arm: ArmModel, payload_kg: float = 0.0, payload_in_link_m: Array3 | None = None) -> np.void:
    """Return the record of the moving links' masses.

    A link includes everything that is fixed to it. A link without mass has no inertia, even if the URDF
    states one.

    Args:
        arm: The arm.
        payload_kg: A point mass that the last link carries.
        payload_in_link_m: The position of the payload (3,) in the frame of the last link. None means that
            there is no payload.

    Raises:
        ArmFileError: A moving link has no mass.

    """
    n, urdf = len(arm.joint_names), Urdf.read(arm.file, arm.text)
    mass, first, second = np.zeros(n), np.zeros((n, 3)), np.zeros((n, 3, 3))  # the moments about its origin
    for name, link in urdf.links.items():
        carrier, frames = urdf.carrier(name, arm.link_names)
        if carrier in (None, arm.link_names[0]) or (link_inertial := inertial(urdf, link)) is None:
            continue
        k = arm.link_names.index(str(carrier)) - 1
        kg, pose, inertia = link_inertial
        for frame in reversed(frames):
            pose = product(frame, pose)
        # Moments of mass about the link's origin simply add up. The parallel axis theorem (``_spread``) moves
        # them there, and below from there to the centre of mass.
        mass[k] += kg
        first[k] += kg * pose[:3, 3]
        if kg > 0.0:
            second[k] += product(product(pose[:3, :3], inertia), pose[:3, :3].T) + kg * _spread(pose[:3, 3])
    for name in np.array(arm.link_names[1:])[~(mass > 0.0)]:
        link = urdf.links[str(name)]
        raise urdf.error(link, "an <inertial> with a mass, for the torques of the drives", "none")
    if payload_in_link_m is not None:
        mass[-1] += payload_kg
        first[-1] += payload_kg * payload_in_link_m
        second[-1] += payload_kg * _spread(payload_in_link_m)
    masses: np.void = np.zeros(1, masses_dtype(n))[0]
    masses["mass_kg"], masses["centre_m"] = mass, first / mass[:, None]
    for k, centre in enumerate(masses["centre_m"]):
        masses["inertia_kgm2"][k] = second[k] - mass[k] * _spread(centre)
    return masses


def _spread(at_m: Array3) -> NDArray[np.float64]:
    """Return the inertia (3, 3) of a point mass of 1 kg at ``at_m`` (3,), relative to the origin."""
    return float(product(at_m, at_m)) * np.eye(3) - np.outer(at_m, at_m)


@compiled
def joint_torques(
    joint_axes: ArrayNx3,
    transforms: ArrayNx4x4,
    masses: Any,  # one of ``masses_dtype``
    velocity_radps: ArrayN,
    acceleration_radps2: ArrayN,
    torques_out: ArrayN,
) -> None:
    """Fill ``torques_out`` (n,) [N m] with M(q) q'' + C(q, q') q' + g(q), by recursive Newton-Euler.

    All vectors are in the base frame, whose z points up. An upward acceleration g of the base stands for
    gravity. The first pass goes outwards from the base. The angular velocity of link i is w_i = w_(i-1) + a_i
    q'_i. The origin of link i has the same acceleration as if it were a point of link i - 1. At the link's
    centre of mass c, the force is m c'' and the moment I w' + w x I w. The second pass adds forces and
    moments inwards from the TCP. The torque of joint i is the component of the total moment along the joint's
    axis a_i. (Luh, Walker and Paul 1980; Lynch and Park, Modern Robotics, 2017, 8.3.)

    ``transforms`` (n + 2, 4, 4) come from ``forward_kinematics``, and ``joint_axes`` has the shape (n, 3).
    """
    n = joint_axes.shape[0]
    axes, forces, moments = np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 3))
    turn, turn_change, accel = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, GRAVITY_MPS2)
    # Outwards: the motion of each link, then the force and the moment that this motion needs.
    for k in range(n):
        pose, rate = transforms[k + 1], velocity_radps[k]
        accel = _plus(accel, 1.0, _carried(turn, turn_change, _from_to(transforms, k, k + 1)))
        axis = _turned(pose, joint_axes[k])
        turn_change = _plus(turn_change, rate, _cross(turn, axis))
        turn_change = _plus(turn_change, acceleration_radps2[k], axis)
        turn = _plus(turn, rate, axis)
        centre = _turned(pose, masses.centre_m[k])
        at_centre = _plus(accel, 1.0, _carried(turn, turn_change, centre))
        force = _plus((0.0, 0.0, 0.0), masses.mass_kg[k], at_centre)
        moment = _plus(_cross(centre, force), 1.0, _inertia_times(pose, masses.inertia_kgm2[k], turn_change))
        moment = _plus(moment, 1.0, _cross(turn, _inertia_times(pose, masses.inertia_kgm2[k], turn)))
        for i in range(3):
            axes[k, i], forces[k, i], moments[k, i] = axis[i], force[i], moment[i]
    # Inwards: each joint carries its own link and the force and moment of all outer links.
    for k in range(n - 1, -1, -1):
        if k < n - 1:
            passed = (forces[k + 1, 0], forces[k + 1, 1], forces[k + 1, 2])
            levered = _cross(_from_to(transforms, k + 1, k + 2), passed)
            for i in range(3):
                forces[k, i] += passed[i]
                moments[k, i] += moments[k + 1, i] + levered[i]
        torques_out[k] = axes[k, 0] * moments[k, 0] + axes[k, 1] * moments[k, 1] + axes[k, 2] * moments[k, 2]


def holding_torques(arm: ArmModel, masses: np.void, joint_position_rad: ArrayN) -> ArrayN:
    """Return the torques (n,) [N m] that hold an arm still against gravity.

    Args:
        arm: The arm.
        masses: The arm's record from ``link_masses``.
        joint_position_rad: The arm's joint position (n,).

    """
    still, torques = np.zeros((2, len(joint_position_rad)))
    joint_torques(arm.joint_axes, links_in_base(arm, joint_position_rad), masses, still, still, torques)
    return torques


@compiled
def torque_share(bias: ArrayN, wanted: ArrayN, limit: ArrayN) -> float:
    """Return the largest s in [0, 1] for which |bias + s (wanted - bias)| <= limit in every joint.

    All torques are (n,) [N m]. The torques ``bias`` keep the arm in its present motion, and the torques
    ``wanted`` also accelerate the arm. Return 0 if no such s exists. The function ignores a joint whose
    torque is the same for every s.
    """
    least, most = 0.0, 1.0
    for i in range(bias.shape[0]):
        # The torque is linear in s, so each joint allows an interval of s. The intervals are intersected.
        added = wanted[i] - bias[i]
        if added != 0.0:
            at_lower, at_upper = (-limit[i] - bias[i]) / added, (limit[i] - bias[i]) / added
            least, most = max(least, min(at_lower, at_upper)), min(most, max(at_lower, at_upper))
    return most if least <= most else 0.0


@inlined
def _cross(a: Triple, b: Triple) -> Triple:
    """Return a x b."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inlined
def _plus(a: Triple, factor: float, b: Triple) -> Triple:
    """Return a + factor b."""
    return a[0] + factor * b[0], a[1] + factor * b[1], a[2] + factor * b[2]


@inlined
def _carried(turn: Triple, turn_change: Triple, lever: Triple) -> Triple:
    """Return the acceleration of a point of a body relative to another point of the body.

    The result is w' x r + w x (w x r), in which r is ``lever``.
    """
    return _plus(_cross(turn_change, lever), 1.0, _cross(turn, _cross(turn, lever)))


@inlined
def _from_to(transforms: ArrayNx4x4, k: int, j: int) -> Triple:
    """Return the vector from the origin of frame k to the origin of frame j.

    ``transforms`` has the shape (n + 2, 4, 4).
    """
    a, b = transforms[k], transforms[j]
    return b[0, 3] - a[0, 3], b[1, 3] - a[1, 3], b[2, 3] - a[2, 3]


@inlined
def _turned(pose: Array4x4, vector: Array3) -> Triple:
    """Return a link's vector in the base frame.

    ``vector`` (3,) is in the link's frame, and ``pose`` (4, 4) is the link's pose.
    """
    x, y, z = vector[0], vector[1], vector[2]
    return (
        pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z,
        pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z,
        pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z,
    )


@inlined
def _inertia_times(pose: Array4x4, inertia: NDArray[np.float64], v: Triple) -> Triple:
    """Return the product R I R^T v of a link's inertia and a vector v in the base frame.

    I is ``inertia`` (3, 3), which is in the link's frame. R is the rotation in ``pose`` (4, 4), which is the
    pose of the link.
    """
    # Rotate v into the link's frame, where the inertia is constant, and the product back.
    x = pose[0, 0] * v[0] + pose[1, 0] * v[1] + pose[2, 0] * v[2]
    y = pose[0, 1] * v[0] + pose[1, 1] * v[1] + pose[2, 1] * v[2]
    z = pose[0, 2] * v[0] + pose[1, 2] * v[1] + pose[2, 2] * v[2]
    a = inertia[0, 0] * x + inertia[0, 1] * y + inertia[0, 2] * z
    b = inertia[1, 0] * x + inertia[1, 1] * y + inertia[1, 2] * z
    c = inertia[2, 0] * x + inertia[2, 1] * y + inertia[2, 2] * z
    return (
        pose[0, 0] * a + pose[0, 1] * b + pose[0, 2] * c,
        pose[1, 0] * a + pose[1, 1] * b + pose[1, 2] * c,
        pose[2, 0] * a + pose[2, 1] * b + pose[2, 2] * c,
    )
