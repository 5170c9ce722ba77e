"""Small dense linear systems in compiled code (numba's own solver would need scipy)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from safety_harness.compiled import compiled


@compiled
def solve_in_place(matrix: NDArray[np.float64], vector: NDArray[np.float64]) -> bool:
    """Solve ``matrix`` x = ``vector`` by Gaussian elimination with partial pivoting.

    Overwrites both: ``vector`` (n,) becomes x, ``matrix`` (n, n) is used up.  False, with
    unusable contents, when a pivot is zero or not finite.
    """
    n = vector.shape[0]
    for column in range(n):
        pivot = column
        for row in range(column + 1, n):
            if abs(matrix[row, column]) > abs(matrix[pivot, column]):
                pivot = row
        largest = abs(matrix[pivot, column])
        if not (largest > 0.0 and largest < np.inf):  # also catches NaN
            return False
        if pivot != column:
            for j in range(column, n):
                matrix[column, j], matrix[pivot, j] = matrix[pivot, j], matrix[column, j]
            vector[column], vector[pivot] = vector[pivot], vector[column]
        for row in range(column + 1, n):
            factor = matrix[row, column] / matrix[column, column]
            for j in range(column + 1, n):
                matrix[row, j] -= factor * matrix[column, j]
            vector[row] -= factor * vector[column]
    for row in range(n - 1, -1, -1):
        total = vector[row]
        for j in range(row + 1, n):
            total -= matrix[row, j] * vector[j]
        vector[row] = total / matrix[row, row]
    return True
