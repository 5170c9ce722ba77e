"""Compute the moments of an object in an image with square pixels, as sums over its pixels.

A pixel belongs to the object if its *centre* is inside the object. Each pixel stands for the area 1/f^2 of
the normalised image, so the sums converge to the integrals of ``moments.polygon_moments``. A closed form
gives the sum over adjacent pixels in a row, so the code does not need an image.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import compiled
from safety_harness.cell.perception.camera import principal_point_px
from safety_harness.cell.perception.moments import FIRST_MU, M00, MAX_ORDER, XG, YG, mu_index


@compiled
def raster_moments(
    vertices: NDArray[np.float64],  # (n, 2), normalised
    focal_px: float,
    width_px: int,
    height_px: int,
    out: NDArray[np.float64],  # (31,)
) -> int:
    """Fill ``out`` with the moments of a simple polygon, computed from the pixels inside the polygon.

    Return the number of pixels. A pixel is inside if its centre is on a left or upper edge, and outside if
    its centre is on a right or lower edge. So polygons with a common edge have no common pixel. The function
    ignores the parts of the polygon outside of the image. If no pixel is inside the polygon, ``out`` is all
    NaN.
    """
    n = vertices.shape[0]
    c_u, c_v = principal_point_px(width_px, height_px)
    corners = np.empty((n, 2))
    top, bottom = np.inf, -np.inf
    for k in range(n):
        corners[k, 0] = focal_px * vertices[k, 0] + c_u
        corners[k, 1] = focal_px * vertices[k, 1] + c_v
        if not (np.isfinite(corners[k, 0]) and np.isfinite(corners[k, 1])):
            out[:] = np.nan
            return 0
        top = min(top, corners[k, 1])
        bottom = max(bottom, corners[k, 1])
    first_row = int(np.ceil(max(top, 0.0)))
    last_row = int(np.floor(min(bottom, height_px - 1.0)))

    # First pass: the runs and the centroid, in exact integers. Centred sums need the centroid first; sums
    # about the image's corner would cancel.
    crossings = np.empty(n)
    runs = np.empty((max(0, last_row - first_row + 1) * (n // 2), 3), np.int64)  # row, first, last
    run_count, count, twice_sum_u, sum_v = 0, 0, 0, 0
    for v in range(first_row, last_row + 1):
        for k in range(0, _row_crossings(corners, float(v), crossings), 2):
            first, last = _run(crossings[k], crossings[k + 1], width_px)
            if last >= first:
                length = last - first + 1
                count += length
                twice_sum_u += length * (first + last)
                sum_v += length * v
                runs[run_count, 0], runs[run_count, 1], runs[run_count, 2] = v, first, last
                run_count += 1
    if count == 0:
        out[:] = np.nan
        return 0
    u_g, v_g = 0.5 * twice_sum_u / count, sum_v / count

    out[:] = 0.0
    for k in range(run_count):
        v, first, last = runs[k, 0], runs[k, 1], runs[k, 2]
        _add_run(0.5 * (first + last) - u_g, last - first + 1, v - v_g, out)
    _to_normalised(u_g, v_g, focal_px, c_u, c_v, out)
    return count


@compiled
def mask_moments(
    mask: NDArray[np.uint8],  # (h, w); bool will do
    focal_px: float,
    c_u: float,
    c_v: float,
    out: NDArray[np.float64],  # (31,)
) -> int:
    """Fill ``out`` with the moments of a mask's non-zero pixels, and return the number of these pixels.

    The principal point is an argument because a renderer's principal point may differ from the usual
    convention. If the mask has no such pixel, ``out`` is all NaN.
    """
    height_px, width_px = mask.shape
    # First pass: the centroid, in exact integers, and the bounding box, so that the second pass scans little.
    count, sum_u, sum_v = 0, 0, 0
    top, bottom, left, right = height_px, -1, width_px, -1
    for v in range(height_px):
        for u in range(width_px):
            if mask[v, u]:
                count += 1
                sum_u += u
                sum_v += v
                top = min(top, v)
                bottom = v
                left = min(left, u)
                right = max(right, u)
    if count == 0:
        out[:] = np.nan
        return 0
    u_g, v_g = sum_u / count, sum_v / count

    out[:] = 0.0
    for v in range(top, bottom + 1):
        u = left
        while u <= right:
            if not mask[v, u]:
                u += 1
                continue
            first = u
            while u <= right and mask[v, u]:
                u += 1
            _add_run(0.5 * (first + u - 1) - u_g, u - first, v - v_g, out)
    _to_normalised(u_g, v_g, focal_px, c_u, c_v, out)
    return count


@compiled
def _row_crossings(
    corners: NDArray[np.float64],  # (n, 2) in pixels
    v: float,
    out: NDArray[np.float64],  # (n,)
) -> int:
    """Fill ``out`` with the sorted coordinates u [px] at which the polygon's outline crosses the row ``v``.

    Return the number of crossings, which is even.
    """
    n = corners.shape[0]
    count = 0
    for k in range(n):
        following = k + 1 if k + 1 < n else 0
        u0, v0 = corners[k, 0], corners[k, 1]
        u1, v1 = corners[following, 0], corners[following, 1]
        if (v0 <= v) == (v1 <= v):  # half-open: a vertex on the row counts once
            continue
        if v0 > v1:  # go always downwards, so that two polygons agree about a shared edge to the last bit
            u0, v0, u1, v1 = u1, v1, u0, v0
        u = u0 + (v - v0) / (v1 - v0) * (u1 - u0)
        place = count
        while place > 0 and out[place - 1] > u:
            out[place] = out[place - 1]
            place -= 1
        out[place] = u
        count += 1
    return count


@compiled
def _run(u_left: float, u_right: float, width_px: int) -> tuple[int, int]:
    """Return the first and the last pixel whose centre is in [u_left, u_right) and in the image."""
    first = int(np.ceil(max(u_left, 0.0)))
    last = int(np.ceil(min(u_right, float(width_px)))) - 1
    return first, last


@compiled
def _add_run(middle: float, length: int, y: float, out: NDArray[np.float64]) -> None:
    """Add a run of pixels, in centred pixel coordinates, to every mu_ij in ``out`` (31,).

    The run has n pixels at middle + d, with d from -(n-1)/2 to (n-1)/2. So the sums of odd powers of d are
    zero. The sums of even powers are polynomials in n (Faulhaber's formula, below). The binomial theorem then
    gives the sums of powers of middle + d.

        sum d^2 = n (n^2 - 1)/12,   sum d^4 = sum d^2 (3 n^2 - 7)/20,
        sum d^6 = sum d^2 (3 n^4 - 18 n^2 + 31)/112
    """
    n = float(length)
    nn = n * n
    s2 = n * (nn - 1.0) / 12.0
    s4 = s2 * (3.0 * nn - 7.0) / 20.0
    s6 = s2 * (3.0 * nn * nn - 18.0 * nn + 31.0) / 112.0
    m = middle
    m2 = m * m
    m3 = m2 * m
    m4 = m2 * m2
    sums = (
        n,
        n * m,
        n * m2 + s2,
        n * m3 + 3.0 * m * s2,
        n * m4 + 6.0 * m2 * s2 + s4,
        n * m4 * m + 10.0 * m3 * s2 + 5.0 * m * s4,
        n * m4 * m2 + 15.0 * m4 * s2 + 15.0 * m2 * s4 + s6,
    )
    for i in range(MAX_ORDER + 1):
        term = sums[i]
        for j in range(MAX_ORDER + 1 - i):
            out[mu_index(i, j)] += term
            term *= y


@compiled
def _to_normalised(
    u_g: float, v_g: float, focal_px: float, c_u: float, c_v: float, out: NDArray[np.float64]
) -> None:
    """Turn the centred sums over pixels in ``out`` (31,) into a moment vector: mu_ij / f^(i + j + 2).

    The function divides lengths by f, and counts each pixel as the area 1/f^2. The centroid is x_g = (u_g -
    c_u)/f, y_g = (v_g - c_v)/f.
    """
    # A pixel's area is 1/f^2, and each power of a coordinate adds a factor 1/f.
    scale = 1.0 / (focal_px * focal_px)
    for order in range(MAX_ORDER + 1):
        for j in range(order + 1):
            out[mu_index(order - j, j)] *= scale
        scale /= focal_px
    out[M00] = out[FIRST_MU]
    out[XG] = (u_g - c_u) / focal_px
    out[YG] = (v_g - c_v) / focal_px
    out[mu_index(1, 0)] = 0.0
    out[mu_index(0, 1)] = 0.0
