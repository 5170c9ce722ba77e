"""Small dense linear systems and copies of arrays in compiled code; numba's own solver would need scipy."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import compiled, inlined, njit_no_nrt


@compiled
def solve_in_place(matrix: NDArray[np.float64], vector: NDArray[np.float64]) -> bool:
    """Solve A x = b by Gaussian elimination with partial pivoting (Golub and Van Loan, 2013, section 3.4).

    Args:
        matrix: (n, n) A; the elimination overwrites it.
        vector: (n,) b; x replaces it.

    Returns:
        False if a pivot is zero or not finite; then ``vector`` is unusable.

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


@njit_no_nrt
def invert(matrix: NDArray[np.float64], inverse_out: NDArray[np.float64]) -> bool:
    """Compute the inverse of a matrix by Gauss-Jordan elimination with partial pivoting.

    Row operations turn (A | I) into (I | A^-1).  An exactly singular matrix is a valid input, since a
    straight elbow has one.  So the result reports it without an exception.

    Args:
        matrix: (n, n) A, unchanged; n is at most 15.
        inverse_out: (n, n) receives A^-1.

    Returns:
        False if a pivot is 0 or not finite.

    """
    return invert_with(matrix, matrix.shape[0], inverse_out)


@inlined
def invert_with(matrix: NDArray[np.float64], n: int, inverse_out: NDArray[np.float64]) -> bool:
    """Compute the same as ``invert``, with ``n`` as an argument: if it is constant, the loops are unrolled.

    The inverse is computed in place, where each finished column of A makes room for the next column of A^-1.
    Therefore, each swap of two rows requires a swap of two columns at the end.  ``pivots`` holds four bits
    for each column.

    Args:
        matrix: (n, n) A, unchanged.
        n: Its size, at most 15.
        inverse_out: (n, n) receives A^-1.

    """
    work, pivots = inverse_out, 0
    for i in range(n):
        for j in range(n):
            work[i, j] = matrix[i, j]
    for column in range(n):
        pivot = column
        for row in range(column + 1, n):
            if abs(work[row, column]) > abs(work[pivot, column]):
                pivot = row
        largest = abs(work[pivot, column])
        if not (largest > 0.0 and largest < np.inf):  # also catches NaN
            return False
        if pivot != column:
            pivots |= pivot << 4 * column
            for j in range(n):
                work[column, j], work[pivot, j] = work[pivot, j], work[column, j]
        scale = 1.0 / work[column, column]
        work[column, column] = 1.0
        for j in range(n):
            work[column, j] *= scale
        for row in range(n):
            if row != column:
                factor = work[row, column]
                work[row, column] = 0.0
                for j in range(n):
                    work[row, j] -= factor * work[column, j]
    if pivots != 0:
        for column in range(n - 1, -1, -1):
            pivot = (pivots >> 4 * column) & 15  # never row 0, which only column 0 can have swapped
            if pivot != 0:
                for i in range(n):
                    work[i, column], work[i, pivot] = work[i, pivot], work[i, column]
    return True


def eigen(symmetric: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the rising eigenvalues (n,) of ``symmetric`` (n, n), and its eigenvectors as columns (n, n)."""
    values, vectors = np.array(symmetric, np.float64), np.eye(len(symmetric))
    _rotate_to_diagonal(values, vectors)
    order = np.argsort(np.diagonal(values), kind="stable")
    return np.diagonal(values)[order], vectors[:, order]


@njit_no_nrt
def _rotate_to_diagonal(a: NDArray[np.float64], vectors: NDArray[np.float64]) -> None:
    """Make the symmetric ``a`` (n, n) diagonal by Jacobi's rotations (Golub and Van Loan, 2013, section 8.5).

    The columns of ``vectors`` (n, n) undergo the same rotations.
    """
    n, size = a.shape[0], 0.0
    for k in range(n):
        size += abs(a[k, k])
    for _ in range(60):
        turned = False
        for p in range(n - 1):
            for q in range(p + 1, n):
                if not abs(a[p, q]) > 1e-17 * size:
                    continue
                turned = True
                slope = (a[q, q] - a[p, p]) / (2.0 * a[p, q])
                t = 1.0 / (abs(slope) + np.sqrt(1.0 + slope * slope))
                t = -t if slope < 0.0 else t
                c = 1.0 / np.sqrt(1.0 + t * t)
                s = t * c
                for k in range(n):
                    x, y = a[k, p], a[k, q]
                    a[k, p], a[k, q] = c * x - s * y, s * x + c * y
                for k in range(n):
                    x, y = a[p, k], a[q, k]
                    a[p, k], a[q, k] = c * x - s * y, s * x + c * y
                    x, y = vectors[k, p], vectors[k, q]
                    vectors[k, p], vectors[k, q] = c * x - s * y, s * x + c * y
                a[p, q], a[q, p] = 0.0, 0.0
        if not turned:
            return


@inlined
def copy_vector(source: NDArray[np.float64], out: NDArray[np.float64]) -> None:
    """Copy ``source`` to ``out``, both (n,).

    An assignment to a slice would first look for an overlap, and numba would compile the error message for
    it.
    """
    for i in range(out.shape[0]):
        out[i] = source[i]


@inlined
def copy_matrix(source: NDArray[np.float64], out: NDArray[np.float64]) -> None:
    """Copy ``source`` to ``out``, both (m, n), without a slice, for the reason given in ``copy_vector``."""
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = source[i, j]
