from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from safety_harness.base.settings import DEFAULTS
from safety_harness.cell.perception.camera import (
    NEAR_PLANE_M,
    object_plane,
    polygon_in_camera,
    polygon_inside_image,
    principal_point_px,
    project,
    transform_camera_to_tcp,
)

CAMERA = DEFAULTS.camera


def random_transform(rng: np.random.Generator) -> np.ndarray:
    transform = np.eye(4)
    transform[:3, :3] = Rotation.from_rotvec(rng.normal(size=3)).as_matrix()
    transform[:3, 3] = rng.uniform([-0.2, -0.2, 0.8], [0.2, 0.2, 1.2])
    return transform


def test_at_the_desired_pose_the_image_runs_along_negative_base_y_and_x() -> None:
    tcp_to_base = np.eye(4)
    tcp_to_base[:3, :3] = np.diag([1.0, -1.0, -1.0])
    tcp_to_base[:3, 3] = DEFAULTS.cell.desired_tcp_position_in_base_m
    camera_to_base = tcp_to_base @ transform_camera_to_tcp(CAMERA, calibrated=False)
    np.testing.assert_allclose(camera_to_base[:3, 0], [0.0, -1.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(camera_to_base[:3, 1], [-1.0, 0.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(camera_to_base[:3, 2], [0.0, 0.0, -1.0], atol=1e-15)
    np.testing.assert_allclose(camera_to_base[:3, 3], tcp_to_base[:3, 3] + [0.0, 0.045, 0.0], atol=1e-15)


def test_calibration_error_is_believed_but_does_not_move_the_camera() -> None:
    turn, shift = (0.02, -0.01, 0.03), (0.001, 0.002, -0.003)
    erring = replace(CAMERA, calibration_error_rotation_rad=turn, calibration_error_offset_m=shift)
    true = transform_camera_to_tcp(erring, calibrated=False)
    believed = transform_camera_to_tcp(erring, calibrated=True)
    np.testing.assert_array_equal(true, transform_camera_to_tcp(CAMERA, calibrated=False))
    np.testing.assert_allclose(believed[:3, 3] - true[:3, 3], shift, atol=1e-15)
    error_in_camera = Rotation.from_matrix(true[:3, :3].T @ believed[:3, :3]).as_rotvec()
    np.testing.assert_allclose(error_in_camera, turn, atol=1e-14)


def test_without_error_the_calibration_is_the_mount() -> None:
    np.testing.assert_array_equal(
        transform_camera_to_tcp(CAMERA, calibrated=True), transform_camera_to_tcp(CAMERA, calibrated=False)
    )


def test_projection_keeps_the_direction_of_every_ray() -> None:
    rng = np.random.default_rng(1)
    points = rng.uniform([-1.0, -1.0, 0.1], [1.0, 1.0, 2.1], (20, 3))
    normalised = np.empty((20, 2))
    assert project(points, normalised)
    np.testing.assert_allclose(np.column_stack([normalised, np.ones(20)]) * points[:, 2:], points, rtol=1e-15)


@pytest.mark.parametrize("depth_m", [NEAR_PLANE_M, 0.0, -1.0, np.nan])
def test_one_point_not_beyond_the_near_plane_makes_the_projection_fail(depth_m: float) -> None:
    points = np.array([[0.0, 0.0, 1.0], [0.1, 0.0, depth_m]])
    assert not project(points, np.empty((2, 2)))


def test_points_of_the_object_lie_on_its_plane() -> None:
    rng = np.random.default_rng(2)
    for _ in range(50):
        transform = random_transform(rng)
        polygon_m = rng.uniform(-0.1, 0.1, (5, 2))
        in_camera, plane = np.empty((5, 3)), np.empty(3)
        polygon_in_camera(polygon_m, transform, in_camera)
        assert object_plane(transform, plane)
        x, y = in_camera[:, 0] / in_camera[:, 2], in_camera[:, 1] / in_camera[:, 2]
        size = np.abs(plane).max()  # a grazing plane has large coefficients that cancel
        np.testing.assert_allclose(
            plane[0] * x + plane[1] * y + plane[2], 1.0 / in_camera[:, 2], atol=1e-12 * size
        )


def test_object_vertices_are_those_of_the_homogeneous_transform() -> None:
    rng = np.random.default_rng(3)
    transform, polygon_m, in_camera = random_transform(rng), rng.normal(size=(4, 2)), np.empty((4, 3))
    polygon_in_camera(polygon_m, transform, in_camera)
    homogeneous = np.column_stack([polygon_m, np.zeros(4), np.ones(4)])
    np.testing.assert_allclose(in_camera, (homogeneous @ transform.T)[:, :3], atol=1e-14)


def test_plane_through_the_centre_of_projection_is_refused() -> None:
    edge_on = np.eye(4)
    edge_on[:3, :3] = Rotation.from_rotvec([np.pi / 2, 0.0, 0.0]).as_matrix()
    edge_on[:3, 3] = edge_on[:3, 0]
    edge_on[:3, 2] = [0.0, -1.0, 0.0]
    assert not object_plane(edge_on, np.empty(3))


def test_polygon_is_inside_up_to_one_pixel_from_the_outermost_rows_and_columns() -> None:
    width_px, height_px, focal_px = 64, 48, 50.0
    c_u, c_v = principal_point_px(width_px, height_px)
    hair = 1e-9

    def inside(u: float, v: float) -> bool:
        middle = [0.0, 0.0]
        corner = [(u - c_u) / focal_px, (v - c_v) / focal_px]
        return bool(polygon_inside_image(np.array([middle, corner, middle]), focal_px, width_px, height_px))

    assert inside(1.0 + hair, 1.0 + hair)
    assert inside(62.0 - hair, 46.0 - hair)
    assert not inside(1.0 - hair, 20.0)
    assert not inside(62.0 + hair, 20.0)
    assert not inside(20.0, 1.0 - hair)
    assert not inside(20.0, 46.0 + hair)
    assert not inside(np.nan, 20.0)
    assert not inside(20.0, np.nan)


def test_the_optical_axis_meets_the_middle_of_an_image_whose_pixel_centres_are_integers() -> None:
    for width_px, height_px in ((640, 480), (3, 5)):
        c_u, c_v = principal_point_px(width_px, height_px)
        assert c_u == np.mean(np.arange(width_px))
        assert c_v == np.mean(np.arange(height_px))
