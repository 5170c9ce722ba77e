"""From a TCP twist to joint velocities, with an honest word about singularities."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from safety_harness.compiled import compiled


@compiled
def invert(matrix: NDArray[np.float64], inverse_out: NDArray[np.float64]) -> bool:
    """Gauss-Jordan inverse of a square matrix with partial pivoting; False if a pivot is zero.

    Our own because numpy's inverse inside compiled code raises on an exactly singular matrix
    (a straight elbow is one) and goes through LAPACK, whose bits depend on the machine.
    """
    n = matrix.shape[0]
    work = matrix.copy()
    for i in range(n):
        for j in range(n):
            inverse_out[i, j] = 1.0 if i == j else 0.0
    for column in range(n):
        pivot = column
        for row in range(column + 1, n):
            if abs(work[row, column]) > abs(work[pivot, column]):
                pivot = row
        if not abs(work[pivot, column]) > 0.0:
            return False
        for j in range(n):
            work[column, j], work[pivot, j] = work[pivot, j], work[column, j]
            inverse_out[column, j], inverse_out[pivot, j] = inverse_out[pivot, j], inverse_out[column, j]
        scale = 1.0 / work[column, column]
        for j in range(n):
            work[column, j] *= scale
            inverse_out[column, j] *= scale
        for row in range(n):
            if row != column:
                factor = work[row, column]
                for j in range(n):
                    work[row, j] -= factor * work[column, j]
                    inverse_out[row, j] -= factor * inverse_out[column, j]
    return True


@compiled
def joint_velocity(
    jacobian: NDArray[np.float64],  # (6, 6)
    twist: NDArray[np.float64],  # (6,) v, w in the Jacobian's frame
    min_singular_value: float,
    joint_velocity_out: NDArray[np.float64],  # (6,)
) -> bool:
    """Solve J q' = twist; False (and zeros) nearer to a singularity than ``min_singular_value``.

    The test uses 1/|J^-1|_F, which lies between sigma_min/sqrt(6) and sigma_min: it acts early,
    never late.
    """
    inverse = np.empty((6, 6))
    regular = invert(jacobian, inverse)
    norm2 = 0.0
    for i in range(6):
        for j in range(6):
            norm2 += inverse[i, j] * inverse[i, j]
    regular = regular and norm2 * min_singular_value * min_singular_value <= 1.0
    for i in range(6):
        total = 0.0
        for j in range(6):
            total += inverse[i, j] * twist[j]
        joint_velocity_out[i] = total if regular else 0.0
    return regular
