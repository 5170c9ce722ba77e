import numpy as np
import pytest

from safety_harness.base.geometry.linear import solve_in_place


def test_the_solution_fulfils_the_system() -> None:
    rng = np.random.default_rng(8)
    for n in (1, 2, 6, 8):
        for _ in range(20):
            matrix, vector = rng.normal(size=(n, n)), rng.normal(size=n)
            solution = vector.copy()
            assert solve_in_place(matrix.copy(), solution)
            np.testing.assert_allclose(solution, np.linalg.solve(matrix, vector), rtol=1e-9, atol=1e-11)


def test_a_zero_on_the_diagonal_is_pivoted_away() -> None:
    vector = np.array([2.0, 3.0])
    assert solve_in_place(np.array([[0.0, 1.0], [1.0, 0.0]]), vector)
    np.testing.assert_array_equal(vector, [3.0, 2.0])


@pytest.mark.parametrize("bad", [0.0, np.nan, np.inf])
def test_a_singular_or_broken_matrix_is_refused(bad: float) -> None:
    assert not solve_in_place(np.array([[1.0, 1.0], [1.0, 1.0]]) * bad, np.array([1.0, 2.0]))
    assert not solve_in_place(np.array([[1.0, 1.0], [1.0, 1.0]]), np.array([1.0, 2.0]))
