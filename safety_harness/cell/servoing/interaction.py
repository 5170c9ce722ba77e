"""Compute interaction matrices, which state how image moments and features change as the camera moves.

For a camera twist (v, w) in the camera frame [m/s, rad/s], the features f change by df/dt = L (v, w). All
matrices follow from the motion of a single image point of a static object (Chaumette and Hutchinson 2006):

    x' = -v_x/Z + x v_z/Z + x y w_x - (1 + x^2) w_y + y w_z
    y' = -v_y/Z + y v_z/Z + (1 + y^2) w_x - x y w_y - x w_z

Here the object is in the plane 1/Z = A x + B y + C [1/m]. If the object is a set of points, a sum changes
only because each of its terms changes. If the object is a region, an integral also changes because the area
element changes, by (dx'/dx + dy'/dy) dx dy. Chaumette (2004) derives the forms for dense objects, and Tahri
and Chaumette (2005) the forms for discrete objects. The features' rows follow by the chain rule, and eq. 2 of
the paper is the case A = B = 0. Tests compare every entry with finite differences.

mu_ij are the centred moments, (x_g, y_g) is the centroid, m00 the area (dense) or the number of points
(discrete), and n_ij = mu_ij/m00. All these quantities are in normalised image coordinates, without a unit.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import compiled
from safety_harness.base.geometry.arrays import Array3, Array6, Array6x6, Array31
from safety_harness.cell.perception.moments import M00, XG, YG, mu_index
from safety_harness.cell.servoing.features import A_N, ALPHA, DELTA, GAMMA, X_N, Y_N, area, brackets

VX, VY, VZ, WX, WY, WZ = range(6)  # columns: the camera's twist (v, w)


@compiled
def _mu(moments: Array31, i: int, j: int) -> float:
    """Return mu_ij of ``moments`` (31,), or 0 if an index is negative.

    Terms with a negative index always have the factor 0.
    """
    if i < 0 or j < 0:
        return 0.0
    return float(moments[mu_index(i, j)])


@compiled
def centred_moment_interaction(
    moments: Array31, plane: Array3, dense: bool, i: int, j: int, out: Array6
) -> None:
    """Fill ``out`` with the interaction matrix's row for mu_ij.

    The sum i + j is at most 5.

    The row depends on moments of the next higher order. Let s = 3, o = 1, k = 4 for a dense object and s = 0,
    o = 0, k = 1 for a discrete object. Then the row is

        L_wx =  (i+j+s) mu_(i,j+1) + i x_g mu_(i-1,j+1) + (i+2j+s) y_g mu_ij
                - k i n11 mu_(i-1,j) - k j n02 mu_(i,j-1)
        L_wy = -(i+j+s) mu_(i+1,j) - (2i+j+s) x_g mu_ij - j y_g mu_(i+1,j-1)
                + k i n20 mu_(i-1,j) + k j n11 mu_(i,j-1)
        L_wz =  i mu_(i-1,j+1) - j mu_(i+1,j-1)
        L_vx = -(i+o) A mu_ij - i B mu_(i-1,j+1)
        L_vy = -j A mu_(i+1,j-1) - (j+o) B mu_ij
        L_vz = -A L_wy + B L_wx + (i+j+2o) C mu_ij

    The first three entries of ``out`` are per metre, the last three per radian.
    """
    a, b, c = plane[0], plane[1], plane[2]
    xg, yg, m00 = moments[XG], moments[YG], moments[M00]
    n20 = moments[mu_index(2, 0)] / m00
    n11 = moments[mu_index(1, 1)] / m00
    n02 = moments[mu_index(0, 2)] / m00
    mu = moments[mu_index(i, j)]
    # The change of the area element adds 3 in a rotation, 1 in a shift along x or y, and 2 along z.
    spread = 3.0 if dense else 0.0
    own = 1.0 if dense else 0.0
    k = 4.0 if dense else 1.0  # the factor of the centroid's motion

    w_x = (
        (i + j + spread) * moments[mu_index(i, j + 1)]
        + i * xg * _mu(moments, i - 1, j + 1)
        + (i + 2 * j + spread) * yg * mu
        - k * i * n11 * _mu(moments, i - 1, j)
        - k * j * n02 * _mu(moments, i, j - 1)
    )
    w_y = (
        -(i + j + spread) * moments[mu_index(i + 1, j)]
        - (2 * i + j + spread) * xg * mu
        - j * yg * _mu(moments, i + 1, j - 1)
        + k * i * n20 * _mu(moments, i - 1, j)
        + k * j * n11 * _mu(moments, i, j - 1)
    )
    out[VX] = -(i + own) * a * mu - i * b * _mu(moments, i - 1, j + 1)
    out[VY] = -j * a * _mu(moments, i + 1, j - 1) - (j + own) * b * mu
    out[VZ] = -a * w_y + b * w_x + (i + j + 2.0 * own) * c * mu
    out[WX] = w_x
    out[WY] = w_y
    out[WZ] = i * _mu(moments, i - 1, j + 1) - j * _mu(moments, i + 1, j - 1)


@compiled
def centroid_interaction(moments: Array31, plane: Array3, dense: bool, out: NDArray[np.float64]) -> None:
    """Fill ``out`` (2, 6) with the rows of x_g and y_g.

    These rows also depend on the second ``moments``. Let 1/Z_g = A x_g + B y_g + C and s_ij = k n_ij. Here k
    is 4 for a dense object and 1 for a discrete object. The rows are

        L_xg = (-1/Z_g, 0, x_g/Z_g + A s20 + B s11, x_g y_g + s11, -(1 + x_g^2 + s20),  y_g)
        L_yg = (0, -1/Z_g, y_g/Z_g + A s11 + B s02, 1 + y_g^2 + s02, -(x_g y_g + s11), -x_g)
    """
    a, b, c = plane[0], plane[1], plane[2]
    xg, yg, m00 = moments[XG], moments[YG], moments[M00]
    k = 4.0 if dense else 1.0
    s20 = k * moments[mu_index(2, 0)] / m00
    s11 = k * moments[mu_index(1, 1)] / m00
    s02 = k * moments[mu_index(0, 2)] / m00
    inverse_depth = a * xg + b * yg + c
    out[0, VX] = -inverse_depth
    out[0, VY] = 0.0
    out[0, VZ] = xg * inverse_depth + a * s20 + b * s11
    out[0, WX] = xg * yg + s11
    out[0, WY] = -(1.0 + xg * xg + s20)
    out[0, WZ] = yg
    out[1, VX] = 0.0
    out[1, VY] = -inverse_depth
    out[1, VZ] = yg * inverse_depth + a * s11 + b * s02
    out[1, WX] = 1.0 + yg * yg + s02
    out[1, WY] = -xg * yg - s11
    out[1, WZ] = -xg


@compiled
def interaction_matrix(
    moments: Array31, plane: Array3, desired_area: float, desired_depth_m: float, dense: bool, out: Array6x6
) -> bool:
    """Fill ``out`` with the interaction matrix L_f of the features of eqs. 3 to 5, for a general plane.

    ``plane`` is (A, B, C) of 1/Z = A x + B y + C, in 1/m. ``desired_area`` is a*, and ``desired_depth_m`` is
    Z*. ``moments`` (31,) are the moments of the object. The rows are in the order of ``features``, and the
    first three features are in metres. The angle alpha is atan2(2 mu11, d)/2 with d = mu20 - mu02. The row of
    alpha is (d mu11' - mu11 d')/(d^2 + 4 mu11^2), where mu11' and d' are the rows of mu11 and d. Return False
    if an entry is not finite.
    """
    second_order = np.empty((3, 6))
    for j in range(3):  # in a loop: numba compiles a copy for every pair of literal numbers
        centred_moment_interaction(moments, plane, dense, 2 - j, j, second_order[j])
    mu20_row, mu11_row, mu02_row = second_order[0], second_order[1], second_order[2]
    _position_rows(moments, plane, desired_area, desired_depth_m, dense, mu20_row, mu02_row, out)
    _invariant_rows(moments, plane, dense, out)

    # alpha = atan2(2 mu11, d) / 2 with d = mu20 - mu02
    mu11 = moments[mu_index(1, 1)]
    d = moments[mu_index(2, 0)] - moments[mu_index(0, 2)]
    squared = d * d + 4.0 * mu11 * mu11
    finite = True
    for m in range(6):
        out[ALPHA, m] = (d * mu11_row[m] - mu11 * (mu20_row[m] - mu02_row[m])) / squared
        for feature in range(6):
            finite = finite and np.isfinite(out[feature, m])
    return finite


@compiled
def _position_rows(
    moments: Array31,
    plane: Array3,
    desired_area: float,
    desired_depth_m: float,
    dense: bool,
    mu20_row: Array6,
    mu02_row: Array6,
    out: Array6x6,
) -> None:
    """Fill the rows of ``out`` for x_n = a_n x_g, y_n = a_n y_g and a_n = Z* sqrt(a*/a).

    The rows are a_n' = -(a_n/2) a'/a and x_n' = a_n' x_g + a_n x_g', and y_n' has the same form as x_n'. Here
    a is m00 for a dense object, and mu20 + mu02 for a discrete object. ``mu20_row`` and ``mu02_row`` come
    from ``centred_moment_interaction``.
    """
    a = area(moments, dense)
    a_n = desired_depth_m * np.sqrt(desired_area / a)
    centroid = np.empty((2, 6))
    centroid_interaction(moments, plane, dense, centroid)
    area_row = np.empty(6)
    if dense:
        centred_moment_interaction(moments, plane, dense, 0, 0, area_row)
    else:
        for m in range(6):
            area_row[m] = mu20_row[m] + mu02_row[m]
    for m in range(6):
        # ViSP 3.5 has A x_n in place of A x_n/2 in L_xn[v_x] for a dense object in a tilted plane. Finite
        # differences confirm the formula here.
        change = -0.5 * a_n / a * area_row[m]
        out[A_N, m] = change
        out[X_N, m] = change * moments[XG] + a_n * centroid[0, m]
        out[Y_N, m] = change * moments[YG] + a_n * centroid[1, m]


@compiled
def _invariant_rows(moments: Array31, plane: Array3, dense: bool, out: Array6x6) -> None:
    """Fill the rows of ``out`` for gamma = In1/In3 and delta = In2/In3, with In_k = c_k^2 + s_k^2.

    The row of gamma is gamma' = 2 [c_1 c_1' + s_1 s_1' - gamma (c_3 c_3' + s_3 s_3')]/In3. The row of delta
    is the same with delta, c_2 and s_2. The pairs (c_k, s_k) are linear in the moments of order five
    (``brackets``), so their rows are the same sums of the moments' rows.
    """
    pair = np.empty((3, 2))
    brackets(moments, pair)
    in3 = pair[2, 0] ** 2 + pair[2, 1] ** 2
    gamma = (pair[0, 0] ** 2 + pair[0, 1] ** 2) / in3
    delta = (pair[1, 0] ** 2 + pair[1, 1] ** 2) / in3
    rows = np.empty((6, 6))  # of mu50, mu41, mu32, mu23, mu14, mu05
    for j in range(6):
        centred_moment_interaction(moments, plane, dense, 5 - j, j, rows[j])
    for m in range(6):
        mu50, mu41, mu32 = rows[0, m], rows[1, m], rows[2, m]
        mu23, mu14, mu05 = rows[3, m], rows[4, m], rows[5, m]
        first = pair[0, 0] * (mu50 + 2.0 * mu32 + mu14) + pair[0, 1] * (mu05 + 2.0 * mu23 + mu41)
        second = pair[1, 0] * (mu50 - 2.0 * mu32 - 3.0 * mu14) + pair[1, 1] * (mu05 - 2.0 * mu23 - 3.0 * mu41)
        third = pair[2, 0] * (mu50 - 10.0 * mu32 + 5.0 * mu14) + pair[2, 1] * (
            mu05 - 10.0 * mu23 + 5.0 * mu41
        )
        out[GAMMA, m] = 2.0 * (first - gamma * third) / in3
        out[DELTA, m] = 2.0 * (second - delta * third) / in3
