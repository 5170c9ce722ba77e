"""Branches of a UR arm near its wrist singularity, where the axes of joints 2, 3, 4 and 6 are parallel.

With h the common axis of joints 2 to 4, E_i the turn about joint i, R the rotation of the pose and w the
place of joint 6 seen from joint 1:

    (E_1 h) . w = h . (steps between the joints)          gives theta_1, two of them
    R^T E_1 h = (E_5 E_6)^T h                             gives theta_5 and theta_6, from sines, not a cosine
    z = l_2 e^(i theta_2) + l_3 e^(i (theta_2 + theta_3)) + k e^(i psi),   psi = theta_2 + theta_3 + theta_4

the last in the plane across h, with psi what R leaves.  (Hawkins, Analytic inverse kinematics for the
Universal Robots, 2013, with the sines.)  Where sin theta_5 vanishes theta_6 is free: any psi for which
joints 2 and 3 reach is an answer.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from safety_harness.compiled import compiled
from safety_harness.geometry.arrays import Array3, Array3x3, Array6x3

NEAR = 1e-4  # |sin theta_5| below which these are the branches
FREE = 5e-10  # below which theta_6 is free: half of the largest difference of an exact pose
AT_ONCE = 24  # for two theta_1, two theta_5, three psi and two elbows


@compiled
def _turned(axis: Array3, angle: float, vector: Array3) -> NDArray[np.float64]:
    """``vector`` (3,) turned about the unit ``axis`` (3,)."""
    turned: NDArray[np.float64] = np.cos(angle) * vector + np.sin(angle) * np.cross(axis, vector)
    turned += (1.0 - np.cos(angle)) * np.sum(axis * vector) * axis
    return turned


@compiled
def wrist_branches(
    axes: Array6x3,  # of the joints at zero, in the base frame
    steps: NDArray[np.float64],  # (7, 3) from the base to joint 1, from each to the next, and to the TCP
    rotation: Array3x3,  # of the pose, relative to that at zero
    position: Array3,  # of the pose
    out: NDArray[np.float64],  # (AT_ONCE, 6), written
) -> int:
    """Fill the branches with |sin theta_5| < NEAR, not yet checked, and return how many there are."""
    h1, h, h5, h6 = axes[0], axes[1], axes[4], axes[5]
    sense = np.sum(h6 * h)  # 1 or -1
    v = np.cross(h5, h)
    across = np.cross(h, h1)
    w = position - steps[0]
    for i in range(3):
        w[i] -= np.sum(rotation[i] * steps[6])
    offset = 0.0
    for k in range(1, 6):
        offset += np.sum(h * steps[k])
    ahead, aside = np.sum(h * w), np.sum(np.cross(h1, h) * w)
    radius = np.hypot(ahead, aside)
    if not radius > 0.0:
        return 0
    half = np.arccos(min(max(offset / radius, -1.0), 1.0))
    l2 = np.sum(h1 * steps[2]) + 1j * np.sum(across * steps[2])
    l3 = np.sum(h1 * steps[3]) + 1j * np.sum(across * steps[3])
    k = np.sum(h1 * (steps[4] + steps[5])) + 1j * np.sum(across * (steps[4] + steps[5]))
    shortest, longest = abs(abs(l2) - abs(l3)), abs(l2) + abs(l3)
    psis = np.empty(3)
    count = 0
    for side in (-1.0, 1.0):
        theta1 = np.arctan2(aside, ahead) + side * half
        turned_h = _turned(h1, theta1, h)
        u = turned_h[0] * rotation[0] + turned_h[1] * rotation[1] + turned_h[2] * rotation[2]
        a, b = -np.sum(u * v), sense * np.sum(u * np.cross(h, v))
        sine, cosine = np.hypot(a, b), np.sum(u * h)
        if sine >= NEAR:
            continue
        seen = _turned(h1, -theta1, w) - steps[1]
        z = np.sum(h1 * seen) + 1j * np.sum(across * seen)
        for sign in (1.0, -1.0):
            theta5, theta6 = np.arctan2(sign * sine, cosine), np.arctan2(sign * b, sign * a)
            wrist = _turned(h6, -theta6, _turned(h5, -theta5, h1))
            left = np.empty(3)
            for i in range(3):
                left[i] = np.sum(rotation[i] * wrist)
            left = _turned(h1, -theta1, left)
            psi = np.arctan2(np.sum(across * left), np.sum(h1 * left))
            # the way |z - k e^(i psi)| that joints 2 and 3 have to bridge: if they cannot, what they can
            apart = np.angle(k * np.exp(1j * psi) / z)
            way = abs(z - k * np.exp(1j * psi))
            ways = 1
            psis[0] = psi
            if not shortest <= way <= longest:
                psis[0] = psi - apart + np.copysign(_angle_for(z, k, min(max(way, shortest), longest)), apart)
            if sine <= FREE:
                least = max(shortest, abs(abs(z) - abs(k)))
                most = min(longest, abs(z) + abs(k))
                angle = _angle_for(z, k, 0.5 * (least + most))
                psis[1], psis[2], ways = psi - apart + angle, psi - apart - angle, 3
            for n in range(ways):
                y = z - k * np.exp(1j * psis[n])
                bend = (abs(y) ** 2 - abs(l2) ** 2 - abs(l3) ** 2) / (2.0 * abs(l2) * abs(l3))
                for elbow in (1.0, -1.0):
                    theta3 = elbow * np.arccos(min(max(bend, -1.0), 1.0)) + np.angle(l2) - np.angle(l3)
                    theta2 = np.angle(y) - np.angle(l2 + l3 * np.exp(1j * theta3))
                    out[count, 0], out[count, 1], out[count, 2] = theta1, theta2, theta3
                    out[count, 3], out[count, 4] = psis[n] - theta2 - theta3, theta5
                    out[count, 5] = theta6 + (psi - psis[n]) * sense * np.sign(cosine)
                    count += 1
    return count


@compiled
def _angle_for(z: complex, k: complex, way: float) -> float:
    """The angle between z and k with which their difference is ``way`` long, or as nearly as can be."""
    cosine = (abs(z) ** 2 + abs(k) ** 2 - way * way) / (2.0 * abs(z) * abs(k))
    return float(np.arccos(min(max(cosine, -1.0), 1.0)))
