"""Exact distances between points and line segments in space."""

from __future__ import annotations

from math import sqrt

import numpy as np
from numpy.typing import NDArray

from safety_harness.compiled import compiled


@compiled
def point_segment_distance(
    point: NDArray[np.float64], start: NDArray[np.float64], end: NDArray[np.float64]
) -> float:
    """Distance [m] from ``point`` (3,) to the segment from ``start`` to ``end``, which may be a point."""
    ux, uy, uz = end[0] - start[0], end[1] - start[1], end[2] - start[2]
    wx, wy, wz = point[0] - start[0], point[1] - start[1], point[2] - start[2]
    squared = ux * ux + uy * uy + uz * uz
    t = 0.0
    if squared > 0.0:
        t = min(max((wx * ux + wy * uy + wz * uz) / squared, 0.0), 1.0)
    dx, dy, dz = wx - t * ux, wy - t * uy, wz - t * uz
    return sqrt(dx * dx + dy * dy + dz * dz)


@compiled
def segment_segment_distance(
    a_start: NDArray[np.float64],
    a_end: NDArray[np.float64],
    b_start: NDArray[np.float64],
    b_end: NDArray[np.float64],
) -> float:
    """Distance [m] between two segments, ends (3,) each; parallel and point-like ones included.

    The least distance is taken either at an end point of one of the segments, or at two inner
    points where the joining line is perpendicular to both.  All four end points are tried, so
    an ill-conditioned inner solution (nearly parallel segments) can only be passed over where
    an end point is as good.
    """
    best = min(
        min(point_segment_distance(a_start, b_start, b_end), point_segment_distance(a_end, b_start, b_end)),
        min(point_segment_distance(b_start, a_start, a_end), point_segment_distance(b_end, a_start, a_end)),
    )
    ux, uy, uz = a_end[0] - a_start[0], a_end[1] - a_start[1], a_end[2] - a_start[2]
    vx, vy, vz = b_end[0] - b_start[0], b_end[1] - b_start[1], b_end[2] - b_start[2]
    wx, wy, wz = a_start[0] - b_start[0], a_start[1] - b_start[1], a_start[2] - b_start[2]
    # The cross product, and not uu*vv - uv^2, which cancels for nearly parallel segments.
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    nn = nx * nx + ny * ny + nz * nz
    if not nn > 0.0:
        return best
    # a_start + s u - (b_start + t v) is parallel to n: s = (v x w) . n / nn, t = (u x w) . n / nn.
    s = ((vy * wz - vz * wy) * nx + (vz * wx - vx * wz) * ny + (vx * wy - vy * wx) * nz) / nn
    t = ((uy * wz - uz * wy) * nx + (uz * wx - ux * wz) * ny + (ux * wy - uy * wx) * nz) / nn
    if not (0.0 < s < 1.0 and 0.0 < t < 1.0):
        return best
    # Measured between the two points themselves: never less than the true distance.
    dx, dy, dz = wx + s * ux - t * vx, wy + s * uy - t * vy, wz + s * uz - t * vz
    return min(best, sqrt(dx * dx + dy * dy + dz * dz))
