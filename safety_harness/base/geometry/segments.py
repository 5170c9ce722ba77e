"""Exact distances between points and line segments in space.

All points in one call must be in the same frame [m].
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from safety_harness.base.compiled import inlined
from safety_harness.base.geometry.arrays import Array2x3, Array3

ROUNDING_M = 1e-9  # the most by which rounding lifts a lower bound above the distance


@inlined
def point_segment_distance(point: Array3, start: Array3, end: Array3) -> float:
    """Return the distance [m] from a point p to the segment from a to b.

    The distance is |p - a - t u|.  Here u = b - a, and t is (p - a) . u / |u|^2, limited to [0, 1].  If the
    segment is only a point (u = 0), then t = 0.

    Args:
        point: (3,) p.
        start: (3,) a.
        end: (3,) b.

    """
    ux, uy, uz = end[0] - start[0], end[1] - start[1], end[2] - start[2]
    wx, wy, wz = point[0] - start[0], point[1] - start[1], point[2] - start[2]
    squared = ux * ux + uy * uy + uz * uz
    t = 0.0
    if squared > 0.0:
        t = min(max((wx * ux + wy * uy + wz * uz) / squared, 0.0), 1.0)
    dx, dy, dz = wx - t * ux, wy - t * uy, wz - t * uz
    return sqrt(dx * dx + dy * dy + dz * dz)


@inlined
def axes_lower_m(a: Array2x3, b: Array2x3) -> float:
    """Return a lower bound [m] for the distance between two segments.

    A negative bound means that the segments may touch.  The bound is |m_a - m_b| - (l_a + l_b)/2, where m_a
    and m_b are the segments' middles and l_a and l_b their lengths.  Because of rounding, the bound may
    exceed the distance by ROUNDING_M.  The bound follows from the triangle inequality: no point of a segment
    is farther from the middle than half the length.  The bound takes a third of the computing time of
    ``segment_segment_distance``.

    Args:
        a: (2, 3) The ends of the first segment, by row.
        b: (2, 3) The ends of the second segment.

    """
    middles_squared, a_squared, b_squared = 0.0, 0.0, 0.0
    for i in range(3):
        middles_squared += (0.5 * (a[0, i] + a[1, i]) - 0.5 * (b[0, i] + b[1, i])) ** 2
        a_squared += (a[1, i] - a[0, i]) ** 2
        b_squared += (b[1, i] - b[0, i]) ** 2
    return sqrt(middles_squared) - 0.5 * (sqrt(a_squared) + sqrt(b_squared))


@inlined
def segment_segment_distance(a_start: Array3, a_end: Array3, b_start: Array3, b_end: Array3) -> float:
    """Return the distance [m] between two segments, which is the length of ``segment_segment_vector``.

    Args:
        a_start: (3,) The start of segment a.
        a_end: (3,) Its end.
        b_start: (3,) The start of segment b.
        b_end: (3,) Its end.

    """
    x, y, z = segment_segment_vector(a_start, a_end, b_start, b_end)
    return sqrt(x * x + y * y + z * z)


@inlined
def segment_segment_vector(
    a_start: Array3, a_end: Array3, b_start: Array3, b_end: Array3
) -> tuple[float, float, float]:
    """Return the shortest vector (x, y, z) [m] from segment a to segment b.

    ``nearest_of_segments`` computes it.

    Args:
        a_start: (3,) The start of segment a.
        a_end: (3,) Its end.
        b_start: (3,) The start of segment b.
        b_end: (3,) Its end.

    """
    x, y, z, _, _ = nearest_of_segments(a_start, a_end, b_start, b_end)
    return x, y, z


@inlined
def nearest_of_segments(
    a_start: Array3, a_end: Array3, b_start: Array3, b_end: Array3
) -> tuple[float, float, float, float, float]:
    """Return the vector between the nearest points of segments a and b, and the points' positions on them.

    Let u and v be the segments' vectors and w = b_start - a_start.  The vector is w + t v - s u, for the s
    and t in [0, 1] that make it shortest.  If both points are inside the segments, then with n = u x v,

        s = (w x v) . n / |n|^2,   t = (w x u) . n / |n|^2.

    The textbook of Ericson (2005, section 5.1.9) instead divides by |u|^2 |v|^2 - (u . v)^2, which is the
    same number.  This difference loses digits by cancellation.  If one point is an end of its segment, the
    function computes the position of the second point as ``point_segment_distance`` does.  The segments may
    be parallel, and a segment may be a single point.

    The shortest vector either touches an end of a segment, or it joins two inner points and is perpendicular
    to both segments.  The loop always tries the four ends, and then the solution with two inner points.
    Therefore the answer is right even for nearly parallel segments, whose inner solution is ill-conditioned.

    Args:
        a_start: (3,) The start of segment a.
        a_end: (3,) Its end.
        b_start: (3,) The start of segment b.
        b_end: (3,) Its end.

    Returns:
        (x, y, z, s, t): the vector [m] from a to b, and the positions of its ends along the segments, 0 to 1.
        All five numbers are NaN if a coordinate of a segment's end is NaN.

    """
    ux, uy, uz = a_end[0] - a_start[0], a_end[1] - a_start[1], a_end[2] - a_start[2]
    vx, vy, vz = b_end[0] - b_start[0], b_end[1] - b_start[1], b_end[2] - b_start[2]
    wx, wy, wz = b_start[0] - a_start[0], b_start[1] - a_start[1], b_start[2] - a_start[2]
    uu = ux * ux + uy * uy + uz * uz
    vv = vx * vx + vy * vy + vz * vz
    uv = ux * vx + uy * vy + uz * vz
    uw = ux * wx + uy * wy + uz * wz
    vw = vx * wx + vy * wy + vz * wz
    # A segment without a length: its position is 0, as in ``point_segment_distance``.
    per_uu = 1.0 / uu if uu > 0.0 else 0.0
    per_vv = 1.0 / vv if vv > 0.0 else 0.0
    best_x, best_y, best_z = wx, wy, wz
    best, best_s, best_t = np.inf, 0.0, 0.0
    # The vector is w + t v - s u.  The normal of both, and not uu vv - uv^2, which cancels.
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    nn = nx * nx + ny * ny + nz * nz
    # Four candidates have one point fixed at an end of a segment. The fifth is the inner solution.
    for candidate in range(5):
        if candidate == 0:
            s, t = 0.0, min(max(-vw * per_vv, 0.0), 1.0)
        elif candidate == 1:
            s, t = 1.0, min(max((uv - vw) * per_vv, 0.0), 1.0)
        elif candidate == 2:
            s, t = min(max(uw * per_uu, 0.0), 1.0), 0.0
        elif candidate == 3:
            s, t = min(max((uw + uv) * per_uu, 0.0), 1.0), 1.0
        else:
            if not nn > 0.0:
                break
            s = ((wy * vz - wz * vy) * nx + (wz * vx - wx * vz) * ny + (wx * vy - wy * vx) * nz) / nn
            t = ((wy * uz - wz * uy) * nx + (wz * ux - wx * uz) * ny + (wx * uy - wy * ux) * nz) / nn
            if not (0.0 < s < 1.0 and 0.0 < t < 1.0):
                break
        x, y, z = wx + t * vx - s * ux, wy + t * vy - s * uy, wz + t * vz - s * uz
        squared = x * x + y * y + z * z
        if not squared >= best:  # this comparison also accepts a NaN
            best, best_s, best_t = squared, s, t
            best_x, best_y, best_z = x, y, z
    if np.isnan(best):
        return np.nan, np.nan, np.nan, np.nan, np.nan
    return best_x, best_y, best_z, best_s, best_t
