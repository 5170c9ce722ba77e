"""The oracle is a central difference of the moments and features along a matrix exponential."""

from __future__ import annotations

import numpy as np
import pytest
from disagreement import noted
from servo_views import (
    DESIRED_AREA,
    DESIRED_DEPTH_M,
    moments_at,
    moved,
    object_to_camera,
    plane_at,
    random_views,
)

from safety_harness.cell.perception.moments import M00, MOMENT_COUNT, XG, YG, mu_index
from safety_harness.cell.servoing.features import A_N, ALPHA, feature_error, features
from safety_harness.cell.servoing.interaction import (
    centred_moment_interaction,
    centroid_interaction,
    interaction_matrix,
)

STEP_S = 1e-4
DENSE = pytest.mark.parametrize("dense", [True, False])


def features_at(view: np.ndarray, *, dense: bool) -> np.ndarray:
    out = np.empty(6)
    assert features(moments_at(view, dense=dense), DESIRED_AREA, DESIRED_DEPTH_M, dense, out)
    return out


def rates(values: list[np.ndarray]) -> np.ndarray:
    """Five-point central difference from the values at -2, -1, 1 and 2 steps."""
    return (values[0] - 8.0 * values[1] + 8.0 * values[2] - values[3]) / (12.0 * STEP_S)


def along(view: np.ndarray, component: int) -> list[np.ndarray]:
    """Views at -2, -1, 1 and 2 steps of a camera that moves along one component of the twist."""
    return [moved(view, np.eye(6)[component], k * STEP_S) for k in (-2, -1, 1, 2)]


@DENSE
def test_rows_of_moments_equal_their_rates_of_change(dense: bool) -> None:
    for view in random_views(1, 6, 0.5):
        moments, plane = moments_at(view, dense=dense), plane_at(view)
        numeric = np.empty((MOMENT_COUNT, 6))
        for component in range(6):
            numeric[:, component] = rates([moments_at(v, dense=dense) for v in along(view, component)])
        row, centroid = np.empty(6), np.empty((2, 6))
        centroid_interaction(moments, plane, dense, centroid)
        np.testing.assert_allclose(centroid, numeric[[XG, YG]], rtol=1e-8, atol=1e-9)
        for i in range(6):
            for j in range(6 - i):
                if i + j == 1:
                    continue  # the first centred moments are zero by definition
                centred_moment_interaction(moments, plane, dense, i, j, row)
                expected = numeric[mu_index(i, j)]
                size = np.abs(expected).max() + moments[M00] * 0.1 ** (i + j)
                np.testing.assert_allclose(row, expected, atol=1e-8 * size)
        if dense:
            centred_moment_interaction(moments, plane, dense, 0, 0, row)
            np.testing.assert_allclose(row, numeric[M00], rtol=1e-8, atol=1e-10)


@DENSE
def test_interaction_matrix_equals_the_rates_of_change_of_the_features(dense: bool) -> None:
    for view in random_views(2, 40, 0.5):
        matrix = np.empty((6, 6))
        moments = moments_at(view, dense=dense)
        assert interaction_matrix(moments, plane_at(view), DESIRED_AREA, DESIRED_DEPTH_M, dense, matrix)
        here = features_at(view, dense=dense)
        for component in range(6):
            errors = []
            for v in along(view, component):  # relative to here: alpha may jump by pi in between
                error = np.empty(6)
                feature_error(features_at(v, dense=dense), here, error)
                errors.append(error)
            numeric = rates(errors)
            size = np.abs(matrix).max(axis=1) + 1.0
            noted(
                "finite differences",
                "interaction matrix",
                "parts of a row",
                matrix[:, component] / size,
                numeric / size,
            )
            np.testing.assert_array_less(np.abs(matrix[:, component] - numeric), 1e-7 * size)


def equation_2(moments: np.ndarray, a_n: float, *, dense: bool) -> np.ndarray:
    """Eq. 2 with its closed forms; rows of gamma and delta are left to the finite differences."""
    xg, yg = moments[XG], moments[YG]

    def mu(i: int, j: int) -> float:
        return float(moments[mu_index(i, j)])

    x_n, y_n = a_n * xg, a_n * yg
    n20, n11, n02 = mu(2, 0) / moments[M00], mu(1, 1) / moments[M00], mu(0, 2) / moments[M00]
    if dense:
        e11 = e22 = 4.0 * n11 - xg * yg / 2.0
        e12, e21 = 4.0 * n20 - xg**2 / 2.0, 4.0 * n02 - yg**2 / 2.0
        e31, e32 = 1.5 * y_n, 1.5 * x_n
    else:
        a = mu(2, 0) + mu(0, 2)
        s20, s11, s02 = mu(2, 0) / a, mu(1, 1) / a, mu(0, 2) / a
        e31 = a_n * (yg * (1.0 + s02) + xg * s11 + (mu(2, 1) + mu(0, 3)) / a)
        e32 = a_n * (xg * (1.0 + s20) + yg * s11 + (mu(1, 2) + mu(3, 0)) / a)
        e11 = n11 + xg * yg - xg * e31 / a_n
        e22 = n11 + xg * yg - yg * e32 / a_n
        e12 = n20 + xg**2 - xg * e32 / a_n
        e21 = n02 + yg**2 - yg * e31 / a_n
    return np.array(
        [
            [-1.0, 0.0, 0.0, a_n * e11, -a_n * (1.0 + e12), y_n],
            [0.0, -1.0, 0.0, a_n * (1.0 + e21), -a_n * e22, -x_n],
            [0.0, 0.0, -1.0, -e31, e32, 0.0],
        ]
    )


@DENSE
def test_over_a_parallel_plane_the_matrix_is_eq_2(dense: bool) -> None:
    rng = np.random.default_rng(3)
    for _ in range(30):
        position_m = rng.uniform([-0.15, -0.1, 0.45], [0.15, 0.1, 1.0])
        moments = moments_at(object_to_camera((0.0, 0.0, rng.uniform(-3.0, 3.0)), position_m), dense=dense)
        f, matrix = np.empty(6), np.empty((6, 6))
        features(moments, DESIRED_AREA, DESIRED_DEPTH_M, dense, f)
        plane = np.array([0.0, 0.0, 1.0 / f[A_N]])
        assert interaction_matrix(moments, plane, DESIRED_AREA, DESIRED_DEPTH_M, dense, matrix)
        np.testing.assert_allclose(matrix[:3], equation_2(moments, f[A_N], dense=dense), atol=1e-12)
        np.testing.assert_allclose(matrix[3:, [0, 1, 2]], 0.0, atol=1e-12)
        np.testing.assert_allclose(matrix[3:5, 5], 0.0, atol=1e-12)
        assert matrix[ALPHA, 5] == pytest.approx(-1.0, abs=1e-12)


def test_missing_moments_give_no_matrix() -> None:
    nothing, plane = np.full(MOMENT_COUNT, np.nan), np.array([0.0, 0.0, 1.5])
    assert not interaction_matrix(nothing, plane, DESIRED_AREA, DESIRED_DEPTH_M, True, np.empty((6, 6)))
