"""Compute the distance from a segment to a pyramid, to find occlusions of a flat object."""

from __future__ import annotations

from math import sqrt

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import compiled
from safety_harness.base.geometry.arrays import Array3, ArrayNx3
from safety_harness.base.geometry.linear import copy_vector
from safety_harness.base.geometry.segments import segment_segment_distance


@compiled
def segment_pyramid_distance(start: Array3, end: Array3, apex: Array3, base: ArrayNx3) -> float:
    """Return the distance [m] from a segment to the solid pyramid over ``base``, or 0 if they touch.

    The pyramid's surface consists of its base and a triangle for each side of the base.  If a segment is
    outside the pyramid, consider its shortest connection to a face.  This connection begins at an end of the
    segment, or it ends on an edge of the face.  A segment that touches the pyramid either crosses a face or
    has an end inside.

    Args:
        start: (3,) One end of the segment [m].  All points must be in the same frame.
        end: (3,) The other end [m], which may equal ``start``.
        apex: (3,) The tip [m].
        base: (n, 3) The corners [m] of a flat simple polygon, in order along its outline.

    """
    n = base.shape[0]
    normal = _normal(base)
    # A segment inside the pyramid crosses no face, so the faces alone would give a positive distance.
    if _is_within(start, apex, base, normal) or _is_within(end, apex, base, normal):
        return 0.0
    least = min(_base_distance(start, base, normal), _base_distance(end, base, normal))
    if _crosses(start, end, base, normal):
        return 0.0
    triangle = np.empty((3, 3))
    for k in range(n):
        a, b = base[k], base[(k + 1) % n]
        least = min(least, segment_segment_distance(start, end, a, b))
        least = min(least, segment_segment_distance(start, end, apex, a))
        copy_vector(apex, triangle[0])
        copy_vector(a, triangle[1])
        copy_vector(b, triangle[2])
        side = _normal(triangle)
        if _crosses(start, end, triangle, side):
            return 0.0
        least = min(least, _base_distance(start, triangle, side), _base_distance(end, triangle, side))
    return least


@compiled
def _normal(polygon: ArrayNx3) -> NDArray[np.float64]:
    """Return the unit normal (3,) of a flat ``polygon`` (n, 3), or zeros if the polygon has no area.

    Newell's sum N = sum_k (p_k - p_0) x (p_(k+1) - p_0) over the corners p_k has twice the area as its
    length, and the normal is N/|N|.
    """
    normal = np.zeros(3)
    n = polygon.shape[0]
    for k in range(n):
        # Differences from p_0 keep the digits of a small polygon far from the origin.
        a, b = polygon[k] - polygon[0], polygon[(k + 1) % n] - polygon[0]
        normal[0] += a[1] * b[2] - a[2] * b[1]
        normal[1] += a[2] * b[0] - a[0] * b[2]
        normal[2] += a[0] * b[1] - a[1] * b[0]
    length = sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)
    if length > 0.0:
        for i in range(3):
            normal[i] /= length
    return normal


@compiled
def _height(point: Array3, polygon: ArrayNx3, normal: Array3) -> float:
    """Return the signed height [m] of ``point`` p (3,) above the plane of ``polygon`` (n, 3).

    The height is the scalar product of ``normal`` (3,) and p - p_0, where p_0 is the polygon's first corner.
    """
    height = 0.0
    for i in range(3):
        height += normal[i] * (point[i] - polygon[0, i])
    return height


@compiled
def _is_over(point: Array3, polygon: ArrayNx3, normal: Array3) -> bool:
    """Return whether ``point`` (3,) is over ``polygon`` (n, 3), that is, in the prism along ``normal`` (3,).

    The test projects the point into the polygon's plane, and counts how often a ray from there crosses the
    outline.  An odd number means inside.  The test ignores the coordinate with the largest component of the
    normal, so that the projected outline keeps its area.
    """
    drop = 0
    for i in range(1, 3):
        if abs(normal[i]) > abs(normal[drop]):
            drop = i
    # A polygon without an area has no prism above it; its edges alone give the distance.
    if normal[drop] == 0.0:
        return False
    u, v = (drop + 1) % 3, (drop + 2) % 3
    height = _height(point, polygon, normal)
    x, y = point[u] - height * normal[u], point[v] - height * normal[v]
    odd = False
    n = polygon.shape[0]
    for k in range(n):
        a, b = polygon[k], polygon[(k + 1) % n]
        # The strict comparison on one side counts a corner on the ray exactly once.
        if (a[v] > y) != (b[v] > y) and x < a[u] + (y - a[v]) / (b[v] - a[v]) * (b[u] - a[u]):
            odd = not odd
    return odd


@compiled
def _base_distance(point: Array3, polygon: ArrayNx3, normal: Array3) -> float:
    """Return the absolute height [m] of a point over the polygon, or infinity if the point is not over it.

    In the second case, the nearest point of the polygon is on an edge.  ``point`` (3,), ``polygon`` (n, 3)
    and ``normal`` (3,) have the same meaning as in ``_height``.
    """
    return abs(_height(point, polygon, normal)) if _is_over(point, polygon, normal) else np.inf


@compiled
def _crosses(start: Array3, end: Array3, polygon: ArrayNx3, normal: Array3) -> bool:
    """Return whether the segment crosses ``polygon`` (n, 3), which has the normal ``normal`` (3,).

    The segment goes from ``start`` (3,) to ``end`` (3,).  The heights h_0 and h_1 of these ends must have
    different signs.  In addition, the polygon must contain the point that divides the segment at the fraction
    h_0/(h_0 - h_1) of its length.
    """
    below, above = _height(start, polygon, normal), _height(end, polygon, normal)
    # A segment within the plane does not cross it here: the polygon's edges or an end give the distance 0.
    if below == above or (below > 0.0) == (above > 0.0):
        return False
    share = below / (below - above)
    point = np.empty(3)
    for i in range(3):
        point[i] = start[i] + share * (end[i] - start[i])
    return _is_over(point, polygon, normal)


@compiled
def _is_within(point: Array3, apex: Array3, base: ArrayNx3, normal: Array3) -> bool:
    """Return whether ``point`` (3,) is inside the pyramid.

    The pyramid has the base ``base`` (n, 3) with the normal ``normal`` (3,), and the tip ``apex`` (3,).  Let
    h be the height of the point p over the base, and let H be the height of the tip.  The point is inside if
    0 <= h/H < 1 and the line from the apex a through p meets the base.  The meeting point is a + (p - a)/(1 -
    h/H).
    """
    top, height = _height(apex, base, normal), _height(point, base, normal)
    # A pyramid without a height has no inside.
    if top == 0.0 or not 0.0 <= height / top < 1.0:
        return False
    share = 1.0 / (1.0 - height / top)
    shadow = np.empty(3)
    for i in range(3):
        shadow[i] = apex[i] + share * (point[i] - apex[i])
    return _is_over(shadow, base, normal)
