"""Compute forward kinematics, geometric Jacobian, distance to singularity and joint velocities.

Frame 0 is the base, frames 1 to n are the links that n joints move, and frame n + 1 is the tcp. The functions
take the number of joints from the arrays and from the type of a chain's record.
"""

from __future__ import annotations

from math import sqrt

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import compiled, inlined, njit_no_nrt
from safety_harness.base.geometry.arrays import (
    Array2x3,
    Array3,
    Array4x4,
    Array6,
    Array6x6,
    Array6xN,
    ArrayN,
    ArrayNx3,
    ArrayNx4x4,
)
from safety_harness.base.geometry.linear import invert_with, solve_in_place
from safety_harness.base.geometry.rotations import rotation_entries
from safety_harness.cell.robot.description import ArmModel, Chain

FRAMES = 8  # frames of an arm with six joints
TCP = 7
TWIST = 6  # numbers of a twist (v, w): the rows of a Jacobian


@njit_no_nrt
def forward_kinematics(chain: Chain, joint_position_rad: ArrayN, transforms_out: ArrayNx4x4) -> None:
    """Fill ``transforms_out`` (n + 2, 4, 4) with link-to-base transforms: base, n links, tcp.

    T_0 = I, T_i = T_(i-1) O_i R(a_i, q_i) and T_(n+1) = T_n F are the products of transforms along the chain
    of a URDF. Here O is ``chain.joint_origins`` (n, 4, 4) [m], a is ``chain.joint_axes`` (n, 3), F is
    ``chain.flange`` (4, 4), and q is ``joint_position_rad`` (n,). (Lynch and Park, Modern Robotics, 2017,
    4.2.)
    """
    n = chain.joint_axes.shape[0]
    for i in range(4):
        for j in range(4):
            transforms_out[0, i, j] = 1.0 if i == j else 0.0
    for joint in range(n):
        _compose(transforms_out, joint, chain.joint_origins[joint])
        x, y, z = chain.joint_axes[joint, 0], chain.joint_axes[joint, 1], chain.joint_axes[joint, 2]
        r00, r01, r02, r10, r11, r12, r20, r21, r22 = rotation_entries(x, y, z, joint_position_rad[joint])
        k = joint + 1
        # R(a, q) acts on the right: it mixes the columns of the rotation and leaves the position as it is.
        for i in range(3):
            x, y, z = transforms_out[k, i, 0], transforms_out[k, i, 1], transforms_out[k, i, 2]
            transforms_out[k, i, 0] = x * r00 + y * r10 + z * r20
            transforms_out[k, i, 1] = x * r01 + y * r11 + z * r21
            transforms_out[k, i, 2] = x * r02 + y * r12 + z * r22
    _compose(transforms_out, n, chain.flange)


def links_in_base(arm: ArmModel, joint_position_rad: ArrayN) -> ArrayNx4x4:
    """Return the transforms of ``forward_kinematics`` for ``arm``, shape (n + 2, 4, 4).

    ``joint_position_rad`` (n,).
    """
    transforms = np.empty((len(arm.joint_names) + 2, 4, 4))
    forward_kinematics(arm.chain[0], joint_position_rad, transforms)
    return transforms


@inlined
def _compose(transforms: ArrayNx4x4, k: int, inner: Array4x4) -> None:
    """Fill ``transforms[k + 1]`` with ``transforms[k]`` times ``inner`` (4, 4).

    ``transforms`` has the shape (n + 2, 4, 4). The loops use indices, because array views cost time.
    """
    for i in range(3):
        x, y, z = transforms[k, i, 0], transforms[k, i, 1], transforms[k, i, 2]
        for j in range(4):
            transforms[k + 1, i, j] = x * inner[0, j] + y * inner[1, j] + z * inner[2, j]
        transforms[k + 1, i, 3] += transforms[k, i, 3]
        transforms[k + 1, 3, i] = 0.0
    transforms[k + 1, 3, 3] = 1.0


@inlined
def geometric_jacobian(joint_axes: ArrayNx3, transforms: ArrayNx4x4, jacobian_out: Array6xN) -> None:
    """Fill ``jacobian_out`` (6, n), which maps joint velocities to the TCP's twist (v, w) in the base frame.

    Column i is (a_i x (p_tcp - p_i), a_i). Here a_i is the axis of joint i and p_i a point on it, both in the
    base frame. ``transforms`` (n + 2, 4, 4) come from ``forward_kinematics``, and ``joint_axes`` has the
    shape (n, 3).
    """
    for joint in range(joint_axes.shape[0]):
        ax, ay, az, vx, vy, vz = _joint_twist(joint_axes, transforms, joint)
        jacobian_out[0, joint] = vx
        jacobian_out[1, joint] = vy
        jacobian_out[2, joint] = vz
        jacobian_out[3, joint] = ax
        jacobian_out[4, joint] = ay
        jacobian_out[5, joint] = az


@inlined
def tcp_velocity(
    joint_axes: ArrayNx3, transforms: ArrayNx4x4, joint_velocity_radps: ArrayN
) -> tuple[float, float, float]:
    """Return the TCP's velocity [m/s] in the base frame: the Jacobian's first three rows times q' (n,)."""
    x = y = z = 0.0
    for joint in range(joint_axes.shape[0]):
        _, _, _, vx, vy, vz = _joint_twist(joint_axes, transforms, joint)
        x += vx * joint_velocity_radps[joint]
        y += vy * joint_velocity_radps[joint]
        z += vz * joint_velocity_radps[joint]
    return x, y, z


@inlined
def _joint_twist(
    joint_axes: ArrayNx3, transforms: ArrayNx4x4, joint: int
) -> tuple[float, float, float, float, float, float]:
    """Return a joint's axis a and the vector a x (p_tcp - p), in the base frame.

    Here p is a point on the axis. ``joint_axes`` has the shape (n, 3), and ``transforms`` has the shape
    (n + 2, 4, 4).
    """
    link, tcp = transforms[joint + 1], joint_axes.shape[0] + 1
    x, y, z = joint_axes[joint, 0], joint_axes[joint, 1], joint_axes[joint, 2]
    ax = link[0, 0] * x + link[0, 1] * y + link[0, 2] * z
    ay = link[1, 0] * x + link[1, 1] * y + link[1, 2] * z
    az = link[2, 0] * x + link[2, 1] * y + link[2, 2] * z
    dx = transforms[tcp, 0, 3] - link[0, 3]
    dy = transforms[tcp, 1, 3] - link[1, 3]
    dz = transforms[tcp, 2, 3] - link[2, 3]
    return ax, ay, az, ay * dz - az * dy, az * dx - ax * dz, ax * dy - ay * dx


@inlined
def link_twists(
    joint_axes: NDArray[np.float64],  # (joints, 3)
    transforms: NDArray[np.float64],  # (joints + 2, 4, 4)
    rates_radps: NDArray[np.float64],  # (joints,)
    twists: NDArray[np.float64],  # (joints + 1, 6), written
) -> None:
    """Fill ``twists`` with the angular velocity w and the velocity v of each link.

    Here v is the velocity of the link's point at the origin of the base. These velocities are w_j = w_(j-1) +
    q'_j a_j and v_j = v_(j-1) - q'_j a_j x p_j. Here a_j is the axis of joint j and p_j a point on it, in the
    base frame. (Spatial velocities: Featherstone, Rigid Body Dynamics Algorithms, 2008.)
    """
    # The base stands still. Each link adds its own joint's rotation to the twist of the link before it.
    twists[0] = 0.0
    for joint in range(joint_axes.shape[0]):
        frame, own, rate = transforms[joint + 1], joint_axes[joint], rates_radps[joint]
        wx = rate * (frame[0, 0] * own[0] + frame[0, 1] * own[1] + frame[0, 2] * own[2])
        wy = rate * (frame[1, 0] * own[0] + frame[1, 1] * own[1] + frame[1, 2] * own[2])
        wz = rate * (frame[2, 0] * own[0] + frame[2, 1] * own[1] + frame[2, 2] * own[2])
        x, y, z = frame[0, 3], frame[1, 3], frame[2, 3]
        twists[joint + 1, 0] = twists[joint, 0] + wx
        twists[joint + 1, 1] = twists[joint, 1] + wy
        twists[joint + 1, 2] = twists[joint, 2] + wz
        twists[joint + 1, 3] = twists[joint, 3] - (wy * z - wz * y)
        twists[joint + 1, 4] = twists[joint, 4] - (wz * x - wx * z)
        twists[joint + 1, 5] = twists[joint, 5] - (wx * y - wy * x)


@inlined
def point_velocity(twist: Array6, point: Array3) -> tuple[float, float, float]:
    """Return the velocity v + w x p [m/s] of a link's point p = ``point`` (3,).

    The velocity and the point are in the base frame.
    """
    x, y, z = point[0], point[1], point[2]
    return (
        twist[3] + twist[1] * z - twist[2] * y,
        twist[4] + twist[2] * x - twist[0] * z,
        twist[5] + twist[0] * y - twist[1] * x,
    )


@inlined
def fastest_end(twist: Array6, ends: Array2x3) -> float:
    """Return the speed [m/s] of the faster of a link's two points ``ends`` (2, 3)."""
    fastest = 0.0
    for end in range(2):
        x, y, z = point_velocity(twist, ends[end])
        total = x * x + y * y + z * z
        if not total <= fastest:
            fastest = total
    return sqrt(fastest)


@compiled
def smallest_singular_value(jacobian: NDArray[np.float64]) -> float:
    """Return the smallest singular value of ``jacobian`` (m, n), in mixed units of metres and radians.

    One-sided Jacobi rotations (Hestenes 1958) make the columns orthogonal, or the rows if there are fewer
    rows. The lengths of these columns or rows are then the singular values. Small singular values are as
    accurate as large ones. Return NaN if an entry is NaN.
    """
    m, length = min(jacobian.shape), max(jacobian.shape)
    wide = jacobian.shape[1] > jacobian.shape[0]
    columns = np.empty((m, length))  # transposed, so that a column is contiguous
    for i in range(m):
        for j in range(length):
            columns[i, j] = jacobian[i, j] if wide else jacobian[j, i]
    for _ in range(30):  # five sweeps are typical
        rotated = False
        for p in range(m - 1):
            for q in range(p + 1, m):
                alpha = beta = gamma = 0.0
                for k in range(length):
                    alpha += columns[p, k] * columns[p, k]
                    beta += columns[q, k] * columns[q, k]
                    gamma += columns[p, k] * columns[q, k]
                # Two columns whose cosine is below 1e-13 count as orthogonal; rounding allows little less.
                if gamma * gamma <= 1e-26 * alpha * beta:
                    continue
                rotated = True
                # The smaller of the two turns that make the columns orthogonal, for which the sweeps
                # converge.
                zeta = (beta - alpha) / (2.0 * gamma)
                t = (1.0 if zeta >= 0.0 else -1.0) / (abs(zeta) + sqrt(1.0 + zeta * zeta))
                c = 1.0 / sqrt(1.0 + t * t)
                s = c * t
                for k in range(length):
                    x, y = columns[p, k], columns[q, k]
                    columns[p, k] = c * x - s * y
                    columns[q, k] = s * x + c * y
        if not rotated:
            break
    least = np.inf
    for p in range(m):
        squared = 0.0
        for k in range(length):
            squared += columns[p, k] * columns[p, k]
        if not squared >= least:  # true of NaN too, which becomes the result
            least = squared
            if np.isnan(squared):
                break
    return sqrt(least)


@compiled
def is_well_conditioned(jacobian: Array6xN, min_singular_value: float) -> bool:
    """Return whether every singular value of ``jacobian`` (6, n) exceeds ``min_singular_value`` > 0.

    The test takes a tenth of the work of ``smallest_singular_value``. All singular values exceed this bound s
    exactly if J^T J - s^2 I is positive definite, that is, if it has a Cholesky factor. For more than six
    joints the matrix is J J^T - s^2 I. The test is unreliable only for a singular value whose difference from
    s is less than about 1e-15 / s. Return False if an entry is NaN.
    """
    m = min(TWIST, jacobian.shape[1])
    factor = np.empty((m, m))
    for i in range(m):
        for j in range(i + 1):
            total = _product(jacobian, i, j)
            if i == j:
                total -= min_singular_value * min_singular_value
            for k in range(j):
                total -= factor[i, k] * factor[j, k]
            if i > j:
                factor[i, j] = total / factor[j, j]
            # A pivot that is not positive (or NaN) means that the matrix is not positive definite.
            elif total > 0.0:
                factor[i, i] = sqrt(total)
            else:
                return False
    return True


@inlined
def _product(jacobian: Array6xN, i: int, j: int) -> float:
    """Return entry (i, j) of J^T J, or of J J^T if J (6, n) has more columns than rows."""
    total = 0.0
    if jacobian.shape[1] > TWIST:
        for k in range(jacobian.shape[1]):
            total += jacobian[i, k] * jacobian[j, k]
    else:
        for k in range(TWIST):
            total += jacobian[k, i] * jacobian[k, j]
    return total


@compiled
def joint_velocity(
    jacobian: Array6xN,
    twist: Array6,  # v, w in the Jacobian's frame
    min_singular_value: float,
    joint_velocity_out: ArrayN,
) -> bool:
    """Solve J q' = (v, w) for the joint velocities q'.

    If a singular value is below ``min_singular_value``, return False and set q' to zero. J comes from
    ``geometric_jacobian``. The velocity v [m/s] and the angular velocity w [rad/s] are in the same frame as
    J. The joint velocities q' are in rad/s. The function computes 1/|J^-1|_F, which never exceeds the least
    singular value. Only if this number is below the bound, the function computes the singular value itself.
    For an arm with fewer or more than six joints, the function uses ``_pseudo_inverse_velocity``.
    """
    scratch = np.empty((TWIST, TWIST))
    return joint_velocity_with(jacobian, twist, min_singular_value, scratch, joint_velocity_out)


@njit_no_nrt
def joint_velocity_with(
    jacobian: Array6xN,
    twist: Array6,  # v, w in the Jacobian's frame
    min_singular_value: float,
    scratch: Array6x6,  # overwritten
    joint_velocity_out: ArrayN,
) -> bool:
    """Fill ``joint_velocity_out`` as ``joint_velocity`` does.

    ``scratch`` is a working array. The allocation of a new array would take as much time as the computation.
    """
    if jacobian.shape[1] != TWIST:
        return _pseudo_inverse_velocity(jacobian, twist, min_singular_value, joint_velocity_out)
    n, inverse = TWIST, scratch  # a constant n, so that the compiler unrolls the loops
    regular = invert_with(jacobian, n, inverse)
    norm2 = 0.0
    for i in range(n):
        for j in range(n):
            norm2 += inverse[i, j] * inverse[i, j]
    # The Frobenius norm comes with the inverse. Only if it leaves a doubt, compute the singular value itself.
    if regular and not norm2 * min_singular_value * min_singular_value <= 1.0:
        regular = np.isfinite(norm2) and smallest_singular_value(jacobian) > min_singular_value
    for i in range(n):
        total = 0.0
        for j in range(n):
            total += inverse[i, j] * twist[j]
        joint_velocity_out[i] = total if regular else 0.0
    return regular


@compiled
def _pseudo_inverse_velocity(
    jacobian: Array6xN, twist: Array6, min_singular_value: float, joint_velocity_out: ArrayN
) -> bool:
    """Fill ``joint_velocity_out`` with q' = J^+ (v, w), for an arm with fewer or more than six joints.

    The pseudoinverse J^+ has no damping. For more than six joints, q' is J^T (J J^T)^-1 (v, w), which has the
    least norm of all solutions of J q' = (v, w). For fewer joints, the arm cannot execute every twist. The
    result is then q' = (J^T J)^-1 J^T (v, w), whose twist is nearest in a norm that mixes metres and radians.
    Golub and Van Loan describe the pseudoinverse (2013, section 5.5). Near a singularity, return False and
    set q' to zero.
    """
    n = jacobian.shape[1]
    m = min(TWIST, n)
    matrix, solution = np.empty((m, m)), np.empty(m)
    for i in range(m):
        for j in range(m):
            matrix[i, j] = _product(jacobian, i, j)
        solution[i] = twist[i] if n > m else _back(jacobian, i, twist)
    regular = is_well_conditioned(jacobian, min_singular_value) and solve_in_place(matrix, solution)
    for i in range(n):
        total = _back(jacobian, i, solution) if n > m else solution[i]
        joint_velocity_out[i] = total if regular else 0.0
    return regular


@inlined
def _back(jacobian: Array6xN, i: int, vector: Array6) -> float:
    """Return entry i of J^T times ``vector`` (6,).

    J has the shape (6, n).
    """
    total = 0.0
    for k in range(TWIST):
        total += jacobian[k, i] * vector[k]
    return total
