from __future__ import annotations

from fractions import Fraction
from itertools import product
from math import comb, factorial

import cv2
import numpy as np
import pytest
from disagreement import noted

from safety_harness.cell.perception.moments import (
    FIRST_MU,
    M00,
    MOMENT_COUNT,
    XG,
    YG,
    mu_index,
    point_moments,
    polygon_moments,
)

ORDERS = [(i, j) for i in range(7) for j in range(7 - i)]
TRIANGLE = np.array([[0.11, 0.05], [0.11, -0.13], [-0.02, 0.05]])
ARROW = np.array([[0.0, 0.0], [0.2, 0.03], [0.21, 0.18], [0.1, 0.06], [-0.04, 0.12]])  # not convex


def moments_of(vertices: np.ndarray) -> np.ndarray:
    out = np.empty(MOMENT_COUNT)
    assert polygon_moments(vertices, out)
    return out


def exact_triangle_moment(corners: list[tuple[Fraction, Fraction]], i: int, j: int) -> Fraction:
    """Integral of x^i y^j: expand in barycentric coordinates, whose integrals are factorials."""
    (x0, y0), (x1, y1), (x2, y2) = corners
    twice_area = abs((x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0))
    total = Fraction(0)
    for a, b in product(range(i + 1), repeat=2):
        if a + b > i:
            continue
        x_part = comb(i, a) * comb(i - a, b) * x0**a * x1**b * x2 ** (i - a - b)
        for c, d in product(range(j + 1), repeat=2):
            if c + d > j:
                continue
            y_part = comb(j, c) * comb(j - c, d) * y0**c * y1**d * y2 ** (j - c - d)
            p, q, r = a + c, b + d, i + j - a - b - c - d
            integral = Fraction(factorial(p) * factorial(q) * factorial(r), factorial(i + j + 2))
            total += x_part * y_part * twice_area * integral
    return total


def test_every_centred_moment_has_its_own_place() -> None:
    places = sorted(mu_index(i, j) for i, j in ORDERS)
    assert places == list(range(FIRST_MU, MOMENT_COUNT))


def test_triangle_moments_equal_exact_rational_integration() -> None:
    corners = [
        (Fraction(11, 100), Fraction(5, 99)),
        (Fraction(1, 9), Fraction(-13, 97)),
        (Fraction(-1, 51),) * 2,
    ]
    xg, yg = (sum(c[k] for c in corners) / 3 for k in range(2))
    centred = [(x - xg, y - yg) for x, y in corners]
    out = moments_of(np.array([[float(x), float(y)] for x, y in corners]))
    assert out[M00] == pytest.approx(float(exact_triangle_moment(corners, 0, 0)), rel=1e-14)
    assert out[XG] == pytest.approx(float(xg), rel=1e-14)
    assert out[YG] == pytest.approx(float(yg), rel=1e-14)
    for i, j in ORDERS:
        scale = out[M00] * 0.1 ** (i + j)
        expected = float(exact_triangle_moment(centred, i, j))
        assert out[mu_index(i, j)] == pytest.approx(expected, rel=1e-13, abs=1e-15 * scale)


def test_polygon_moments_equal_sums_over_a_fine_grid() -> None:
    """Brute force: eq. 6 over the midpoints of small cells inside a polygon that is not convex."""
    step = 2.5e-4
    x, y = np.meshgrid(np.arange(-0.05, 0.22, step), np.arange(-0.01, 0.2, step))
    inside = np.zeros(x.shape, dtype=bool)
    for (x0, y0), (x1, y1) in zip(ARROW, np.roll(ARROW, -1, axis=0), strict=True):
        if y0 != y1:
            inside ^= ((y0 <= y) != (y1 <= y)) & (x < x0 + (y - y0) / (y1 - y0) * (x1 - x0))
    x, y = x[inside], y[inside]
    out = moments_of(ARROW)
    assert out[M00] == pytest.approx(len(x) * step**2, rel=1e-3)
    assert out[XG] == pytest.approx(x.mean(), rel=1e-3)
    assert out[YG] == pytest.approx(y.mean(), rel=1e-3)
    for i, j in ORDERS:
        powers = (x - x.mean()) ** i * (y - y.mean()) ** j
        size = np.abs(powers).sum() * step**2
        assert out[mu_index(i, j)] == pytest.approx(powers.sum() * step**2, abs=2e-3 * size)


def test_polygon_moments_equal_those_of_opencv_to_order_three() -> None:
    peer = cv2.moments(np.ascontiguousarray(ARROW * 1000.0, dtype=np.float32))
    out = moments_of(ARROW * 1000.0)
    centroid = (peer["m10"] / peer["m00"], peer["m01"] / peer["m00"])
    noted("OpenCV", "centroid of a polygon", "parts of its size", out[[XG, YG]], centroid, 1e-3)
    assert out[M00] == pytest.approx(peer["m00"], rel=1e-6)
    assert out[XG] == pytest.approx(peer["m10"] / peer["m00"], rel=1e-6)
    for i, j in ORDERS:
        if 2 <= i + j <= 3:
            size = out[M00] * 80.0 ** (i + j)
            assert out[mu_index(i, j)] == pytest.approx(peer[f"mu{i}{j}"], rel=1e-5, abs=1e-6 * size)


@pytest.mark.parametrize("vertices", [TRIANGLE, ARROW])
def test_winding_and_first_vertex_do_not_matter(vertices: np.ndarray) -> None:
    expected = moments_of(vertices)
    for variant in (vertices[::-1].copy(), np.roll(vertices, 1, axis=0), np.roll(vertices[::-1], 2, axis=0)):
        np.testing.assert_allclose(moments_of(variant), expected, rtol=1e-11, atol=1e-22)
    assert expected[M00] > 0.0


@pytest.mark.parametrize("vertices", [TRIANGLE, ARROW])
def test_a_shift_moves_the_centroid_only(vertices: np.ndarray) -> None:
    shift = np.array([0.4, -0.3])
    before, after = moments_of(vertices), moments_of(vertices + shift)
    np.testing.assert_allclose(after[[XG, YG]] - before[[XG, YG]], shift, rtol=1e-13)
    for i, j in ORDERS:
        size = before[M00] * 0.1 ** (i + j)
        assert after[mu_index(i, j)] == pytest.approx(before[mu_index(i, j)], abs=1e-12 * size)


def test_moments_scale_with_the_size_to_their_order_plus_two() -> None:
    before, after = moments_of(ARROW), moments_of(2.0 * ARROW)
    for i, j in ORDERS:
        assert after[mu_index(i, j)] == pytest.approx(
            2.0 ** (i + j + 2) * before[mu_index(i, j)], rel=1e-12, abs=1e-22
        )


def test_point_moments_are_eq_6() -> None:
    points = np.random.default_rng(4).uniform(-0.3, 0.3, (7, 2))
    out = np.empty(MOMENT_COUNT)
    assert point_moments(points, out)
    assert out[M00] == 7.0
    centred = points - points.mean(axis=0)
    np.testing.assert_allclose(out[[XG, YG]], points.mean(axis=0), rtol=1e-14)
    for i, j in ORDERS:
        powers = centred[:, 0] ** i * centred[:, 1] ** j
        assert out[mu_index(i, j)] == pytest.approx(powers.sum(), abs=1e-14 * np.abs(powers).sum())


@pytest.mark.parametrize(
    "vertices",
    [
        np.array([[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]]),
        np.array([[0.0, 0.0], [1.0, np.nan], [2.0, 2.0]]),
        np.array([[0.0, 0.0], [1.0, np.inf], [2.0, 2.0]]),
        np.zeros((3, 2)),
    ],
)
def test_what_has_no_area_has_no_moments(vertices: np.ndarray) -> None:
    out = np.zeros(MOMENT_COUNT)
    assert not polygon_moments(vertices, out)
    assert np.isnan(out).all()


@pytest.mark.parametrize("points", [np.empty((0, 2)), np.array([[0.0, np.nan]])])
def test_no_points_and_points_that_are_not_finite_have_no_moments(points: np.ndarray) -> None:
    out = np.zeros(MOMENT_COUNT)
    assert not point_moments(points, out)
    assert np.isnan(out).all()
