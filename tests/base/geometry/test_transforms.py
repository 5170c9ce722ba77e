import numpy as np

from safety_harness.base.geometry.rotations import rotation_from_vector
from safety_harness.base.geometry.transforms import compose_into, inverse_transform, transform_from


def random_transforms(count: int) -> list[np.ndarray]:
    rng = np.random.default_rng(5)
    return [
        transform_from(rotation_from_vector(rng.normal(size=3)), rng.normal(size=3)) for _ in range(count)
    ]


def test_a_transform_turns_then_shifts() -> None:
    rotation = rotation_from_vector(np.array([0.3, -0.2, 0.9]))
    shift, point = np.array([1.0, 2.0, 3.0]), np.array([-0.4, 0.5, 0.6])
    moved = transform_from(rotation, shift) @ np.append(point, 1.0)
    np.testing.assert_allclose(moved, np.append(rotation @ point + shift, 1.0), atol=1e-15)


def test_the_inverse_undoes_from_both_sides() -> None:
    for transform in random_transforms(20):
        np.testing.assert_allclose(inverse_transform(transform) @ transform, np.eye(4), atol=1e-14)
        np.testing.assert_allclose(transform @ inverse_transform(transform), np.eye(4), atol=1e-14)


def test_compose_into_is_the_matrix_product() -> None:
    outer, inner = random_transforms(2)
    product = np.full((4, 4), np.nan)
    compose_into(outer, inner, product)
    np.testing.assert_allclose(product, outer @ inner, atol=1e-15)
