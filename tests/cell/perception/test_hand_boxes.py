from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from safety_harness.base.settings import DetectorKind, HandSensor
from safety_harness.cell.perception.hand_boxes import (
    box_in_image,
    line_of_sight_blocked,
    position_from_box,
    rendered_principal_point_px,
    sensor_principal_point_px,
    sphere_box,
)

WIDTH, HEIGHT, FOCAL = 640, 480, 615.0
C_U, C_V = (WIDTH - 1) / 2, (HEIGHT - 1) / 2
RADIUS = 0.06


def box_of(centre: NDArray[np.float64], radius_m: float = RADIUS) -> NDArray[np.float64]:
    box = np.full(5, np.nan)
    assert sphere_box(centre, radius_m, FOCAL, C_U, C_V, box)
    return box


def edges(box: NDArray[np.float64]) -> NDArray[np.float64]:  # left, right, top, bottom
    width, height = np.sqrt(box[3] * box[4]), np.sqrt(box[3] / box[4])
    return np.array([box[0] - width / 2, box[0] + width / 2, box[1] - height / 2, box[1] + height / 2])


def surface_point(box: NDArray[np.float64]) -> NDArray[np.float64]:
    return box[2] * np.array([(box[0] - C_U) / FOCAL, (box[1] - C_V) / FOCAL, 1.0])


def outline_px(centre: NDArray[np.float64], radius_m: float, count: int = 4000) -> NDArray[np.float64]:
    """Pixels of the sphere's outline: the circle in which the rays from the camera touch it."""
    distance = np.linalg.norm(centre)
    towards = centre / distance
    middle = centre * (1 - (radius_m / distance) ** 2)
    circle_radius = radius_m * np.sqrt(1 - (radius_m / distance) ** 2)
    first = np.cross(towards, [1.0, 0.0, 0.0])
    first /= np.linalg.norm(first)
    second = np.cross(towards, first)
    angle = np.linspace(0.0, 2 * np.pi, count, endpoint=False)[:, None]
    points = middle + circle_radius * (np.cos(angle) * first + np.sin(angle) * second)
    return FOCAL * points[:, :2] / points[:, 2:] + (C_U, C_V)


@st.composite
def spheres(draw: st.DrawFn) -> tuple[NDArray[np.float64], float]:
    radius_m = draw(st.floats(0.02, 0.15))
    depth_m = draw(st.floats(1.05, 40.0)) * radius_m
    x, y = draw(st.floats(-0.6, 0.6)), draw(st.floats(-0.5, 0.5))
    return np.array([x * depth_m, y * depth_m, depth_m]), radius_m


@settings(deadline=None)
@given(spheres())
def test_the_box_touches_the_outline_of_the_sphere(sphere: tuple[NDArray[np.float64], float]) -> None:
    centre, radius_m = sphere
    box = box_of(centre, radius_m)
    outline = outline_px(centre, radius_m)
    expected = np.array([outline[:, 0].min(), outline[:, 0].max(), outline[:, 1].min(), outline[:, 1].max()])
    size = np.ptp(outline, axis=0).max()
    # A sampled outline misses its own extreme by at most a second-order amount.
    np.testing.assert_allclose(edges(box), expected, atol=1e-5 * size + 1e-9)


@settings(deadline=None)
@given(spheres())
def test_the_depth_is_that_of_the_front_of_the_sphere(sphere: tuple[NDArray[np.float64], float]) -> None:
    centre, radius_m = sphere
    point = surface_point(box_of(centre, radius_m))
    assert np.linalg.norm(point - centre) == pytest.approx(radius_m, rel=1e-9)
    assert (point - centre) @ point < 0.0  # faces the camera


@pytest.mark.parametrize(
    "centre",
    [
        (0.0, 0.0, 0.0),  # the camera is inside
        (0.0, 0.0, RADIUS),  # the sphere touches the camera
        (0.5, 0.0, 0.5 * RADIUS),  # beside the camera, partly behind its plane
        (0.0, 0.0, -1.0),
        (np.nan, 0.0, 1.0),
        (0.0, 0.0, np.nan),
        (0.0, np.inf, 1.0),
    ],
)
def test_a_sphere_not_wholly_in_front_has_no_box(centre: tuple[float, float, float]) -> None:
    box = np.full(5, 7.0)
    assert not sphere_box(np.array(centre), RADIUS, FOCAL, C_U, C_V, box)
    assert np.all(box == 7.0)


def test_pinhole_position_misses_the_centre_by_the_stated_bias_only() -> None:
    position = np.empty(3)
    worst_mm = {}
    for depth_m in (0.3, 0.6, 1.0, 1.7):
        errors = []
        for u_px in np.linspace(0, WIDTH - 1, 17):
            for v_px in np.linspace(0, HEIGHT - 1, 13):
                centre = depth_m * np.array([(u_px - C_U) / FOCAL, (v_px - C_V) / FOCAL, 1.0])
                position_from_box(box_of(centre), FOCAL, C_U, C_V, RADIUS, position)
                error = np.linalg.norm(position - centre)
                sine = np.hypot(centre[0], centre[1]) / np.linalg.norm(centre)
                miss = sine * RADIUS**2 * depth_m / (depth_m**2 - RADIUS**2)
                bound = np.sqrt(2 * RADIUS * (RADIUS - np.sqrt(RADIUS**2 - miss**2)))
                assert error <= bound * (1 + 1e-9) + 1e-12
                errors.append(error)
        worst_mm[depth_m] = 1000 * max(errors)
    assert worst_mm[0.3] == pytest.approx(6.7, abs=0.05)
    assert worst_mm[1.0] == pytest.approx(2.0, abs=0.05)


def test_pinhole_position_is_exact_on_the_axis() -> None:
    position = np.empty(3)
    position_from_box(box_of(np.array([0.0, 0.0, 0.8])), FOCAL, C_U, C_V, RADIUS, position)
    np.testing.assert_allclose(position, [0.0, 0.0, 0.8], atol=1e-12)


def test_a_wrong_assumed_radius_errs_by_its_error_along_the_ray() -> None:
    box = box_of(np.array([0.2, -0.1, 0.8]))
    right, wrong = np.empty(3), np.empty(3)
    position_from_box(box, FOCAL, C_U, C_V, RADIUS, right)
    position_from_box(box, FOCAL, C_U, C_V, RADIUS + 0.02, wrong)
    np.testing.assert_allclose(wrong - right, 0.02 * right / np.linalg.norm(right), atol=1e-12)


def test_a_box_inside_the_image_is_left_alone() -> None:
    centre = np.array([0.1, -0.05, 1.0])
    box = box_of(centre)
    before = box.copy()
    assert box_in_image(centre, RADIUS, FOCAL, C_U, C_V, WIDTH, HEIGHT, box)
    assert np.array_equal(box, before)


@settings(max_examples=300, deadline=None)
@given(spheres())
def test_a_hand_is_visible_exactly_while_its_centre_is_and_cut_at_the_border(
    sphere: tuple[NDArray[np.float64], float],
) -> None:
    centre, radius_m = sphere
    u_px, v_px = FOCAL * centre[:2] / centre[2] + (C_U, C_V)
    inside = -0.5 <= u_px <= WIDTH - 0.5 and -0.5 <= v_px <= HEIGHT - 0.5
    whole = box_of(centre, radius_m)
    box = whole.copy()
    assert box_in_image(centre, radius_m, FOCAL, C_U, C_V, WIDTH, HEIGHT, box) == inside
    if not inside:
        assert np.array_equal(box, whole)
        return
    low, high = np.array([-0.5, -0.5, -0.5, -0.5]), np.array([WIDTH, WIDTH, HEIGHT, HEIGHT]) - 0.5
    np.testing.assert_allclose(edges(box), np.clip(edges(whole), low, high), rtol=1e-9, atol=1e-8)
    assert np.linalg.norm(surface_point(box) - centre) == pytest.approx(radius_m, rel=1e-6)


def test_a_hand_without_a_surface_at_the_centre_of_its_cut_box_is_not_visible() -> None:
    # Only with an extremely wide lens and close by, at the border of the image.
    wide_px = 50.0
    centre = 1.1 * RADIUS * np.array([0.9 * 320 / wide_px, 0.5 * 240 / wide_px, 1.0])
    box = np.empty(5)
    assert sphere_box(centre, RADIUS, wide_px, C_U, C_V, box)
    before = box.copy()
    assert not box_in_image(centre, RADIUS, wide_px, C_U, C_V, WIDTH, HEIGHT, box)
    assert np.array_equal(box, before)


def least_distance_to_axis(
    start: NDArray[np.float64], end: NDArray[np.float64], capsule: NDArray[np.float64]
) -> float:
    points = start + np.linspace(0, 1, 4001)[:, None] * (end - start)
    axis = capsule[1] - capsule[0]
    share = np.clip((points - capsule[0]) @ axis / (axis @ axis), 0, 1)
    return float(np.linalg.norm(points - capsule[0] - share[:, None] * axis, axis=1).min())


@settings(deadline=None)
@given(st.integers(0, 10_000))
def test_line_of_sight_agrees_with_sampling_the_line(seed: int) -> None:
    rng = np.random.default_rng(seed)
    camera, hand = rng.uniform(-1, 1, (2, 3))
    capsules, radii = rng.uniform(-1, 1, (3, 2, 3)), rng.uniform(0.02, 0.3, 3)
    distance_m = float(np.linalg.norm(camera - hand))
    assume(distance_m > 2 * RADIUS)
    target = hand + RADIUS / distance_m * (camera - hand)
    blocked = False
    for capsule, radius_m in zip(capsules, radii, strict=True):
        gap = least_distance_to_axis(camera, target, capsule) - radius_m
        assume(abs(gap) > 1e-3)
        at_camera = least_distance_to_axis(camera, camera, capsule) <= radius_m
        blocked |= gap < 0 and not at_camera
    assert line_of_sight_blocked(camera, hand, RADIUS, capsules, radii) == blocked


def test_what_lies_behind_the_front_of_the_hand_hides_nothing() -> None:
    camera, hand = np.array([0.0, 0.0, 1.0]), np.zeros(3)
    behind = np.array([[[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]])
    assert not line_of_sight_blocked(camera, hand, RADIUS, behind, np.array([0.9 * RADIUS]))
    assert line_of_sight_blocked(camera, hand, RADIUS, behind, np.array([1.1 * RADIUS]))
    assert not line_of_sight_blocked(hand, hand, RADIUS, behind, np.array([RADIUS]))


def test_no_capsules_block_nothing() -> None:
    assert not line_of_sight_blocked(np.ones(3), np.zeros(3), RADIUS, np.empty((0, 2, 3)), np.empty(0))


def test_principal_point_belongs_to_the_kind_of_image() -> None:
    exact = HandSensor(detector=DetectorKind.EXACT)
    rendered = HandSensor(detector=DetectorKind.RENDERED)
    # The middle of the pixel centres 0 .. w-1.
    assert sensor_principal_point_px(exact) == (np.arange(640).mean(), np.arange(480).mean())
    assert sensor_principal_point_px(rendered) == rendered_principal_point_px(640, 480)
