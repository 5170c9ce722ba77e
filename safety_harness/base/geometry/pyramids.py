"""The distance from a segment to a pyramid, which shows what hides a flat object from a camera."""

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
    """Return the distance [m] from a segment to the solid pyramid over ``base``; 0 if they meet.

    The pyramid's surface consists of its base and a triangle for each side of the base.  If the segment is
    outside, its nearest point to a face is an end of the segment, or the face's nearest point is on an edge.
    A segment that meets the pyramid crosses a face or has an end inside.

    Args:
        start: (3,) An end of the segment [m]; all points are in one frame.
        end: (3,) The other end [m]; it may equal ``start``.
        apex: (3,) The tip [m].
        base: (n, 3) The corners [m] of a flat simple polygon, in order along its outline.

    """
    n = base.shape[0]
    normal = _normal(base)
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
    """Return the unit normal (3,) of a flat ``polygon`` (n, 3) by Newell's sum, or zeros if it has no area.

    The normal is N/|N| with N = sum_k (p_k - p_0) x (p_(k+1) - p_0) over the corners p_k; |N| is twice the
    area.
    """
    normal = np.zeros(3)
    n = polygon.shape[0]
    for k in range(n):
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
    """Return the height n . (p - p_0) [m] of ``point`` p (3,) over ``polygon`` (n, 3).

    n is ``normal`` (3,), and p_0 is the polygon's first corner.
    """
    height = 0.0
    for i in range(3):
        height += normal[i] * (point[i] - polygon[0, i])
    return height


@compiled
def _is_over(point: Array3, polygon: ArrayNx3, normal: Array3) -> bool:
    """Return whether ``point`` (3,) is in the prism along ``normal`` (3,) over ``polygon`` (n, 3).

    By the even-odd rule, the point is inside if a ray from its foot in the plane crosses the outline an odd
    number of times.  The test drops the coordinate in which the normal is largest, so that the outline keeps
    its area.
    """
    drop = 0
    for i in range(1, 3):
        if abs(normal[i]) > abs(normal[drop]):
            drop = i
    if normal[drop] == 0.0:
        return False
    u, v = (drop + 1) % 3, (drop + 2) % 3
    height = _height(point, polygon, normal)
    x, y = point[u] - height * normal[u], point[v] - height * normal[v]
    odd = False
    n = polygon.shape[0]
    for k in range(n):
        a, b = polygon[k], polygon[(k + 1) % n]
        if (a[v] > y) != (b[v] > y) and x < a[u] + (y - a[v]) / (b[v] - a[v]) * (b[u] - a[u]):
            odd = not odd
    return odd


@compiled
def _base_distance(point: Array3, polygon: ArrayNx3, normal: Array3) -> float:
    """Return |n . (p - p_0)| [m] for a point over the polygon, or infinity if the polygon's edges are nearer.

    ``point`` p (3,), ``polygon`` (n, 3) and ``normal`` n (3,) are as in ``_height``.
    """
    return abs(_height(point, polygon, normal)) if _is_over(point, polygon, normal) else np.inf


@compiled
def _crosses(start: Array3, end: Array3, polygon: ArrayNx3, normal: Array3) -> bool:
    """Return whether the segment crosses ``polygon`` (n, 3) with ``normal`` (3,).

    It does if the ends ``start`` and ``end`` (3,) have heights h_0 and h_1 of different sign.  In addition,
    the polygon must contain the point at the share h_0/(h_0 - h_1) of the segment.
    """
    below, above = _height(start, polygon, normal), _height(end, polygon, normal)
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

    Let h be the height of the point p over ``base`` (n, 3) with ``normal`` (3,), and H the height of ``apex``
    (3,).  The point is inside if 0 <= h/H < 1, and if the line from the apex a through p meets the base, at a
    + (p - a)/(1 - h/H).
    """
    top, height = _height(apex, base, normal), _height(point, base, normal)
    if top == 0.0 or not 0.0 <= height / top < 1.0:
        return False
    share = 1.0 / (1.0 - height / top)
    shadow = np.empty(3)
    for i in range(3):
        shadow[i] = apex[i] + share * (point[i] - apex[i])
    return _is_over(shadow, base, normal)
