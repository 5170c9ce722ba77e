from __future__ import annotations

import numpy as np
import pytest

from safety_harness.cell.perception.camera import polygon_inside_image, principal_point_px
from safety_harness.cell.perception.moments import M00, MOMENT_COUNT, XG, YG, mu_index, polygon_moments
from safety_harness.cell.perception.raster import mask_moments, raster_moments

ORDERS = [(i, j) for i in range(7) for j in range(7 - i)]
FOCAL_PX, WIDTH_PX, HEIGHT_PX = 128.0, 128, 96  # a power of two: pixel corners survive the division


def normalised(corners_px: np.ndarray) -> np.ndarray:
    return (corners_px - principal_point_px(WIDTH_PX, HEIGHT_PX)) / FOCAL_PX


def centres_inside(corners_px: np.ndarray) -> np.ndarray:
    """Mask (h, w) by testing every pixel centre on its own, with the even-odd rule."""
    v, u = np.mgrid[0:HEIGHT_PX, 0:WIDTH_PX].astype(float)
    inside = np.zeros(u.shape, dtype=bool)
    for (u0, v0), (u1, v1) in zip(corners_px, np.roll(corners_px, -1, axis=0), strict=True):
        if v0 != v1:
            inside ^= ((v0 <= v) != (v1 <= v)) & (u < u0 + (v - v0) / (v1 - v0) * (u1 - u0))
    return inside


def brute_force(mask: np.ndarray) -> np.ndarray:
    """Eq. 6 over the pixels of a mask, each of area 1/f^2."""
    v, u = np.nonzero(mask)
    c_u, c_v = principal_point_px(WIDTH_PX, HEIGHT_PX)
    x, y = (u - c_u) / FOCAL_PX, (v - c_v) / FOCAL_PX
    out = np.empty(MOMENT_COUNT)
    out[M00], out[XG], out[YG] = len(x) / FOCAL_PX**2, x.mean(), y.mean()
    for i, j in ORDERS:
        out[mu_index(i, j)] = np.sum((x - x.mean()) ** i * (y - y.mean()) ** j) / FOCAL_PX**2
    return out


def raster(corners_px: np.ndarray) -> tuple[int, np.ndarray]:
    out = np.empty(MOMENT_COUNT)
    count = raster_moments(normalised(corners_px), FOCAL_PX, WIDTH_PX, HEIGHT_PX, out)
    return count, out


@pytest.mark.parametrize("corners", [3, 4, 7])
def test_rasteriser_equals_a_test_of_every_pixel_centre(corners: int) -> None:
    """Random polygons, crossed ones and cropped ones among them."""
    rng = np.random.default_rng(corners)
    compared = 0
    for _ in range(60):
        corners_px = rng.uniform(-20.0, 1.0, (corners, 2)) + rng.uniform(0.0, 1.0, (corners, 2)) * [160, 130]
        mask = centres_inside(corners_px)
        count, out = raster(corners_px)
        assert count == mask.sum()
        if count > 0:
            np.testing.assert_allclose(out, brute_force(mask), rtol=1e-9, atol=1e-15)
            compared += 1
    assert compared > 50


@pytest.mark.parametrize("dtype", [np.uint8, np.bool_])
def test_mask_moments_equal_sums_over_the_pixels(dtype: type) -> None:
    mask = np.random.default_rng(5).uniform(size=(HEIGHT_PX, WIDTH_PX)) < 0.3
    mask[:20] = mask[:, :30] = False
    out = np.empty(MOMENT_COUNT)
    count = mask_moments(mask.astype(dtype), FOCAL_PX, *principal_point_px(WIDTH_PX, HEIGHT_PX), out)
    assert count == mask.sum()
    np.testing.assert_allclose(out, brute_force(mask), rtol=1e-9, atol=1e-15)


def test_a_shifted_principal_point_shifts_the_centroid_of_a_mask_and_nothing_else() -> None:
    mask = centres_inside(np.array([[20.3, 10.1], [70.2, 30.7], [40.9, 80.4]])).astype(np.uint8)
    c_u, c_v = principal_point_px(WIDTH_PX, HEIGHT_PX)
    here, there = np.empty(MOMENT_COUNT), np.empty(MOMENT_COUNT)
    mask_moments(mask, FOCAL_PX, c_u, c_v, here)
    mask_moments(mask, FOCAL_PX, c_u + 0.5, c_v - 0.5, there)
    assert there[XG] - here[XG] == pytest.approx(-0.5 / FOCAL_PX, rel=1e-12)
    assert there[YG] - here[YG] == pytest.approx(0.5 / FOCAL_PX, rel=1e-12)
    np.testing.assert_array_equal(np.delete(here, [XG, YG]), np.delete(there, [XG, YG]))


def test_polygons_that_share_an_edge_share_no_pixel_and_lose_none() -> None:
    """Corners on pixel centres: every rule for a centre on an edge is put to the test."""
    rng = np.random.default_rng(6)
    for _ in range(100):
        left, top = rng.integers(1, 40, 2)
        right, bottom = rng.integers(50, 90, 2)
        square = np.array([[left, top], [right, top], [right, bottom], [left, bottom]], dtype=float)
        inner = np.array([rng.integers(left + 1, right), rng.integers(top + 1, bottom)], dtype=float)
        parts = [raster(np.array([square[k], square[(k + 1) % 4], inner]))[0] for k in range(4)]
        assert sum(parts) == raster(square)[0] == (right - left) * (bottom - top)


def test_finer_pixels_bring_the_sums_nearer_to_the_integrals() -> None:
    triangle = np.array([[0.21, 0.15], [0.16, -0.18], [-0.12, 0.05]])
    exact, out = np.empty(MOMENT_COUNT), np.empty(MOMENT_COUNT)
    polygon_moments(triangle, exact)
    errors = []
    for refinement in (1, 64):
        raster_moments(triangle, 200.0 * refinement, 200 * refinement, 160 * refinement, out)
        size = exact[M00] * np.array([1.0, 1.0, 1.0] + [0.1 ** (i + j) for i, j in sorted_orders()])
        errors.append(np.abs((out - exact) / size).max())
    assert errors[1] < errors[0] / 64  # the error of a sum over an outline falls faster than its step


def sorted_orders() -> list[tuple[int, int]]:
    return sorted(ORDERS, key=lambda order: mu_index(*order))


def test_an_image_full_of_object_counts_every_pixel() -> None:
    count, out = raster(np.array([[-500.0, -500.0], [900.0, -500.0], [900.0, 900.0], [-500.0, 900.0]]))
    assert count == WIDTH_PX * HEIGHT_PX
    np.testing.assert_allclose(out[[XG, YG]], 0.0, atol=1e-15)


@pytest.mark.parametrize("corner", [[300.0, 40.0], [np.nan, 40.0], [np.inf, 40.0], [40.0, 1e300]])
def test_what_covers_no_pixel_or_is_not_finite_has_no_moments(corner: list[float]) -> None:
    out = np.zeros(MOMENT_COUNT)
    corners_px = np.array([corner, [310.0, 40.0], [305.0, 60.0]])
    assert raster_moments(normalised(corners_px), FOCAL_PX, WIDTH_PX, HEIGHT_PX, out) == 0
    assert np.isnan(out).all()


def test_an_empty_mask_has_no_moments() -> None:
    out = np.zeros(MOMENT_COUNT)
    assert mask_moments(np.zeros((5, 7), dtype=np.uint8), 10.0, 3.0, 2.0, out) == 0
    assert np.isnan(out).all()


def test_a_polygon_inside_the_image_leaves_the_outermost_pixels_free() -> None:
    rng = np.random.default_rng(7)
    inside = 0
    for _ in range(300):
        corners_px = rng.uniform(-3.0, 1.0, (3, 2)) + rng.uniform(0.0, 1.0, (3, 2)) * [
            WIDTH_PX + 2,
            HEIGHT_PX + 2,
        ]
        if polygon_inside_image(normalised(corners_px), FOCAL_PX, WIDTH_PX, HEIGHT_PX):
            mask = centres_inside(corners_px)
            assert mask.sum() == mask[1:-1, 1:-1].sum()
            inside += 1
    assert 100 < inside < 300
