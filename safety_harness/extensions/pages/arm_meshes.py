"""Reduce the meshes of an arm to few triangles, for pictures only.

Distances are computed from the arm's capsules, and not from the meshes.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from safety_harness.cell.robot.description import ArmModel, Shape
from safety_harness.extensions.pages.packing import packed

MOST_TRIANGLES = 6_000  # for one arm, which takes some 50 kB on a page
CELLS_M = (0.0002, 0.002, 0.004, 0.006, 0.01, 0.016, 0.025)  # grid cells; corners in one cell are merged
STL = np.dtype([("normal", "<f4", (3,)), ("corners", "<f4", (3, 3)), ("_", "<u2")])

Triangles = NDArray[np.float64]  # (n, 3, 3) corners [m]


@lru_cache(maxsize=16)
def arm_meshes(arm: ArmModel) -> dict[str, Any] | None:
    """Return the packed triangles of all links that have binary STL or OBJ meshes.

    The result is None if there are no such meshes. The result is also None if the triangles cannot be reduced
    to the allowed number. The result omits meshes that cannot be read. For a link without a readable mesh,
    the viewer draws the capsules.
    """
    by_link: dict[int, Triangles] = {}
    for link in arm.links:
        # Collision meshes have fewer triangles in most models.
        shapes = [shape for shape in link.collision or link.visual if shape.kind == "mesh"]
        parts = [part for part in map(_triangles, shapes) if len(part)]
        if parts:
            corners = np.concatenate(parts)
            seat = arm.transform_seat if link.index == 0 else np.eye(4)
            by_link[link.index] = corners @ seat[:3, :3].T + seat[:3, 3]
    for cell_m in CELLS_M:
        meshes = {link: clustered(corners, cell_m) for link, corners in by_link.items()}
        if sum(len(faces) for _, faces in meshes.values()) <= MOST_TRIANGLES:
            return packed_meshes(meshes)
    return None


def packed_meshes(meshes: dict[int, tuple[NDArray[np.float64], NDArray[np.int64]]]) -> dict[str, Any] | None:
    """Return each link's corners (v, 3) [m] and faces (n, 3) in the form that the viewer reads.

    The result is None without meshes.
    """
    columns: dict[str, NDArray[Any]] = {}
    for link, (corners, faces) in meshes.items():
        columns |= {f"corners {link}": corners, f"faces {link}": faces}
    return {"links": list(meshes), **packed(columns)} if meshes else None


def clustered(corners: Triangles, cell_m: float) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Merge the corners within each cell of a grid into their mean.

    Return the corners (v, 3) and the faces (n, 3).

    Args:
        corners: the triangles (n, 3, 3) [m].
        cell_m: the edge of a cell [m].

    """
    points = corners.reshape(-1, 3)
    cells = np.floor((points - points.min(axis=0)) / cell_m)
    # One number for each cell, whose digits are the cell's three indices.
    keys = cells @ (1.0 + cells.max()) ** np.arange(3.0)
    _, index, count = np.unique(keys, return_inverse=True, return_counts=True)
    sums = np.stack([np.bincount(index, weights=axis) for axis in points.T], axis=1)
    faces = index.reshape(-1, 3)
    # A face whose corners were merged has no area.
    whole = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    first = faces[whole].argmin(axis=1)[:, None]  # least corner first, so that equal faces match
    turned = np.take_along_axis(faces[whole], (first + np.arange(3)) % 3, axis=1)
    # One number for each face, so that faces that became equal are kept once.
    code = np.unique(turned @ len(count) ** np.arange(3)[::-1])
    faces = np.stack([code // len(count) ** 2, code // len(count) % len(count), code % len(count)], axis=1)
    return np.round(sums / count[:, None], 4), faces.astype(np.int64)


def _triangles(shape: Shape) -> Triangles:
    """Return a mesh's triangles in its link's frame.

    The array is empty if the file is broken or of another kind.
    """
    file = shape.file or Path()
    try:
        read = {".stl": _stl, ".obj": _obj}.get(file.suffix.lower())
        corners = np.zeros((0, 3, 3)) if read is None else read(file) * shape.size
    except (OSError, ValueError, IndexError):
        return np.zeros((0, 3, 3))
    turn, shift = shape.transform_shape_to_link[:3, :3], shape.transform_shape_to_link[:3, 3]
    return corners @ turn.T + shift if np.isfinite(corners).all() else np.zeros((0, 3, 3))


def _stl(file: Path) -> Triangles:
    # A binary STL begins with a header of 80 bytes and the number of triangles in 4.
    records = np.frombuffer(file.read_bytes()[84:], STL)  # ValueError for a text STL, by its length
    return records["corners"].astype(np.float64)


def _obj(file: Path) -> Triangles:
    points, faces = [], []
    for line in file.read_text(encoding="utf-8").splitlines():
        kind, *fields = line.split() or [""]
        if kind == "v":
            points.append([float(text) for text in fields[:3]])
        elif kind == "f":
            corners = [int(text.split("/")[0]) for text in fields]
            faces += [(corners[0], *pair) for pair in pairwise(corners[1:])]
    index = np.array(faces, np.int64).reshape(-1, 3)
    # OBJ counts corners from 1; negative numbers count from the end.
    return np.array(points).reshape(-1, 3)[np.where(index > 0, index - 1, index)]
