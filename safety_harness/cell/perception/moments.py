"""Compute image moments up to order six.

A closed form gives the moments of a polygon, and a sum gives the moments of a set of points.

A *moment vector* is a float64 array (31,): m00, the centroid xg, yg, then the 28 centred moments. A centred
moment mu_ij is the integral (or sum) of (x - xg)^i (y - yg)^j, with i + j <= 6. The moments are sorted by
their order i + j. Moments of the same order are sorted by j. Coordinates are normalised image coordinates.
The invariants gamma and delta are of order five, and the interaction matrix needs one order more. So order
six is necessary.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import inlined, njit_no_nrt

# Records, traces and the interaction matrix have this layout: m00, xg, yg, then 28 centred moments.
MAX_ORDER = 6
M00, XG, YG = 0, 1, 2
FIRST_MU = 3
MOMENT_COUNT = 31

# The four-point Gauss-Legendre rule on (0, 1): exact for polynomials up to order seven.
_INNER = 0.5 * np.sqrt(3.0 / 7.0 - 2.0 / 7.0 * np.sqrt(6.0 / 5.0))
_OUTER = 0.5 * np.sqrt(3.0 / 7.0 + 2.0 / 7.0 * np.sqrt(6.0 / 5.0))
_NODES = np.array([0.5 - _OUTER, 0.5 - _INNER, 0.5 + _INNER, 0.5 + _OUTER])
_INNER_WEIGHT = (18.0 + np.sqrt(30.0)) / 72.0
_OUTER_WEIGHT = (18.0 - np.sqrt(30.0)) / 72.0
_WEIGHTS = np.array([_OUTER_WEIGHT, _INNER_WEIGHT, _INNER_WEIGHT, _OUTER_WEIGHT])


@inlined
def mu_index(i: int, j: int) -> int:
    """Return the index of mu_ij in a moment vector, 3 + o (o + 1)/2 + j with the order o = i + j."""
    order = i + j
    return FIRST_MU + (order * (order + 1)) // 2 + j


@inlined
def add_powers(x: float, y: float, weight: float, out: NDArray[np.float64]) -> None:
    """Add ``weight`` x^i y^j to every mu_ij of the moment vector ``out`` (31,)."""
    weighted_x_power = weight
    for i in range(MAX_ORDER + 1):
        term = weighted_x_power
        for j in range(MAX_ORDER + 1 - i):
            out[mu_index(i, j)] += term
            term *= y
        weighted_x_power *= x


@njit_no_nrt
def polygon_moments(
    vertices: NDArray[np.float64],  # (n, 2), normalised
    out: NDArray[np.float64],  # (31,)
) -> bool:
    """Fill ``out`` with the moments of the region inside a simple polygon, exact up to rounding.

    m00 is the polygon's (positive) area. The function applies Green's theorem about the centroid. For a
    homogeneous integrand of order o, the theorem gives

        (o + 2) mu_ij = sum over edges p -> q of (p x q) * integral_0^1 x(t)^i y(t)^j dt

    The four-point Gauss-Legendre rule is exact for these integrals. The polygon may be clockwise or
    anticlockwise. If the polygon has no area or is not finite, return False and fill ``out`` with NaN.
    """
    n = vertices.shape[0]
    x0, y0 = vertices[0, 0], vertices[0, 1]  # relative to a vertex, to avoid cancellation
    twice_area, moment_x, moment_y = 0.0, 0.0, 0.0
    for k in range(1, n - 1):
        px, py = vertices[k, 0] - x0, vertices[k, 1] - y0
        qx, qy = vertices[k + 1, 0] - x0, vertices[k + 1, 1] - y0
        cross = px * qy - qx * py
        twice_area += cross
        moment_x += cross * (px + qx)
        moment_y += cross * (py + qy)
    if not (abs(twice_area) > 0.0 and np.isfinite(twice_area)):
        out[:] = np.nan
        return False
    xg = x0 + moment_x / (3.0 * twice_area)
    yg = y0 + moment_y / (3.0 * twice_area)

    out[:] = 0.0
    sign = 1.0 if twice_area > 0.0 else -1.0
    for k in range(n):
        # Each edge spans a triangle with the centroid, whose doubled area is ``cross``. The sign makes m00
        # positive for both windings, where ViSP returns a negative area for one.
        following = k + 1 if k + 1 < n else 0
        px, py = vertices[k, 0] - xg, vertices[k, 1] - yg
        qx, qy = vertices[following, 0] - xg, vertices[following, 1] - yg
        cross = sign * (px * qy - qx * py)
        for node in range(4):
            t = _NODES[node]
            add_powers(px + t * (qx - px), py + t * (qy - py), cross * _WEIGHTS[node], out)
    for order in range(MAX_ORDER + 1):
        for j in range(order + 1):
            # The radial integral of a homogeneous integrand of this order gives 1/(order + 2).
            out[mu_index(order - j, j)] /= order + 2.0
    return _finish(xg, yg, out)


@njit_no_nrt
def point_moments(
    points: NDArray[np.float64],  # (n, 2), normalised
    out: NDArray[np.float64],  # (31,)
) -> bool:
    """Fill ``out`` with the moments of a set of points: mu_ij = sum_k (x_k - x_g)^i (y_k - y_g)^j (eq. 6).

    The points are the *discrete* object of the paper. m00 is their number n, and (x_g, y_g) their mean. If
    there are no points or some are not finite, return False and fill ``out`` with NaN.
    """
    n = points.shape[0]
    sum_x, sum_y = 0.0, 0.0
    for k in range(n):
        sum_x += points[k, 0]
        sum_y += points[k, 1]
    xg, yg = sum_x / n, sum_y / n  # NaN without points, which ``_finish`` refuses
    out[:] = 0.0
    for k in range(n):
        add_powers(points[k, 0] - xg, points[k, 1] - yg, 1.0, out)
    return _finish(xg, yg, out)


@inlined
def _finish(xg: float, yg: float, out: NDArray[np.float64]) -> bool:
    """Complete the moment vector ``out`` (31,).

    The function writes m00 and the centroid, and sets mu_10 and mu_01 to 0, which is their value by
    definition. If a number is not finite, return False and fill ``out`` with NaN.
    """
    out[M00] = out[FIRST_MU]
    out[XG] = xg
    out[YG] = yg
    # Rounding would leave tiny numbers here, although the centroid makes them 0.
    out[mu_index(1, 0)] = 0.0
    out[mu_index(0, 1)] = 0.0
    for k in range(MOMENT_COUNT):
        if not np.isfinite(out[k]):
            out[:] = np.nan
            return False
    return True
