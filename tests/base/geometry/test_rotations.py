import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from safety_harness.base.geometry.rotations import rotation_about, rotation_from_vector, vector_from_rotation

ANGLES = [0.0, 1e-300, 1e-12, 1e-8, 9.9e-5, 1.01e-4, 1e-3, 1.0, 3.0, np.pi - 1e-4, np.pi - 1e-9, np.pi]


def random_axes(count: int) -> np.ndarray:
    axes = np.random.default_rng(3).normal(size=(count, 3))
    return np.vstack((axes / np.linalg.norm(axes, axis=1, keepdims=True), np.eye(3), -np.eye(3)))


@pytest.mark.parametrize("angle", [*ANGLES, 4.0, 2 * np.pi, 9.0])
def test_rotation_from_vector_equals_an_independent_implementation(angle: float) -> None:
    for axis in random_axes(20):
        expected = Rotation.from_rotvec(angle * axis).as_matrix()
        np.testing.assert_allclose(rotation_from_vector(angle * axis), expected, atol=2e-15)


@pytest.mark.parametrize("angle", ANGLES)
def test_vector_from_rotation_gives_the_vector_back_up_to_the_sign_of_a_half_turn(angle: float) -> None:
    for axis in random_axes(20):
        vector = angle * axis
        back = vector_from_rotation(rotation_from_vector(vector))
        if angle == np.pi and back @ axis < 0.0:
            back = -back
        np.testing.assert_allclose(back, vector, rtol=1e-14, atol=4e-15)


@settings(deadline=None)
@given(st.tuples(*[st.floats(-30, 30)] * 3))
def test_any_vector_and_its_shortest_form_mean_the_same_rotation(vector: tuple[float, float, float]) -> None:
    rotation = rotation_from_vector(np.array(vector))
    shortest = vector_from_rotation(rotation)
    assert np.linalg.norm(shortest) <= np.pi + 1e-14
    np.testing.assert_allclose(rotation_from_vector(shortest), rotation, atol=1e-13)


@pytest.mark.parametrize("angle", [-9.0, -1.0, 0.0, 1e-9, 2.0])
def test_rotation_about_a_unit_axis_is_the_rotation_of_the_scaled_axis(angle: float) -> None:
    turn = np.empty((3, 3))
    for axis in random_axes(10):
        rotation_about(axis, angle, turn)
        np.testing.assert_allclose(turn, rotation_from_vector(angle * axis), atol=3e-15)


def test_a_nan_is_not_hidden() -> None:
    assert np.isnan(rotation_from_vector(np.array([np.nan, 0.0, 0.0]))).any()
    assert np.isnan(vector_from_rotation(np.full((3, 3), np.nan))).any()
