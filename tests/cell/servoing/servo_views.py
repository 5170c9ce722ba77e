"""Camera poses and what is seen from them, for the tests of servoing."""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from safety_harness.cell.perception.camera import object_plane, polygon_in_camera, project
from safety_harness.cell.perception.moments import MOMENT_COUNT, point_moments, polygon_moments

TRIANGLE_M = np.array([[-0.040, -0.030], [0.080, -0.030], [-0.040, 0.060]])
POINTS_M = np.array([[-0.04, -0.03], [0.08, -0.03], [-0.04, 0.06], [0.05, 0.07], [0.0, 0.02]])
DESIRED_AREA, DESIRED_DEPTH_M = 0.0128, 0.65


def object_to_camera(
    turn_rad: tuple[float, float, float] | np.ndarray, position_m: tuple[float, float, float] | np.ndarray
) -> np.ndarray:
    """The object faces the camera (its z axis against the view), then turned about the camera axes."""
    transform = np.eye(4)
    transform[:3, :3] = Rotation.from_rotvec(turn_rad).as_matrix() @ np.diag([1.0, -1.0, -1.0])
    transform[:3, 3] = position_m
    return transform


def random_views(seed: int, count: int, tilt_rad: float) -> list[np.ndarray]:
    """``transform_object_to_camera`` with tilts up to ``tilt_rad`` and any turn about the view."""
    rng = np.random.default_rng(seed)
    views = []
    for _ in range(count):
        spin = Rotation.from_rotvec([0.0, 0.0, rng.uniform(-np.pi, np.pi)])
        tilt = Rotation.from_rotvec([*rng.uniform(-tilt_rad, tilt_rad, 2), 0.0])
        turn = (tilt * spin).as_rotvec()
        views.append(object_to_camera(turn, rng.uniform([-0.15, -0.1, 0.45], [0.15, 0.1, 1.0])))
    return views


def moved(view: np.ndarray, twist: np.ndarray, duration_s: float) -> np.ndarray:
    """The view after the camera moved with a constant twist in its own frame (matrix exponential)."""
    v, (a, b, c) = twist[:3], twist[3:]
    generator = np.array([[0.0, -c, b, v[0]], [c, 0.0, -a, v[1]], [-b, a, 0.0, v[2]], [0.0, 0.0, 0.0, 0.0]])
    return expm(-duration_s * generator) @ view


def moments_at(view: np.ndarray, *, dense: bool) -> np.ndarray:
    """Moment vector (31,) of the triangle (dense) or of the points (discrete)."""
    shape_m = TRIANGLE_M if dense else POINTS_M
    in_camera, normalised, out = (
        np.empty((len(shape_m), 3)),
        np.empty((len(shape_m), 2)),
        np.empty(MOMENT_COUNT),
    )
    polygon_in_camera(shape_m, view, in_camera)
    assert project(in_camera, normalised)
    assert (polygon_moments if dense else point_moments)(normalised, out)
    return out


def plane_at(view: np.ndarray) -> np.ndarray:
    """(A, B, C) of the object's plane."""
    out = np.empty(3)
    assert object_plane(view, out)
    return out
