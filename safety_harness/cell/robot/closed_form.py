"""Solve inverse kinematics in closed form for arms with the wrist of the UR family.

Joints 2, 3 and 4 of such an arm have parallel axes h. The axis of joint 1 is perpendicular to h. The axis of
joint 5 is perpendicular to h and to the axis of joint 6. Axes 5 and 6 meet, and axis 6 is parallel to h if
all joints are at zero. Vectors are in the frame (h_1, h x h_1, h). The first two axes of this frame span the
plane in which joints 2 to 4 move. A complex number stands for a vector in this plane. E_i is the turn about
joint i, and R the rotation of the pose. w is the vector from joint 1 to the point where axes 5 and 6 meet:

    dot(E_1 h, w) = dot(h, steps between the joints)      gives theta_1, two of them
    R^T E_1 h = (E_5 E_6)^T h                             gives theta_5 and theta_6, two of them
    z = l_2 e^(i theta_2) + l_3 e^(i (theta_2 + theta_3)) + k e^(i psi),   psi = theta_2 + theta_3 + theta_4

The third equation is in the plane. The rotation R and the angles found before determine psi. The equation
then has two solutions, one for each elbow. The angles theta_5 and theta_6 come from sines, not from a cosine,
so they stay accurate near the wrist's singularity. If sin theta_5 vanishes, theta_6 is free. Every psi that
joints 2 and 3 can reach is then a solution. (Hawkins, Analytic inverse kinematics for the Universal Robots,
2013, with the sines.)
"""

from __future__ import annotations

from math import pi
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import inlined, njit_no_nrt
from safety_harness.base.elementary import arccos, arctan2, cos, hypot, product, sin, sin_cos
from safety_harness.base.exceptions import ArmModelError
from safety_harness.base.geometry.arrays import Array3, Array3x3, Array4x4, Array6, ArrayNx6
from safety_harness.cell.robot.description import ArmModel
from safety_harness.cell.robot.kinematics import TCP, links_in_base

PARALLEL = 1e-9  # the largest error of an axis's direction, and of the gap [m] between axes that meet
NEAR_SINE = 1e-4  # |sin theta_5| below which psi corrects a distance that is too long or too short
FREE = 5e-10  # |sin theta_5| below which theta_6 is free: half of the largest difference of an exact pose
EDGE_M = 1e-6  # allowed beyond the reach, which rounding changes by at most this at a singularity
AT_ONCE = 24  # rows: two theta_1, two theta_5, three psi and two elbows

ARM_GEOMETRY = np.dtype(
    [
        ("base_to_plane", np.float64, (3, 3)),
        ("plane_to_tool", np.float64, (3, 3)),
        ("joint_1_in_base", np.float64, (3,)),
        ("wrist_in_tool", np.float64, (3,)),
        ("offset_m", np.float64),
        ("shoulder_m", np.complex128),
        ("upper_m", np.complex128),
        ("lower_m", np.complex128),
        ("wrist_m", np.complex128),
        ("axis_5_rad", np.float64),
        ("sense", np.float64),
        ("lower_rad", np.float64, (6,)),
        ("upper_rad", np.float64, (6,)),
    ],
    align=True,
)
ArmGeometryRecords = NDArray[np.void]  # (1,) ARM_GEOMETRY


class ArmGeometry(Protocol):
    """A record of ARM_GEOMETRY, in the form that compiled code reads.

    Complex numbers are vectors in the plane. ``plane_to_tool`` is the rotation with all joints at zero.
    ``wrist_in_tool`` is the vector from the TCP to the point where axes 5 and 6 meet. The chain of links
    consists of steps from joint 1 to the point where axes 5 and 6 meet. ``offset_m`` is the sum of the steps'
    components along h. The steps in the plane are ``shoulder_m`` (joint 1 to 2), ``upper_m`` (joint 2 to 3)
    and ``lower_m`` (joint 3 to 4). ``wrist_m`` is the step from joint 4 to the point where axes 5 and 6 meet.
    ``axis_5_rad`` is the direction of axis 5 with all joints at zero. ``sense`` is 1 if axis 6 points along h
    with all joints at zero, and -1 if it points against h. ``lower_rad`` and ``upper_rad`` are the position
    limits.
    """

    base_to_plane: Array3x3
    plane_to_tool: Array3x3
    joint_1_in_base: Array3
    wrist_in_tool: Array3
    offset_m: float
    shoulder_m: complex
    upper_m: complex
    lower_m: complex
    wrist_m: complex
    axis_5_rad: float
    sense: float
    lower_rad: Array6
    upper_rad: Array6


def has_closed_form(arm: ArmModel) -> bool:
    """Return whether ``arm`` has six joints and the wrist of the UR family."""
    try:
        arm_geometry(arm)
    except ArmModelError:
        return False
    return True


def arm_geometry(arm: ArmModel) -> ArmGeometryRecords:
    """Return the read-only record ARM_GEOMETRY (1,) of an arm.

    Raise ``ArmModelError`` if the arm does not have the wrist of the UR family.
    """
    if len(arm.joint_names) != 6:
        raise ArmModelError(f"{arm.name}: the closed form is of six joints, not {len(arm.joint_names)}")
    zero = links_in_base(arm, np.zeros(6))
    axes = np.array([product(zero[i + 1, :3, :3], arm.joint_axes[i]) for i in range(6)])
    base_to_plane = np.array([axes[0], np.cross(axes[1], axes[0]), axes[1]])
    axes = product(axes, base_to_plane.T)
    steps = np.diff(zero[:, :3, 3], axis=0)
    inner = product(steps[1:6], base_to_plane.T)
    along_6 = axes[5] * product(inner[4], axes[5])  # moves joint 6 to the point where its axis meets axis 5
    inner[4] -= along_6
    fits = (
        abs(axes[0, 2]) <= PARALLEL  # perpendicular to h, otherwise the frame is not orthonormal
        and np.abs(axes[2:4] - axes[1]).max() <= PARALLEL
        and abs(axes[4, 2]) <= PARALLEL
        and np.abs(axes[5, :2]).max() <= PARALLEL
        and np.abs(np.cross(inner[4], axes[4])).max() <= PARALLEL
    )
    plane = inner[:, 0] + 1j * inner[:, 1]
    if not (fits and abs(plane[1]) > 0.0 and abs(plane[2]) > 0.0):
        raise ArmModelError(f"{arm.name}: its inverse kinematics has no closed form of the UR family")
    geometry = np.zeros(1, ARM_GEOMETRY)
    geometry["base_to_plane"], geometry["plane_to_tool"] = (
        base_to_plane,
        product(base_to_plane, zero[TCP, :3, :3]).T,
    )
    geometry["joint_1_in_base"] = steps[0]
    geometry["wrist_in_tool"] = product(-zero[TCP, :3, :3].T, steps[6] + product(base_to_plane.T, along_6))
    geometry["offset_m"] = inner[:, 2].sum()
    geometry["shoulder_m"], geometry["upper_m"], geometry["lower_m"] = plane[:3]
    geometry["wrist_m"] = plane[3] + plane[4]
    geometry["axis_5_rad"], geometry["sense"] = arctan2(axes[4, 1], axes[4, 0]), np.sign(axes[5, 2])
    geometry["lower_rad"], geometry["upper_rad"] = arm.position_lower_rad, arm.position_upper_rad
    geometry.setflags(write=False)
    return geometry


@njit_no_nrt
def candidate_branches(arm: ArmGeometry, pose: Array4x4, out: ArrayNx6) -> int:
    """Fill ``out`` (AT_ONCE, 6) with joint positions that may give ``pose`` (4, 4).

    Return the number of positions. If the pose is within reach, these positions give the pose up to rounding.
    The function does not check this, and does not wrap angles. At a singularity, it repeats some positions.
    The positions are in the order of theta_1, then theta_5, then psi, then theta_3.
    """
    wx, wy, wz = _wrist(arm, pose, 0), _wrist(arm, pose, 1), _wrist(arm, pose, 2)
    radius = hypot(wy, wz)
    # The wrist cannot enter the cylinder of this radius about axis 1: the arm's plane is that far beside the
    # axis.
    if not radius > max(abs(arm.offset_m) - EDGE_M, 0.0):
        return 0
    half = arccos(min(max(arm.offset_m / radius, -1.0), 1.0))
    along, across = sin_cos(arm.axis_5_rad)
    count = 0
    for side in (-1.0, 1.0):
        theta_1 = arctan2(-wy, wz) + side * half
        s, c = sin_cos(theta_1)
        # u = R^T E_1 h, with its components across axis 5 and along it
        ux = c * _turn(arm, pose, 2, 0) - s * _turn(arm, pose, 1, 0)
        uy = c * _turn(arm, pose, 2, 1) - s * _turn(arm, pose, 1, 1)
        uz = c * _turn(arm, pose, 2, 2) - s * _turn(arm, pose, 1, 2)
        a, b = uy * across - ux * along, arm.sense * (ux * across + uy * along)
        theta_6 = arctan2(b, a)
        # E_2 E_3 E_4 h_5 = E_1^T R E_6^T h_5 lies in the plane, at psi from h_5
        gamma = arm.axis_5_rad - arm.sense * theta_6
        sine, cosine = sin_cos(gamma)
        gx = _turn(arm, pose, 0, 0) * cosine + _turn(arm, pose, 0, 1) * sine
        gy = _turn(arm, pose, 1, 0) * cosine + _turn(arm, pose, 1, 1) * sine
        gz = _turn(arm, pose, 2, 0) * cosine + _turn(arm, pose, 2, 1) * sine
        psi = arctan2(c * gy + s * gz, gx) - arm.axis_5_rad
        z = complex(wx, c * wy + s * wz) - arm.shoulder_m
        for sign in (1.0, -1.0):
            theta_5, turned = arctan2(sign * hypot(a, b), uz), 0.5 * (1.0 - sign) * pi
            count = _with_wrist(arm, z, psi + turned, theta_1, theta_5, theta_6 + turned, out, count)
    return count


@njit_no_nrt
def _with_wrist(
    arm: ArmGeometry,
    z: complex,
    psi: float,
    theta_1: float,
    theta_5: float,
    theta_6: float,
    out: ArrayNx6,
    count: int,
) -> int:
    """Append the solutions with the given angles to ``out`` (AT_ONCE, 6), which has ``count`` rows so far.

    Return the new number of rows. Near the singularity, psi is ill conditioned. If joints 2 and 3 cannot
    bridge the distance for ``psi``, the function uses the nearest angle for which they can. At the
    singularity, the function also uses the two angles in the middle of the possible range.
    """
    # The vector k from joint 4 to the wrist is known, so joints 2 and 3 must bridge z - k.
    k = arm.wrist_m * _unit(psi)
    distance, angle_apart = _size(z - k), _direction(k / z)
    upper_m, lower_m = _size(arm.upper_m), _size(arm.lower_m)
    shortest, longest = abs(upper_m - lower_m), upper_m + lower_m
    sine = abs(sin(theta_5))
    # Out of reach, there are two exceptions: psi is ill conditioned, or rounding alone makes the distance too
    # long.
    if shortest <= distance <= longest:
        best = psi
    elif sine < NEAR_SINE:
        angle = _angle_for(z, k, min(max(distance, shortest), longest))
        best = psi - angle_apart + np.copysign(angle, angle_apart)
    elif shortest - EDGE_M <= distance <= longest + EDGE_M:
        best = psi
    else:
        return count
    least, most = max(shortest, abs(_size(z) - _size(k))), min(longest, _size(z) + _size(k))
    middle = _angle_for(z, k, 0.5 * (least + most))
    straight = psi - angle_apart
    for tried in (best, straight + middle, straight - middle):
        y = z - arm.wrist_m * _unit(tried)
        # Law of cosines in the triangle of upper arm, lower arm and y; its two solutions are the elbows.
        bend = (_size(y) ** 2 - upper_m**2 - lower_m**2) / (2.0 * upper_m * lower_m)
        for elbow in (1.0, -1.0):
            theta_3 = elbow * arccos(min(max(bend, -1.0), 1.0))
            theta_3 += _direction(arm.upper_m) - _direction(arm.lower_m)
            theta_2 = _direction(y) - _direction(arm.upper_m + arm.lower_m * _unit(theta_3))
            out[count, 0], out[count, 1], out[count, 2] = theta_1, theta_2, theta_3
            out[count, 3], out[count, 4] = tried - theta_2 - theta_3, theta_5
            # At the singularity axes 4 and 6 are parallel, so joint 6 undoes the change of psi.
            out[count, 5] = theta_6 + (psi - tried) * arm.sense * np.sign(cos(theta_5))
            count += 1
        if sine > FREE:
            break
    return count


@inlined
def _turn(arm: ArmGeometry, pose: Array4x4, i: int, j: int) -> float:
    """Return entry (i, j) of the rotation from the zero position to ``pose`` (4, 4), in the plane's frame."""
    total = 0.0
    for m in range(3):
        for n in range(3):
            total += arm.base_to_plane[i, m] * pose[m, n] * arm.plane_to_tool[n, j]
    return total


@inlined
def _wrist(arm: ArmGeometry, pose: Array4x4, i: int) -> float:
    """Return entry i of the vector [m] from joint 1 to the point where axes 5 and 6 meet.

    The vector is in the plane's frame. ``pose`` (4, 4).
    """
    total = 0.0
    for m in range(3):
        entry = pose[m, 3] - arm.joint_1_in_base[m]
        for n in range(3):
            entry += pose[m, n] * arm.wrist_in_tool[n]
        total += arm.base_to_plane[i, m] * entry
    return total


@inlined
def _angle_for(z: complex, k: complex, distance: float) -> float:
    """Return the angle between z and k at which |z - k| is as near to ``distance`` as possible."""
    cosine = (_size(z) ** 2 + _size(k) ** 2 - distance * distance) / (2.0 * _size(z) * _size(k))
    return float(arccos(min(max(cosine, -1.0), 1.0)))


@inlined
def _size(z: complex) -> float:
    """Return the length of a vector in the plane."""
    return float(hypot(z.real, z.imag))


@inlined
def _direction(z: complex) -> float:
    """Return the angle of a vector in the plane."""
    return float(arctan2(z.imag, z.real))


@inlined
def _unit(angle_rad: float) -> complex:
    """Return the unit vector at an angle in the plane."""
    s, c = sin_cos(angle_rad)
    return complex(c, s)
