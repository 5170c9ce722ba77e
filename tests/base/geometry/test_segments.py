import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from safety_harness.base.geometry.segments import (
    ROUNDING_M,
    axes_lower_m,
    point_segment_distance,
    segment_segment_distance,
    segment_segment_vector,
)

COORDINATE = st.floats(-2.0, 2.0).map(lambda x: round(x, 3)) | st.integers(-2, 2).map(float)
POINT = st.tuples(COORDINATE, COORDINATE, COORDINATE).map(np.array)


def by_bounded_least_squares(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> float:
    """The distance as a least-squares problem in a box, solved by a library."""
    matrix = np.column_stack((b - a, c - d))
    solution = lsq_linear(matrix, c - a, bounds=(0.0, 1.0), method="bvls", tol=1e-14)
    return float(np.linalg.norm(matrix @ solution.x - (c - a)))


def test_random_segments_agree_with_bounded_least_squares() -> None:
    rng = np.random.default_rng(11)
    for _ in range(300):
        a, b, c, d = rng.normal(size=(4, 3))
        assert segment_segment_distance(a, b, c, d) == pytest.approx(
            by_bounded_least_squares(a, b, c, d), abs=1e-9
        )


@settings(deadline=None)
@given(POINT, POINT, POINT, POINT)
def test_no_pair_of_points_is_nearer_and_one_is_as_near(
    a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray
) -> None:
    """Parallel, crossing, touching and point-like segments abound among these coarse numbers."""
    distance = segment_segment_distance(a, b, c, d)
    s = np.linspace(0.0, 1.0, 41)[:, None]
    sampled = np.linalg.norm((a + s * (b - a))[:, None] - (c + s * (d - c))[None], axis=2).min()
    slack = 0.0125 * (np.linalg.norm(b - a) + np.linalg.norm(d - c))
    assert sampled - slack - 1e-12 <= distance <= sampled + 1e-12


@settings(deadline=None)
@given(POINT, POINT, POINT, POINT)
def test_order_and_direction_of_the_segments_do_not_matter(
    a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray
) -> None:
    distance = segment_segment_distance(a, b, c, d)
    for first, second in itertools.product([(a, b), (b, a)], [(c, d), (d, c)]):
        assert segment_segment_distance(*first, *second) == pytest.approx(distance, abs=1e-9)
        assert segment_segment_distance(*second, *first) == pytest.approx(distance, abs=1e-9)


@settings(deadline=None)
@given(POINT, POINT, POINT)
def test_a_segment_without_length_is_a_point(a: np.ndarray, c: np.ndarray, d: np.ndarray) -> None:
    assert segment_segment_distance(a, a, c, d) == pytest.approx(point_segment_distance(a, c, d), abs=1e-15)


@pytest.mark.parametrize("tilt", [0.0, 1e-15, 1e-12, 1e-9, 1e-6])
def test_nearly_parallel_segments_side_by_side_keep_their_distance(tilt: float) -> None:
    a, b = np.array([0.0, 0.0, 0.0]), np.array([1.0, 0.0, 0.0])
    c, d = np.array([0.2, 0.1, tilt]), np.array([0.9, 0.1, -tilt])
    assert segment_segment_distance(a, b, c, d) == pytest.approx(0.1, abs=1e-11)


def test_the_vector_leads_from_the_first_segment_to_the_second() -> None:
    a, b = np.array([-1.0, 0.0, 0.0]), np.array([1.0, 0.0, 0.0])
    c, d = np.array([0.0, -1.0, 0.5]), np.array([0.0, 1.0, 0.5])
    np.testing.assert_allclose(segment_segment_vector(a, b, c, d), [0.0, 0.0, 0.5], atol=1e-15)


@pytest.mark.parametrize("broken", range(4))
def test_a_nan_is_not_hidden(broken: int) -> None:
    points = np.random.default_rng(2).normal(size=(4, 3))
    points[broken, 1] = np.nan
    assert np.isnan(segment_segment_distance(*points))


@settings(deadline=None)
@given(POINT, POINT, POINT, POINT)
def test_the_cheap_bound_is_never_above_the_distance(
    a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray
) -> None:
    bound = axes_lower_m(np.array([a, b]), np.array([c, d]))
    assert bound - ROUNDING_M <= segment_segment_distance(a, b, c, d)


def test_the_cheap_bound_is_the_distance_of_two_points_and_takes_a_nan_over() -> None:
    a, b = np.full((2, 3), 0.5), np.full((2, 3), -0.5)
    assert axes_lower_m(a, b) == pytest.approx(np.sqrt(3.0))
    assert np.isnan(axes_lower_m(a, np.full((2, 3), np.nan)))
