from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize

from safety_harness.base.geometry.pyramids import segment_pyramid_distance

TRIANGLE = np.array([[-0.1, -0.1, 0.0], [0.2, -0.1, 0.0], [-0.1, 0.2, 0.0]])
APEX = np.array([0.0, 0.0, 0.6])
# an L: its notch is the corner at x, y > 0
NOTCHED = np.array([[-1, -1], [1, -1], [1, 0], [0, 0], [0, 1], [-1, 1.0]]) * 0.1
NOTCHED = np.column_stack([NOTCHED, np.zeros(6)])


def by_optimisation(start: np.ndarray, end: np.ndarray, corners: np.ndarray) -> float:
    """Distance of a segment from the hull of corners (4, 3): a quadratic programme."""

    def apart(x: np.ndarray) -> float:
        return float(np.sum((start + x[0] * (end - start) - x[1:] @ corners) ** 2))

    answer = minimize(
        apart,
        np.array([0.5, 0.25, 0.25, 0.25, 0.25]),
        bounds=[(0.0, 1.0)] * 5,
        constraints={"type": "eq", "fun": lambda x: x[1:].sum() - 1.0},
        method="SLSQP",
        options={"ftol": 1e-14, "maxiter": 500},
    )
    return float(np.sqrt(answer.fun))


def test_over_a_triangle_it_is_the_distance_from_a_tetrahedron() -> None:
    rng = np.random.default_rng(1)
    touching = 0
    for _ in range(150):
        start, end = rng.uniform(-0.5, 0.9, 3), rng.uniform(-0.5, 0.9, 3)
        found = segment_pyramid_distance(start, end, APEX, TRIANGLE)
        expected = by_optimisation(start, end, np.vstack([TRIANGLE, APEX]))
        assert found == pytest.approx(expected, abs=2e-4)
        touching += found == 0.0
    assert 5 < touching < 145


def test_neither_the_direction_of_the_segment_nor_that_of_the_outline_matters() -> None:
    rng = np.random.default_rng(2)
    for _ in range(50):
        start, end = rng.uniform(-0.4, 0.7, 3), rng.uniform(-0.4, 0.7, 3)
        found = segment_pyramid_distance(start, end, APEX, NOTCHED)
        assert found == pytest.approx(segment_pyramid_distance(end, start, APEX, NOTCHED), abs=1e-12)
        turned = NOTCHED[::-1].copy()
        assert found == pytest.approx(segment_pyramid_distance(start, end, APEX, turned), abs=1e-12)


def test_a_point_in_the_notch_of_an_outline_is_outside() -> None:
    inside, notch = np.array([-0.05, -0.05, 0.01]), np.array([0.06, 0.05, 0.0])
    assert segment_pyramid_distance(inside, inside, APEX, NOTCHED) == 0.0
    assert segment_pyramid_distance(notch, notch, APEX, NOTCHED) == pytest.approx(0.05, abs=3e-3)


@pytest.mark.parametrize("height", [-0.2, 0.7])
def test_behind_the_base_and_behind_the_apex_it_is_the_way_to_them(height: float) -> None:
    point = np.array([0.0, 0.0, height])
    expected = -height if height < 0.0 else height - 0.6
    assert segment_pyramid_distance(point, point, APEX, TRIANGLE) == pytest.approx(expected, abs=1e-12)


def test_a_segment_through_the_pyramid_meets_it_with_both_ends_outside() -> None:
    start, end = np.array([-1.0, 0.0, 0.3]), np.array([1.0, 0.0, 0.3])
    assert segment_pyramid_distance(start, end, APEX, TRIANGLE) == 0.0
    assert segment_pyramid_distance(start - [0, 1, 0], end - [0, 1, 0], APEX, TRIANGLE) > 0.5
