"""Compute the paper's six visual features f = (x_n, y_n, a_n, gamma, delta, alpha), eqs. 3 to 5."""

from __future__ import annotations

from math import pi

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import inlined, njit_no_nrt
from safety_harness.base.elementary import arctan2
from safety_harness.base.geometry.arrays import Array6, Array31
from safety_harness.cell.perception.moments import M00, XG, YG, mu_index

X_N, Y_N, A_N, GAMMA, DELTA, ALPHA = range(6)  # the order of eqs. 2 and 3


@njit_no_nrt
def area(moments: Array31, dense: bool) -> float:
    """Return the quantity a of eq. 3 from ``moments`` (31,).

    For a dense object, a is m00. For a discrete object, a is mu20 + mu02 (eq. 5).
    """
    return float(moments[M00] if dense else moments[mu_index(2, 0)] + moments[mu_index(0, 2)])


@njit_no_nrt
def brackets(
    moments: Array31,
    out: NDArray[np.float64],  # (3, 2)
) -> None:
    """Fill ``out`` with the bracket pairs (c_k, s_k), whose sums of squares are In1, In2 and In3 of eq. 5.

        c_1 = mu50 + 2 mu32 + mu14         s_1 = mu05 + 2 mu23 + mu41
        c_2 = mu50 - 2 mu32 - 3 mu14       s_2 = mu05 - 2 mu23 - 3 mu41
        c_3 = mu50 - 10 mu32 + 5 mu14      s_3 = mu05 - 10 mu23 + 5 mu41

    Each pair consists of the real and the imaginary part of a complex moment of order five. These moments
    have the rotational symmetries 1, 3 and 5. So a turn of the image does not change the sums of squares.
    """
    c_1, s_1, c_2, s_2, c_3, s_3 = bracket_pairs(moments)
    out[0, 0], out[0, 1] = c_1, s_1
    out[1, 0], out[1, 1] = c_2, s_2
    out[2, 0], out[2, 1] = c_3, s_3


@inlined
def bracket_pairs(moments: Array31) -> tuple[float, float, float, float, float, float]:
    """Return (c_1, s_1, c_2, s_2, c_3, s_3) of ``brackets``."""
    mu50, mu32, mu14 = moments[mu_index(5, 0)], moments[mu_index(3, 2)], moments[mu_index(1, 4)]
    mu05, mu23, mu41 = moments[mu_index(0, 5)], moments[mu_index(2, 3)], moments[mu_index(4, 1)]
    return (
        mu50 + 2.0 * mu32 + mu14,
        mu05 + 2.0 * mu23 + mu41,
        mu50 - 2.0 * mu32 - 3.0 * mu14,
        mu05 - 2.0 * mu23 - 3.0 * mu41,
        mu50 - 10.0 * mu32 + 5.0 * mu14,
        mu05 - 10.0 * mu23 + 5.0 * mu41,
    )


@njit_no_nrt
def features(moments: Array31, desired_area: float, desired_depth_m: float, dense: bool, out: Array6) -> bool:
    """Fill ``out`` with x_n, y_n and a_n [m], gamma and delta [-], and alpha [rad], by eqs. 3 to 5.

        a_n = Z* sqrt(a*/a)    x_n = a_n x_g    y_n = a_n y_g
        gamma = In1/In3        delta = In2/In3  alpha = atan2(2 mu11, mu20 - mu02)/2

    Here a* is ``desired_area``, Z* is ``desired_depth_m``, and a comes from ``area``. If the object's plane
    is parallel to the image, (x_n, y_n, a_n) is the object's centroid in the camera frame. The angle alpha in
    (-pi/2, pi/2] is the direction of the object's long axis. The form with atan2 has no jump at 45 degrees.
    Return False if a feature is not finite.
    """
    c_1, s_1, c_2, s_2, c_3, s_3 = bracket_pairs(moments)
    in1, in2, in3 = c_1**2 + s_1**2, c_2**2 + s_2**2, c_3**2 + s_3**2
    a_n = desired_depth_m * np.sqrt(desired_area / area(moments, dense))
    mu20, mu02 = moments[mu_index(2, 0)], moments[mu_index(0, 2)]
    out[X_N] = a_n * moments[XG]
    out[Y_N] = a_n * moments[YG]
    out[A_N] = a_n
    out[GAMMA] = in1 / in3
    out[DELTA] = in2 / in3
    out[ALPHA] = 0.5 * arctan2(2.0 * moments[mu_index(1, 1)], mu20 - mu02)
    finite = True
    for k in range(6):
        finite = finite and np.isfinite(out[k])
    return finite


@njit_no_nrt
def feature_error(current: Array6, desired: Array6, out: Array6) -> float:
    """Fill ``out`` with the error e = f - f*, and return |e|^2.

    The result is the squared error of eq. 15, in metres and radians. The two directions of the object's axis
    are equivalent, so the error of alpha is modulo pi, in (-pi/2, pi/2].
    """
    total = 0.0
    for k in range(6):
        difference = current[k] - desired[k]
        if k == ALPHA:
            # Without this, two axes on either side of +-90 degrees would seem to be half a turn apart.
            difference -= pi * np.ceil(difference / pi - 0.5)
        out[k] = difference
        total += difference * difference
    return total
