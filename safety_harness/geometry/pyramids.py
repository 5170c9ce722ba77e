"""How near a segment comes to a pyramid: what stands between a camera and a flat object."""

from __future__ import annotations

from math import sqrt

import numpy as np
from numpy.typing import NDArray

from safety_harness.compiled import compiled
from safety_harness.geometry.segments import segment_segment_distance


@compiled
def segment_pyramid_distance(
    start: NDArray[np.float64],  # (3,)
    end: NDArray[np.float64],  # (3,), may be the start
    apex: NDArray[np.float64],  # (3,)
    base: NDArray[np.float64],  # (n, 3) corners of a flat simple polygon, one after another
) -> float:
    """Distance [m] from a segment to the solid pyramid over ``base``; 0 where they meet.

    The pyramid's surface is its base and a triangle for each side.  A segment outside it is nearest
    to one of these faces, at one of its own ends or at an edge; one that reaches in crosses a face or
    has an end within.
    """
    n = base.shape[0]
    normal = _normal(base)
    if _within(start, apex, base, normal) or _within(end, apex, base, normal):
        return 0.0
    least = min(_base_distance(start, base, normal), _base_distance(end, base, normal))
    if _crosses(start, end, base, normal):
        return 0.0
    triangle = np.empty((3, 3))
    for k in range(n):
        a, b = base[k], base[(k + 1) % n]
        least = min(least, segment_segment_distance(start, end, a, b))
        least = min(least, segment_segment_distance(start, end, apex, a))
        triangle[0], triangle[1], triangle[2] = apex, a, b
        side = _normal(triangle)
        if _crosses(start, end, triangle, side):
            return 0.0
        least = min(least, _base_distance(start, triangle, side), _base_distance(end, triangle, side))
    return least


@compiled
def _normal(polygon: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3,) unit normal of a flat polygon by Newell's sum; zeros for one without an area."""
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
def _height(point: NDArray[np.float64], polygon: NDArray[np.float64], normal: NDArray[np.float64]) -> float:
    height = 0.0
    for i in range(3):
        height += normal[i] * (point[i] - polygon[0, i])
    return height


@compiled
def _over(point: NDArray[np.float64], polygon: NDArray[np.float64], normal: NDArray[np.float64]) -> bool:
    """Is a point in the prism along ``normal`` over a polygon?  Even-odd rule, along the largest axis."""
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
def _base_distance(
    point: NDArray[np.float64], polygon: NDArray[np.float64], normal: NDArray[np.float64]
) -> float:
    """Distance to a polygon's plane for a point over the polygon, else infinity: its edges are nearer."""
    return abs(_height(point, polygon, normal)) if _over(point, polygon, normal) else np.inf


@compiled
def _crosses(
    start: NDArray[np.float64],
    end: NDArray[np.float64],
    polygon: NDArray[np.float64],
    normal: NDArray[np.float64],
) -> bool:
    """Does a segment go through a polygon?"""
    below, above = _height(start, polygon, normal), _height(end, polygon, normal)
    if below == above or (below > 0.0) == (above > 0.0):
        return False
    share = below / (below - above)
    point = np.empty(3)
    for i in range(3):
        point[i] = start[i] + share * (end[i] - start[i])
    return _over(point, polygon, normal)


@compiled
def _within(
    point: NDArray[np.float64],
    apex: NDArray[np.float64],
    base: NDArray[np.float64],
    normal: NDArray[np.float64],
) -> bool:
    """Is a point inside the pyramid: between base and apex, and seen from there over the base?"""
    top, height = _height(apex, base, normal), _height(point, base, normal)
    if top == 0.0 or not 0.0 <= height / top < 1.0:
        return False
    share = 1.0 / (1.0 - height / top)
    shadow = np.empty(3)
    for i in range(3):
        shadow[i] = apex[i] + share * (point[i] - apex[i])
    return _over(shadow, base, normal)
