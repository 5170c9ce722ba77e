"""Rigid transforms as 4 x 4 matrices.

``transform_a_to_b`` maps coordinates in frame a to coordinates in frame b.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import compiled, inlined
from safety_harness.base.geometry.arrays import Array3, Array3x3, Array4x4


@compiled
def transform_from(rotation: Array3x3, translation: Array3) -> NDArray[np.float64]:
    """Return the transform (4, 4) that rotates first and then shifts.

    Args:
        rotation: (3, 3) The rotation.
        translation: (3,) The shift [m].

    """
    transform = np.zeros((4, 4))
    for i in range(3):
        for j in range(3):
            transform[i, j] = rotation[i, j]
        transform[i, 3] = translation[i]
    transform[3, 3] = 1.0
    return transform


@compiled
def inverse_transform(transform: Array4x4) -> NDArray[np.float64]:
    """Return the inverse (4, 4) of a rigid transform: (R^T, -R^T t) for its rotation R and shift t.

    Args:
        transform: (4, 4) The transform.

    """
    inverse = np.empty((4, 4))
    invert_into(transform, inverse)
    return inverse


@inlined
def invert_into(transform: Array4x4, inverse_out: Array4x4) -> None:
    """Fill an array with the inverse of a rigid transform.

    Args:
        transform: (4, 4) The transform.
        inverse_out: (4, 4) The array that the function fills with the inverse.  It must be a different array
            from ``transform``.

    """
    for i in range(3):
        shift = 0.0
        for j in range(3):
            inverse_out[i, j] = transform[j, i]
            shift -= transform[j, i] * transform[j, 3]
        inverse_out[i, 3] = shift
        inverse_out[3, i] = 0.0
    inverse_out[3, 3] = 1.0


@inlined
def compose_into(outer: Array4x4, inner: Array4x4, transform_out: Array4x4) -> None:
    """Fill an array with ``outer`` @ ``inner``.

    The inner transform acts first, so the product of b_to_c and a_to_b is a_to_c.  For rotations R, S and
    shifts t, u, the product is (R, t) (S, u) = (R S, R u + t).

    Args:
        outer: (4, 4) The second transform.
        inner: (4, 4) The first transform.
        transform_out: (4, 4) The array that the function fills with the product.  It must be a different
            array from ``outer`` and ``inner``.

    """
    for i in range(3):
        for j in range(4):
            # Written out, because BLAS (the operator @) gives other last bits on other processors.
            transform_out[i, j] = (
                outer[i, 0] * inner[0, j] + outer[i, 1] * inner[1, j] + outer[i, 2] * inner[2, j]
            )
        transform_out[i, 3] += outer[i, 3]
    transform_out[3, 0] = 0.0
    transform_out[3, 1] = 0.0
    transform_out[3, 2] = 0.0
    transform_out[3, 3] = 1.0
