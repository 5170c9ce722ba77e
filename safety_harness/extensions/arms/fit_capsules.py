"""Fit capsules to the shapes of an arm's links; ``safety-harness robot fit`` uses this module.

The fit cuts the surface of each link's collision and visual shapes into pieces of at most ``PIECE_M``. Each
piece is assigned to one capsule, which contains the whole piece. A capsule is convex, so it contains a piece
if it contains the piece's three corners. The capsules together thus contain every triangle. Each piece is
assigned to the capsule that it fits best, as in Lloyd's algorithm. Each capsule then shrinks around its
pieces to the least volume. The fit runs from several random starts and keeps the result whose capsules have
the smallest union. A link has at most ``MOST_CAPSULES`` capsules. A further capsule is added only if it
reduces the volume by at least the fraction ``WORTH``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.spatial import ConvexHull, QhullError, cKDTree

from safety_harness.base.compiled import compiled
from safety_harness.base.extras import FITTING
from safety_harness.base.geometry.arrays import Array3, ArrayNx3
from safety_harness.base.geometry.segments import point_segment_distance
from safety_harness.base.whole_file import write_text
from safety_harness.cell.robot.capsules import StoredCapsule, StoredCapsules, hashes_of
from safety_harness.cell.robot.description import ArmModel, LinkShapes, Shape
from safety_harness.cell.robot.urdf import ArmFileError

PIECE_M = 0.025  # longest edge of a piece in the first rounds
GRID_M = 0.006  # step of the grid that measures the volume of the union
STARTS = 20  # random starts of a fit with more than one capsule
ROUNDS = 15  # the most rounds of Lloyd's algorithm
# The least fraction of the volume that a further capsule must remove.  On the UR10, a second capsule would
# remove only 5 to 10 % at the shoulder and the wrists.
WORTH = 0.1
MOST_CAPSULES = 4  # a choice: each capsule costs time in every distance
LONGEST_M = 4.0  # of a link; a mesh in millimetres would seem a thousand times as long
ROUND = 32  # sides of the prism that replaces a cylinder
POLISH_ROUNDS = 12
FINE_M = 0.004  # longest edge of a piece in the last rounds, where capsules meet
DECIMALS = 4  # 0.1 mm

Capsule = tuple[NDArray[np.float64], NDArray[np.float64], float]  # start, end, radius


@dataclass(frozen=True, eq=False)
class Surface:
    """The triangles of a link, in the link frame.

    A row of ``faces`` (n, 3) has the indices of the three corners in ``vertices`` (v, 3) [m].
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]

    @property
    def centres(self) -> NDArray[np.float64]:
        """The centres of the triangles (n, 3) [m]."""
        centres: NDArray[np.float64] = self.vertices[self.faces].mean(axis=1)
        return centres

    @property
    def areas(self) -> NDArray[np.float64]:
        """The areas of the triangles (n,) [m^2]."""
        a, b, c = np.moveaxis(self.vertices[self.faces], 1, 0)
        areas: NDArray[np.float64] = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
        return areas

    def corners(self, chosen: NDArray[np.bool_]) -> NDArray[np.float64]:
        """Return the vertices of the selected triangles without duplicates, shape (k, 3).

        ``chosen`` (n,) is True for each selected triangle.
        """
        return self.vertices[np.unique(self.faces[chosen])]


def _faces(shape: Shape) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return vertices (v, 3) [m] and triangles (n, 3) of a shape in its own frame.

    A round shape is replaced by a polyhedron that encloses it.
    """
    trimesh = _trimesh()
    if shape.kind == "mesh":
        if str(shape.file).lower().endswith(".dae"):
            import_module("collada")  # trimesh needs it to read the file
        try:
            mesh = trimesh.load_mesh(shape.file)
            vertices = np.asarray(mesh.vertices) * (shape.size * _metres_a_unit(mesh))
            faces = np.asarray(mesh.faces)
        except Exception as error:  # trimesh's readers of a dozen formats may raise anything
            raise _of_mesh(shape, "a mesh that can be read", f"{type(error).__name__}: {error}") from error
        if vertices.ndim != 2 or len(faces) == 0 or not np.isfinite(vertices).all():
            raise _of_mesh(shape, "triangles with finite corners", f"{len(faces)} triangles")
        if np.ptp(vertices, axis=0).max() > LONGEST_M:
            got = f"one of {np.ptp(vertices, axis=0).max():.4g} m: if it is in millimetres, scale it by 0.001"
            raise _of_mesh(shape, f"a mesh of at most {LONGEST_M:g} m", got)
        return vertices, faces
    if shape.kind == "box":
        mesh = trimesh.creation.box(extents=shape.size)
    elif shape.kind == "cylinder":
        radius, height = shape.size
        # The flat sides of the prism must not cut into the cylinder.
        mesh = trimesh.creation.cylinder(radius / np.cos(np.pi / ROUND), height, sections=ROUND)
    else:
        mesh = trimesh.creation.icosphere(subdivisions=3)
        # Enlarge the polyhedron until its nearest face touches the sphere from outside.
        nearest = np.abs((mesh.triangles_center * mesh.face_normals).sum(axis=1)).min()
        mesh.apply_scale(shape.size[0] / nearest)
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)


def _metres_a_unit(mesh: Any) -> float:
    """Return the length [m] of the unit that a COLLADA file states.

    The file's up axis is ignored, as ROS's tools ignore it.
    """
    number, _, rest = str(mesh.metadata.get("units", "")).partition(" ")
    return float(number) if rest == "* meters" else 1.0


def _trimesh() -> Any:
    import trimesh

    return trimesh


def _of_mesh(shape: Shape, expected: str, got: str) -> ArmFileError:
    return ArmFileError.of_file(shape.file or Path(), expected, got)


def link_surface(link: LinkShapes, longest_m: float) -> Surface:
    """Return the triangles of all shapes of a link, subdivided until no edge is longer than ``longest_m``."""
    vertices, faces, count = [], [], 0
    with FITTING.needed("robot fit"):
        for part in (*link.collision, *link.visual):
            points, triangles, *_ = _trimesh().remesh.subdivide_to_size(*_faces(part), longest_m)
            turn, shift = part.transform_shape_to_link[:3, :3], part.transform_shape_to_link[:3, 3]
            vertices.append(points @ turn.T + shift)
            faces.append(triangles + count)
            count += len(points)
    unique, index = np.unique(np.concatenate(vertices), axis=0, return_inverse=True)
    return Surface(unique, index[np.concatenate(faces)].astype(np.int64))


@compiled
def farthest(points: ArrayNx3, start: Array3, end: Array3) -> float:
    """Return the largest distance [m] from the segment to one of ``points`` (n, 3).

    A capsule about the segment needs this radius to contain all points. ``start`` and ``end`` (3,) [m] are in
    the points' frame.
    """
    largest = 0.0
    for i in range(points.shape[0]):
        largest = max(largest, point_segment_distance(points[i], start, end))
    return largest


@compiled
def inside(points: ArrayNx3, start: Array3, end: Array3, radius: float) -> NDArray[np.bool_]:
    """Return whether each of the ``points`` (n, 3) lies in a capsule, shape (n,).

    The segment of the capsule extends from ``start`` to ``end`` (3,).
    """
    result = np.empty(points.shape[0], dtype=np.bool_)
    for i in range(points.shape[0]):
        result[i] = point_segment_distance(points[i], start, end) <= radius
    return result


@compiled
def assign(
    vertices: ArrayNx3,
    faces: NDArray[np.int64],  # (n, 3)
    starts: ArrayNx3,
    ends: ArrayNx3,
    radii: NDArray[np.float64],  # (k,)
    owner_out: NDArray[np.int64],  # (n,), written
) -> None:
    """Assign each triangle of ``faces`` to the capsule that contains it with the largest margin.

    The margin is the least depth of the three corners below the capsule's surface; it is negative for a
    corner outside the capsule.
    """
    for i in range(faces.shape[0]):
        least = np.inf
        for j in range(radii.shape[0]):
            out = -np.inf
            for k in range(3):
                out = max(out, point_segment_distance(vertices[faces[i, k]], starts[j], ends[j]) - radii[j])
            if out < least:
                least = out
                owner_out[i] = j


def smallest_capsule(points: ArrayNx3, start: Capsule | None) -> Capsule:
    """Return a capsule that contains ``points`` (n, 3) and whose volume is a local minimum.

    The search starts at ``start``, or at the main axes of the points if ``start`` is None.
    """
    try:
        # A capsule is convex: if it contains the hull's corners, it contains all points.
        hull = points[ConvexHull(points).vertices]
    except QhullError:  # all points lie in one plane
        hull = points

    def volume(ends: NDArray[np.float64]) -> float:
        radius = farthest(hull, ends[:3], ends[3:])
        return float(np.pi * radius**2 * (np.linalg.norm(ends[3:] - ends[:3]) + 4.0 / 3.0 * radius)) * 1e6

    answers = []
    for guess in [np.concatenate(start[:2])] if start is not None else _axis_guesses(hull):
        simplex = np.vstack((guess, guess + 0.01 * np.eye(6)))
        # A second search from the first result, because Nelder-Mead can stall with a flat simplex.
        for _ in range(1 if start is not None else 2):
            options = {"initial_simplex": simplex, "maxiter": 600, "xatol": 1e-6, "fatol": 1e-5}
            answer = minimize(volume, guess, method="Nelder-Mead", options=options)
            simplex = np.vstack((answer.x, answer.x + 0.003 * np.eye(6)))
        answers.append(answer)
    best = min(answers, key=lambda fit: fit.fun)
    return best.x[:3], best.x[3:], farthest(hull, best.x[:3], best.x[3:])


def _axis_guesses(hull: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    centre = hull.mean(axis=0)
    guesses = []
    for axis in np.linalg.eigh(np.cov((hull - centre).T))[1].T:
        along = (hull - centre) @ axis
        middle, quarter = (along.max() + along.min()) / 2.0, (along.max() - along.min()) / 4.0
        guesses.append(
            np.concatenate((centre + (middle - quarter) * axis, centre + (middle + quarter) * axis))
        )
    return guesses


def fit_link(surface: Surface, rng: np.random.Generator) -> list[Capsule]:
    """Return a link's capsules.

    Each capsule after the first reduces the volume by at least the fraction ``WORTH``.
    """
    best, volume = fit_capsules(surface, 1, rng)
    for count in range(2, MOST_CAPSULES + 1):
        more, less = fit_capsules(surface, count, rng)
        if less > (1.0 - WORTH) * volume:
            break
        best, volume = more, less
    return best


def fit_capsules(surface: Surface, count: int, rng: np.random.Generator) -> tuple[list[Capsule], float]:
    """Return the best ``count`` capsules that together contain every triangle, and their volume [m^3].

    If no random start succeeds, return no capsules and an infinite volume.
    """
    centres, areas = surface.centres, surface.areas
    low, high = surface.vertices.min(axis=0) - 0.05, surface.vertices.max(axis=0) + 0.05
    axes = [np.arange(low[i], high[i], GRID_M) for i in range(3)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    best: list[Capsule] = []
    least = np.inf
    for _ in range(STARTS if count > 1 else 1):
        if np.count_nonzero(areas) < count:
            break
        seeds = centres[rng.choice(len(centres), count, replace=False, p=areas / areas.sum())]
        owner = np.argmin(((centres[:, None] - seeds) ** 2).sum(axis=2), axis=1)
        capsules = _improve(surface, owner, count)
        if capsules is None:
            continue
        cells = float(np.any([inside(grid, *capsule) for capsule in capsules], axis=0).sum())
        if cells < least:
            best, least = capsules, cells
    return best, least * GRID_M**3


def _improve(surface: Surface, owner: NDArray[np.int64], count: int) -> list[Capsule] | None:
    """Shrink the capsules and reassign the triangles in turn.

    Return None if a capsule has too few corners.
    """
    capsules: list[Capsule] = []
    for _ in range(ROUNDS):
        groups = [surface.corners(owner == j) for j in range(count)]
        if count > 1 and min(len(group) for group in groups) < 12:
            return None
        starts: Sequence[Capsule | None] = capsules or [None] * count
        capsules = [smallest_capsule(group, start) for group, start in zip(groups, starts, strict=True)]
        previous = owner.copy()
        assign(surface.vertices, surface.faces, *_stacked(capsules), owner)
        # Lloyd's rounds hardly change the assignment any more.
        if (owner == previous).mean() > 0.999:
            break
    return capsules


def _stacked(capsules: list[Capsule]) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    starts, ends, radii = zip(*capsules, strict=True)
    return np.array(starts), np.array(ends), np.array(radii)


def needed(surface: Surface, capsules: list[Capsule], index: int) -> NDArray[np.float64]:
    """Return the corners of the triangles that only the capsule ``index`` may contain completely.

    These are the triangles that are not completely inside any other capsule.
    """
    spare = np.zeros(len(surface.faces), dtype=np.bool_)
    for j, (start, end, radius) in enumerate(capsules):
        if j != index:
            enclosed = inside(surface.vertices, start, end, radius)
            # A capsule is convex, so it contains a triangle whose three corners it contains.
            spare |= enclosed[surface.faces].all(axis=1)
    return surface.corners(~spare)


def polish(surface: Surface, capsules: list[Capsule]) -> list[Capsule]:
    """Shrink each capsule in turn around the triangles that only this capsule contains, then round to 0.1 mm.

    Every step preserves coverage, so the final capsules contain every triangle. In the last round, the ends
    are rounded first; the radius is then computed and rounded up.
    """
    capsules = list(capsules)
    for last in [False] * (POLISH_ROUNDS if len(capsules) > 1 else 1) + [True]:
        for j, capsule in enumerate(capsules):
            points = needed(surface, capsules, j)
            if not last:
                capsules[j] = smallest_capsule(points, capsule)
                continue
            # Adding zero turns -0.0 into 0.0, so that the file has no negative zero.
            start, end = (np.round(point, DECIMALS) + 0.0 for point in capsule[:2])
            # Rounded up, so that the capsule still contains every corner after the rounding.
            tenths = np.ceil(farthest(points, start, end) * 10**DECIMALS + 1e-6)
            capsules[j] = (start, end, float(np.round(tenths / 10**DECIMALS, DECIMALS)))
    return capsules


def excess(capsules: list[Capsule], surface: Surface, rng: np.random.Generator) -> tuple[float, float]:
    """Return how far the capsules extend beyond the link: the largest and the mean distance [m].

    The distances are measured from random points on the surface of the capsules' union to the link's surface.
    """
    samples = []
    for j, (start, end, radius) in enumerate(capsules):
        axis = end - start
        length = float(np.linalg.norm(axis))
        caps = rng.normal(size=(4000, 3))
        caps /= np.linalg.norm(caps, axis=1, keepdims=True)
        tube = rng.normal(size=(int(4000 * length / (2.0 * radius)), 3))
        tube -= np.outer(tube @ axis, axis) / length**2 if length > 0.0 else 0.0
        tube /= np.linalg.norm(tube, axis=1, keepdims=True)
        points = np.vstack(
            (
                np.where((caps @ axis > 0.0)[:, None], end, start) + radius * caps,
                start + rng.random((len(tube), 1)) * axis + radius * tube,
            )
        )
        rest = [capsule for i, capsule in enumerate(capsules) if i != j]
        hidden = [inside(points, *capsule) for capsule in rest]
        samples.append(points[~np.any(hidden, axis=0)] if rest else points)
    distance = cKDTree(surface.centres).query(np.vstack(samples))[0]
    return float(distance.max()), float(distance.mean())


def fit_mesh(file: Path, scale: float, seed: int = 0) -> tuple[list[Capsule], Surface]:
    """Return the capsules that enclose the mesh of a tool or part, and its surface, both in the mesh's frame.

    Args:
        file: The file of the mesh.
        scale: The factor that converts the mesh's lengths to metres.
        seed: The seed of the random starts.

    Raises:
        ArmFileError: The mesh is missing or cannot be used.

    """
    if not file.is_file():
        raise ArmFileError.of_file(file, "a mesh", "no file of that name")
    shape = Shape(kind="mesh", size=np.full(3, scale), transform_shape_to_link=np.eye(4), file=file)
    link = LinkShapes(link=file.stem, index=0, collision=(shape,), visual=())
    capsules = fit_link(link_surface(link, PIECE_M), np.random.default_rng(seed))
    surface = link_surface(link, FINE_M)
    return polish(surface, capsules), surface


def fit_arm(
    arm: ArmModel,
    seed: int = 0,
    progress: Callable[[int, str], None] = lambda done, link: None,
    each: Callable[..., Iterable[list[Capsule]]] = map,
) -> list[tuple[LinkShapes, list[Capsule]]]:
    """Return the capsules of every link that has shapes; the same seed results in the same capsules.

    Args:
        arm: The arm.
        seed: The seed of the random starts.
        progress: Called with the number of finished links and the name of the next link.
        each: The function that maps over the links: ``map``, or the ``map`` of a pool of processes.

    Raises:
        ArmFileError: The arm has no shapes, or a link's shapes have no area.

    """
    links = [link for link in arm.links if link.collision or link.visual]
    if not links:
        raise ArmFileError.of_file(arm.file, "an arm with shapes", "none at all")
    result = []
    progress(0, links[0].link)
    for link, capsules in zip(links, each(partial(_fitted, seed=seed), links), strict=True):
        if not capsules:
            raise ArmFileError.of_file(arm.file, f"shapes with an area for {link.link!r}", "none with one")
        result.append((link, capsules))
        progress(len(result), links[len(result)].link if len(result) < len(links) else "")
    return result


def _fitted(link: LinkShapes, seed: int) -> list[Capsule]:
    """Return the capsules of one link; the list is empty if the surface of the link has no area."""
    capsules = fit_link(link_surface(link, PIECE_M), np.random.default_rng((seed, link.index)))
    if not capsules:
        return []
    return polish(link_surface(link, FINE_M if len(capsules) > 1 else PIECE_M), capsules)


def write_capsules(file: Path, arm: ArmModel, fitted: list[tuple[LinkShapes, list[Capsule]]]) -> None:
    """Write an arm's capsules in the format that ``read_capsules`` reads; raise OutputError if that fails."""
    urdf, meshes = hashes_of(arm)
    capsules = [
        StoredCapsule(
            name=link.link.removesuffix("_link") + (f"_{i}" if len(of_link) > 1 else ""),
            link=link.link,
            start_in_link_m=tuple(start.tolist()),
            end_in_link_m=tuple(end.tolist()),
            radius_m=radius,
        )
        for link, of_link in fitted
        for i, (start, end, radius) in enumerate(of_link, start=1)
    ]
    stored = StoredCapsules(
        arm=arm.name,
        capsules=capsules,
        base=arm.link_names[0],
        tcp=arm.tcp_link,
        urdf_sha256=urdf,
        meshes_sha256=meshes,
    )
    write_text(file, msgspec.json.format(msgspec.json.encode(stored), indent=1).decode() + "\n")
