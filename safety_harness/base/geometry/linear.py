"""Solve small dense linear systems and copy arrays in compiled code.

Numba's own solver would need scipy.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import compiled, inlined, njit_no_nrt


@compiled
def solve_in_place(matrix: NDArray[np.float64], vector: NDArray[np.float64]) -> bool:
    """Solve A x = b by Gaussian elimination with partial pivoting (Golub and Van Loan, 2013, section 3.4).

    Args:
        matrix: (n, n) The matrix A, which the elimination overwrites.
        vector: (n,) The vector b, which the function replaces by the solution x.

    Returns:
        True if the system was solved, and False if a pivot is zero or not finite.  If the result is False,
        the contents of ``vector`` are meaningless.

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
    # Back substitution.
    for row in range(n - 1, -1, -1):
        total = vector[row]
        for j in range(row + 1, n):
            total -= matrix[row, j] * vector[j]
        vector[row] = total / matrix[row, row]
    return True


@njit_no_nrt
def invert(matrix: NDArray[np.float64], inverse_out: NDArray[np.float64]) -> bool:
    """Compute the inverse of a matrix by Gauss-Jordan elimination with partial pivoting.

    Row operations turn (A | I) into (I | A^-1).  An exactly singular matrix is a valid input, for example the
    matrix of a straight elbow.  Therefore the function returns False for a singular matrix, and raises no
    exception.

    Args:
        matrix: (n, n) The matrix A, which does not change.  Its size n is at most 15.
        inverse_out: (n, n) The array that the function fills with A^-1.

    Returns:
        True if the inverse was computed, and False if a pivot is 0 or not finite.

    """
    return invert_with(matrix, matrix.shape[0], inverse_out)


@inlined
def invert_with(matrix: NDArray[np.float64], n: int, inverse_out: NDArray[np.float64]) -> bool:
    """Compute the inverse of a matrix as ``invert`` does.

    The size ``n`` is a separate argument.  If a caller passes a constant, the compiler unrolls the loops.
    After each step, the elimination no longer needs a column of A.  The function stores a column of A^-1 in
    its place.  Therefore, each swap of two rows requires a swap of two columns at the end.  The integer
    ``pivots`` stores the row swaps, four bits for each column.

    Args:
        matrix: (n, n) The matrix A, which does not change.
        n: The size of the matrix, at most 15.
        inverse_out: (n, n) The array that the function fills with A^-1.

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
    """Return the eigenvalues (n,) of ``symmetric`` (n, n) in rising order, and its eigenvectors.

    The eigenvectors are the columns of a matrix (n, n).
    """
    values, vectors = np.array(symmetric, np.float64), np.eye(len(symmetric))
    _rotate_to_diagonal(values, vectors)
    order = np.argsort(np.diagonal(values), kind="stable")
    return np.diagonal(values)[order], vectors[:, order]


@njit_no_nrt
def _rotate_to_diagonal(a: NDArray[np.float64], vectors: NDArray[np.float64]) -> None:
    """Make the symmetric ``a`` (n, n) diagonal by Jacobi rotations (Golub and Van Loan, 2013, section 8.5).

    The columns of ``vectors`` (n, n) undergo the same rotations.
    """
    n, size = a.shape[0], 0.0
    for k in range(n):
        size += abs(a[k, k])
    # Convergence is quadratic after a few sweeps, so this limit is only a guard against an endless loop.
    for _ in range(60):
        turned = False
        for p in range(n - 1):
            for q in range(p + 1, n):
                # A smaller entry changes the eigenvalues by less than the rounding of the largest.
                if not abs(a[p, q]) > 1e-17 * size:
                    continue
                turned = True
                # The smaller root t of t^2 + 2 slope t - 1 = 0 is a turn of at most 45 degrees, for which the
                # sweeps converge.
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
                # The turn makes them 0, except for rounding.
                a[p, q], a[q, p] = 0.0, 0.0
        if not turned:
            return


@inlined
def copy_vector(source: NDArray[np.float64], out: NDArray[np.float64]) -> None:
    """Copy ``source`` (n,) to ``out`` (n,).

    A loop is cheaper than an assignment to a slice.  For a slice, numba would also compile a test for overlap
    and an error message.
    """
    for i in range(out.shape[0]):
        out[i] = source[i]


@inlined
def copy_matrix(source: NDArray[np.float64], out: NDArray[np.float64]) -> None:
    """Copy ``source`` (m, n) to ``out`` (m, n).

    The function uses loops instead of slices for the reason that ``copy_vector`` states.
    """
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = source[i, j]
