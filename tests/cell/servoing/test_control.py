from __future__ import annotations

import numpy as np
import pytest
from servo_views import TRIANGLE_M, moments_at, object_to_camera, random_views

from safety_harness.base.exceptions import SettingsError
from safety_harness.base.settings import InteractionChoice, ObjectKind
from safety_harness.cell.perception.moments import MOMENT_COUNT
from safety_harness.cell.servoing.control import (
    CURRENT,
    DESIRED,
    MEAN,
    DesiredView,
    camera_twist,
    choice_code,
    desired_view,
)
from safety_harness.cell.servoing.features import A_N, feature_error, features
from safety_harness.cell.servoing.interaction import interaction_matrix

HOME = object_to_camera((0.0, 0.0, 0.4), (0.0, 0.0, 0.65))
GAIN = 0.4


def view_at_home(kind: ObjectKind = ObjectKind.DENSE) -> DesiredView:
    return desired_view(TRIANGLE_M, HOME, kind)


def seen_from(view: np.ndarray, desired: DesiredView) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(moments, features, error) of the triangle."""
    moments, f, error = moments_at(view, dense=True), np.empty(6), np.empty(6)
    assert features(moments, desired.area, desired.depth_m, True, f)
    feature_error(f, desired.features, error)
    return moments, f, error


def twist_of(choice: int, desired: DesiredView, view: np.ndarray) -> np.ndarray:
    moments, f, error = seen_from(view, desired)
    out = np.empty(6)
    assert camera_twist(
        choice,
        desired.interaction,
        desired.interaction_pinv,
        moments,
        f,
        desired.area,
        desired.depth_m,
        True,
        GAIN,
        error,
        out,
    )
    return out


@pytest.mark.parametrize("kind", list(ObjectKind))
def test_the_desired_view_is_what_the_camera_sees_there(kind: ObjectKind) -> None:
    desired = view_at_home(kind)
    assert desired.dense is (kind is ObjectKind.DENSE)
    assert desired.depth_m == pytest.approx(0.65, rel=1e-14)
    np.testing.assert_allclose(desired.features[:3], [0.0, 0.0, 0.65], atol=1e-15)
    np.testing.assert_allclose(desired.plane, [0.0, 0.0, 1.0 / 0.65], atol=1e-15)
    np.testing.assert_allclose(desired.interaction_pinv @ desired.interaction, np.eye(6), atol=1e-12)
    assert desired.condition_number == pytest.approx(np.linalg.cond(desired.interaction))


def test_the_desired_view_cannot_be_changed() -> None:
    with pytest.raises(ValueError, match="read-only"):
        view_at_home().features[0] = 1.0


@pytest.mark.parametrize("kind", list(ObjectKind))
@pytest.mark.parametrize("turn_rad", [0.0, 0.3, 2.0])
@pytest.mark.parametrize("position_m", [(0.0, 0.0, 0.65), (0.05, -0.03, 0.65)])
def test_an_isosceles_triangle_is_refused_for_its_rank(
    kind: ObjectKind, turn_rad: float, position_m: tuple[float, float, float]
) -> None:
    isosceles = np.array([[-0.04, -0.03], [0.04, -0.03], [0.0, 0.09]])
    with pytest.raises(SettingsError, match=r"rank 6.*got rank 5.*isosceles"):
        desired_view(isosceles, object_to_camera((0.0, 0.0, turn_rad), position_m), kind)


@pytest.mark.parametrize("turn_rad", [0.0, 0.7])
def test_an_equilateral_triangle_is_refused_for_its_invariants(turn_rad: float) -> None:
    corners = 2.0 * np.pi * np.arange(3) / 3.0
    equilateral = 0.05 * np.column_stack([np.cos(corners), np.sin(corners)])
    with pytest.raises(SettingsError, match=r"In3.*equilateral"):
        desired_view(equilateral, object_to_camera((0.0, 0.0, turn_rad), (0.0, 0.0, 0.65)), ObjectKind.DENSE)


def test_an_object_that_cannot_be_seen_is_refused() -> None:
    behind = object_to_camera((0.0, 0.0, 0.0), (0.0, 0.0, -0.65))
    with pytest.raises(SettingsError, match="cannot be seen"):
        desired_view(TRIANGLE_M, behind, ObjectKind.DENSE)
    with pytest.raises(SettingsError, match="cannot be seen"):
        desired_view(np.zeros((3, 2)), HOME, ObjectKind.DENSE)


def test_upright_the_camera_flies_straight_home_without_turning() -> None:
    """The object must come nearer by GAIN times its displacement, so the camera goes after it."""
    desired = view_at_home()
    rng = np.random.default_rng(1)
    for _ in range(20):
        view = HOME.copy()
        displacement = rng.uniform([-0.06, -0.15, -0.1], [0.06, 0.15, 0.1])
        view[:3, 3] += displacement
        for choice in (DESIRED, CURRENT, MEAN):
            np.testing.assert_allclose(
                twist_of(choice, desired, view), [*GAIN * displacement, 0.0, 0.0, 0.0], atol=1e-9
            )


def test_each_choice_inverts_its_own_matrix() -> None:
    desired = view_at_home()
    for view in random_views(2, 20, 0.1):
        moments, f, error = seen_from(view, desired)
        current = np.empty((6, 6))
        parallel = np.array([0.0, 0.0, 1.0 / f[A_N]])
        interaction_matrix(moments, parallel, desired.area, desired.depth_m, True, current)
        for choice, matrix in (
            (DESIRED, desired.interaction),
            (CURRENT, current),
            (MEAN, 0.5 * (current + desired.interaction)),
        ):
            expected = -GAIN * np.linalg.pinv(matrix) @ error
            np.testing.assert_allclose(twist_of(choice, desired, view), expected, rtol=1e-8, atol=1e-9)


def test_every_choice_of_the_settings_has_a_code_of_its_own() -> None:
    assert sorted(choice_code(choice) for choice in InteractionChoice) == [0, 1, 2]
    assert choice_code(InteractionChoice.DESIRED) == DESIRED
    assert choice_code(InteractionChoice.CURRENT) == CURRENT
    assert choice_code(InteractionChoice.MEAN) == MEAN


@pytest.mark.parametrize("choice", [DESIRED, CURRENT, MEAN])
def test_an_error_that_is_not_finite_gives_no_twist(choice: int) -> None:
    desired = view_at_home()
    moments, f, error = seen_from(HOME, desired)
    for bad in (np.nan, np.inf):
        error[3] = bad
        assert not camera_twist(
            choice,
            desired.interaction,
            desired.interaction_pinv,
            moments,
            f,
            desired.area,
            desired.depth_m,
            True,
            GAIN,
            error,
            np.empty(6),
        )


@pytest.mark.parametrize("choice", [CURRENT, MEAN])
def test_moments_that_are_missing_give_no_twist(choice: int) -> None:
    desired = view_at_home()
    _, f, error = seen_from(HOME, desired)
    assert not camera_twist(
        choice,
        desired.interaction,
        desired.interaction_pinv,
        np.full(MOMENT_COUNT, np.nan),
        f,
        desired.area,
        desired.depth_m,
        True,
        GAIN,
        error,
        np.empty(6),
    )
