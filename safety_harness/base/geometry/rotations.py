"""Conversions between rotation matrices and rotation vectors (axis times angle), accurate at every angle."""

from __future__ import annotations

from math import sqrt

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import compiled, inlined
from safety_harness.base.elementary import arctan2, sin_cos
from safety_harness.base.geometry.arrays import Array3, Array3x3

# Below this squared angle the second-order series are exact to the last bit of a float64.
SMALL_SQUARED_ANGLE = 1e-8


@compiled
def rotation_from_vector(vector: Array3) -> NDArray[np.float64]:
    """Return the rotation matrix R (3, 3) of the rotation ``vector`` v (3,) [rad], by Rodrigues' formula.

        R = I + a [v]x + b [v]x^2,   a = sin(t)/t,   b = (1 - cos t)/t^2,   t = |v|,

    where [v]x u = v x u for every u.  For small t, the function uses the series a = 1 - t^2/6 and b = 1/2 -
    t^2/24.
    """
    x, y, z = vector[0], vector[1], vector[2]
    squared = x * x + y * y + z * z
    if squared < SMALL_SQUARED_ANGLE:
        a = 1.0 - squared / 6.0
        b = 0.5 - squared / 24.0
    else:
        angle = sqrt(squared)
        half, even = sin_cos(0.5 * angle)
        a = 2.0 * half * even / angle  # sin t = 2 sin(t/2) cos(t/2)
        b = 2.0 * half * half / squared  # 1 - cos t = 2 sin^2(t/2) does not cancel
    rotation = np.empty((3, 3))
    rotation[0, 0] = 1.0 - b * (y * y + z * z)
    rotation[0, 1] = b * x * y - a * z
    rotation[0, 2] = b * x * z + a * y
    rotation[1, 0] = b * x * y + a * z
    rotation[1, 1] = 1.0 - b * (x * x + z * z)
    rotation[1, 2] = b * y * z - a * x
    rotation[2, 0] = b * x * z - a * y
    rotation[2, 1] = b * y * z + a * x
    rotation[2, 2] = 1.0 - b * (x * x + y * y)
    return rotation


@compiled
def vector_from_rotation(rotation: Array3x3) -> NDArray[np.float64]:
    """Return the rotation vector v (3,) [rad] of a rotation matrix R, with a length of at most pi.

    The matrix R is ``rotation`` (3, 3).  The vector is

        v = 2 atan2(|u|, w) u/|u|,   (w, u) the unit quaternion of the rotation with w >= 0,

    where 4 w^2 = 1 + tr R and 4 w u = (R_21 - R_12, R_02 - R_20, R_10 - R_01).  Analogous formulas give the
    components of u.  The computation begins with the largest component of the quaternion (Shepperd, 1978).
    Therefore terms never cancel near the identity or near a half turn.  At exactly pi, both signs of the
    vector mean the same rotation, and the result may have either sign.
    """
    r00, r11, r22 = rotation[0, 0], rotation[1, 1], rotation[2, 2]
    trace = r00 + r11 + r22
    if trace >= r00 and trace >= r11 and trace >= r22:
        w = 1.0 + trace
        x = rotation[2, 1] - rotation[1, 2]
        y = rotation[0, 2] - rotation[2, 0]
        z = rotation[1, 0] - rotation[0, 1]
    elif r00 >= r11 and r00 >= r22:
        w = rotation[2, 1] - rotation[1, 2]
        x = 1.0 + r00 - r11 - r22
        y = rotation[0, 1] + rotation[1, 0]
        z = rotation[0, 2] + rotation[2, 0]
    elif r11 >= r22:
        w = rotation[0, 2] - rotation[2, 0]
        x = rotation[0, 1] + rotation[1, 0]
        y = 1.0 + r11 - r00 - r22
        z = rotation[1, 2] + rotation[2, 1]
    else:
        w = rotation[1, 0] - rotation[0, 1]
        x = rotation[0, 2] + rotation[2, 0]
        y = rotation[1, 2] + rotation[2, 1]
        z = 1.0 + r22 - r00 - r11
    if w < 0.0:
        w, x, y, z = -w, -x, -y, -z
    # (w, x, y, z) is the quaternion times a common factor, which arctan2 and the ratio do not see.
    length = sqrt(x * x + y * y + z * z)
    # For a tiny angle atan(l/w)/l is 1/w to the last bit, and l may be 0.
    factor = 2.0 / w if length < 1e-8 * w else 2.0 * arctan2(length, w) / length
    vector = np.empty(3)
    vector[0] = factor * x
    vector[1] = factor * y
    vector[2] = factor * z
    return vector


@compiled
def rotation_about(axis: Array3, angle_rad: float, rotation_out: Array3x3) -> None:
    """Fill a matrix R with the rotation by an angle t about a *unit* axis a.

    Rodrigues' formula is R = cos t I + sin t [a]x + (1 - cos t) a a^T.

    Args:
        axis: (3,) The unit axis a.
        angle_rad: The angle t.
        rotation_out: (3, 3) The matrix R.

    """
    entries = rotation_entries(axis[0], axis[1], axis[2], angle_rad)
    for i in range(9):
        rotation_out[i // 3, i % 3] = entries[i]


@inlined
def rotation_entries(
    x: float, y: float, z: float, angle_rad: float
) -> tuple[float, float, float, float, float, float, float, float, float]:
    """Return the nine entries of the matrix of ``rotation_about``, row by row.

    The formula 2 sin^2(t/2) for 1 - cos t avoids cancellation, and sin t is 2 sin(t/2) cos(t/2).

    Args:
        x: The first component of the *unit* axis.
        y: The second component.
        z: The third component.
        angle_rad: The angle t.

    """
    half, even = sin_cos(0.5 * angle_rad)
    d = 2.0 * half * half
    c, s = 1.0 - d, 2.0 * half * even
    return (
        c + d * x * x,
        d * x * y - s * z,
        d * x * z + s * y,
        d * x * y + s * z,
        c + d * y * y,
        d * y * z - s * x,
        d * x * z - s * y,
        d * y * z + s * x,
        c + d * z * z,
    )
