from __future__ import annotations

from math import pi

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from servo_views import (
    DESIRED_AREA,
    DESIRED_DEPTH_M,
    POINTS_M,
    TRIANGLE_M,
    moments_at,
    object_to_camera,
    random_views,
)

from safety_harness.cell.perception.moments import MOMENT_COUNT, mu_index, point_moments, polygon_moments
from safety_harness.cell.servoing.features import (
    A_N,
    ALPHA,
    DELTA,
    GAMMA,
    X_N,
    Y_N,
    area,
    feature_error,
    features,
)

ANGLE = st.floats(-pi, pi)


def features_of(moments: np.ndarray, *, dense: bool, desired_area: float = DESIRED_AREA) -> np.ndarray:
    out = np.empty(6)
    assert features(moments, desired_area, DESIRED_DEPTH_M, dense, out)
    return out


def features_of_figure(figure: np.ndarray, *, dense: bool) -> np.ndarray:
    moments = np.empty(MOMENT_COUNT)
    assert (polygon_moments if dense else point_moments)(np.ascontiguousarray(figure), moments)
    return features_of(moments, dense=dense)


def modulo_pi(angle_rad: float) -> float:
    return abs((angle_rad + pi / 2) % pi - pi / 2)


@pytest.mark.parametrize("dense", [True, False])
@given(turn=ANGLE, scale=st.floats(0.2, 5.0), x=st.floats(-0.5, 0.5), y=st.floats(-0.5, 0.5))
def test_gamma_and_delta_do_not_feel_turns_shifts_and_scales_and_alpha_turns_along(
    dense: bool, turn: float, scale: float, x: float, y: float
) -> None:
    figure = TRIANGLE_M if dense else POINTS_M
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    before = features_of_figure(figure, dense=dense)
    after = features_of_figure(scale * figure @ rotation.T + [x, y], dense=dense)
    assert after[GAMMA] == pytest.approx(before[GAMMA], rel=1e-9)
    assert after[DELTA] == pytest.approx(before[DELTA], rel=1e-9)
    assert modulo_pi(after[ALPHA] - before[ALPHA] - turn) < 1e-9


@given(scale=st.floats(0.2, 5.0))
def test_a_n_falls_as_the_figure_grows(scale: float) -> None:
    for dense, figure in ((True, TRIANGLE_M), (False, POINTS_M)):
        before = features_of_figure(figure, dense=dense)[A_N]
        after = features_of_figure(scale * figure, dense=dense)[A_N]
        assert after * scale == pytest.approx(before, rel=1e-12)


@pytest.mark.parametrize("dense", [True, False])
def test_over_a_parallel_plane_the_first_three_features_are_the_centroid_in_the_camera(dense: bool) -> None:
    shape_m = TRIANGLE_M if dense else POINTS_M
    desired = object_to_camera((0.0, 0.0, 0.3), (0.02, -0.01, DESIRED_DEPTH_M))
    desired_area = area(moments_at(desired, dense=dense), dense)
    rng = np.random.default_rng(1)
    for _ in range(20):
        view = object_to_camera((0.0, 0.0, 0.3), rng.uniform([-0.1, -0.1, 0.4], [0.1, 0.1, 1.0]))
        centroid = (view @ [*shape_m.mean(axis=0), 0.0, 1.0])[:3]
        f = features_of(moments_at(view, dense=dense), dense=dense, desired_area=desired_area)
        np.testing.assert_allclose(f[[X_N, Y_N, A_N]], centroid, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("dense", [True, False])
def test_with_the_desired_orientation_the_error_is_the_displacement(dense: bool) -> None:
    """So |e| is the distance from the desired position: the other three errors are zero."""
    turn, home = (0.0, 0.0, -1.1), np.array([0.01, 0.02, DESIRED_DEPTH_M])
    moments = moments_at(object_to_camera(turn, home), dense=dense)
    desired_area = area(moments, dense)
    desired = features_of(moments, dense=dense, desired_area=desired_area)
    rng = np.random.default_rng(2)
    for _ in range(20):
        shift_m = rng.uniform([-0.06, -0.15, -0.1], [0.06, 0.15, 0.1])
        view = object_to_camera(turn, home + shift_m)
        f, error = (
            features_of(moments_at(view, dense=dense), dense=dense, desired_area=desired_area),
            np.empty(6),
        )
        sse = feature_error(f, desired, error)
        np.testing.assert_allclose(error, [*shift_m, 0.0, 0.0, 0.0], atol=1e-10)
        assert sse == pytest.approx(shift_m @ shift_m, rel=1e-9)


def test_alpha_is_the_direction_of_the_long_axis() -> None:
    for angle_rad in np.radians([-89.0, -46.0, -45.0, -44.0, 0.0, 44.0, 45.0, 46.0, 89.0]):
        c, s = np.cos(angle_rad), np.sin(angle_rad)
        long_axis, short_axis = np.array([c, s]), np.array([-s, c])
        figure = np.array([-0.3 * long_axis, 0.2 * long_axis + 0.03 * short_axis, 0.25 * long_axis])
        moments = np.empty(MOMENT_COUNT)
        polygon_moments(figure, moments)
        tensor = np.array(
            [
                [moments[mu_index(2, 0)], moments[mu_index(1, 1)]],
                [moments[mu_index(1, 1)], moments[mu_index(0, 2)]],
            ]
        )
        direction = np.linalg.eigh(tensor)[1][:, 1]
        alpha = features_of(moments, dense=True)[ALPHA]
        assert abs(direction @ [np.cos(alpha), np.sin(alpha)]) == pytest.approx(1.0, abs=1e-12)
        assert -pi / 2 < alpha <= pi / 2


@given(current=ANGLE, desired=ANGLE)
def test_the_error_of_alpha_is_the_least_turn_of_an_axis(current: float, desired: float) -> None:
    f, f_desired, error = np.zeros(6), np.zeros(6), np.empty(6)
    f[ALPHA], f_desired[ALPHA] = current, desired
    sse = feature_error(f, f_desired, error)
    assert -pi / 2 - 1e-15 <= error[ALPHA] <= pi / 2 + 1e-15
    turns = (current - desired - error[ALPHA]) / pi
    assert turns == pytest.approx(round(turns), abs=1e-12)
    assert sse == error[ALPHA] * error[ALPHA]  # a power may be rounded otherwise


def test_half_a_turn_of_an_axis_counts_as_positive() -> None:
    error = np.empty(6)
    for sign in (1.0, -1.0):
        feature_error(np.array([0.0, 0.0, 0.0, 0.0, 0.0, sign * pi / 2]), np.zeros(6), error)
        assert error[ALPHA] == pi / 2


def test_the_squared_error_sums_over_all_features_and_nan_stays_nan() -> None:
    rng = np.random.default_rng(3)
    current, desired, error = rng.normal(size=6), rng.normal(size=6), np.empty(6)
    current[ALPHA] = desired[ALPHA] + 0.3
    sse = feature_error(current, desired, error)
    assert sse == pytest.approx(np.sum((current - desired) ** 2), rel=1e-14)
    current[GAMMA] = np.nan
    assert np.isnan(feature_error(current, desired, error))


def test_moments_that_are_missing_give_no_features() -> None:
    assert not features(np.full(MOMENT_COUNT, np.nan), DESIRED_AREA, DESIRED_DEPTH_M, True, np.empty(6))
    assert not features(np.zeros(MOMENT_COUNT), DESIRED_AREA, DESIRED_DEPTH_M, True, np.empty(6))


def test_all_features_of_tilted_views_are_finite() -> None:
    for view in random_views(4, 50, 0.4):
        for dense in (True, False):
            assert np.isfinite(features_of(moments_at(view, dense=dense), dense=dense)).all()
