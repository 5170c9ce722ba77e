from __future__ import annotations

import numpy as np
import pytest

from safety_harness.base.geometry.linear import invert
from safety_harness.cell.robot.description import load_arm
from safety_harness.cell.robot.kinematics import forward_kinematics, geometric_jacobian, joint_velocity

ARM = load_arm("ur10")
LEAST = 0.02


def jacobian_at(joints: np.ndarray) -> np.ndarray:
    transforms, jacobian = np.empty((8, 4, 4)), np.empty((6, 6))
    forward_kinematics(ARM.chain[0], joints, transforms)
    geometric_jacobian(ARM.joint_axes, transforms, jacobian)
    return jacobian


def solved(jacobian: np.ndarray, twist: np.ndarray, least: float = LEAST) -> tuple[bool, np.ndarray]:
    rates = np.full(6, 7.0)
    return joint_velocity(jacobian, twist, least, rates), rates


def random_jacobians(count: int) -> list[np.ndarray]:
    rng = np.random.default_rng(5)
    return [jacobian_at(joints) for joints in rng.uniform(-np.pi, np.pi, (count, 6))]


def test_the_joint_velocities_make_the_twist_that_was_asked_for() -> None:
    rng = np.random.default_rng(6)
    regular = 0
    for jacobian in random_jacobians(300):
        twist = rng.uniform(-0.5, 0.5, 6)
        good, rates = solved(jacobian, twist)
        if good:
            regular += 1
            assert jacobian @ rates == pytest.approx(twist, abs=1e-12)
    assert regular > 200


def test_the_joints_really_carry_the_tcp_so() -> None:
    """By finite differences of forward kinematics, not by the Jacobian."""
    joints = np.array([-0.22, -1.27, 1.98, -2.27, -1.57, -1.79])
    twist = np.array([0.05, -0.1, 0.2, 0.1, -0.2, 0.3])
    good, rates = solved(jacobian_at(joints), twist)
    assert good
    step = 1e-6
    poses = []
    for sign in (-1.0, 1.0):
        transforms = np.empty((8, 4, 4))
        forward_kinematics(ARM.chain[0], joints + sign * step * rates, transforms)
        poses.append(transforms[7].copy())
    assert (poses[1][:3, 3] - poses[0][:3, 3]) / (2 * step) == pytest.approx(twist[:3], abs=1e-8)
    spin = (poses[1][:3, :3] - poses[0][:3, :3]) / (2 * step) @ poses[0][:3, :3].T
    assert (spin[2, 1], spin[0, 2], spin[1, 0]) == pytest.approx(twist[3:], abs=1e-5)


def test_the_bound_is_the_least_singular_value_itself() -> None:
    twist = np.ones(6)
    for jacobian in random_jacobians(200):
        least = np.linalg.svd(jacobian, compute_uv=False)[-1]
        for bound, regular in ((0.999 * least, True), (1.001 * least, False)):
            good, rates = solved(jacobian, twist, bound)
            assert good is regular
            assert rates.any() == regular  # nothing moves where the answer is no


@pytest.mark.parametrize(
    "joints",
    [
        (0.3, -1.0, 0.0, 0.5, 1.0, 0.2),  # elbow straight
        (0.3, -1.0, 1.2, 0.5, 0.0, 0.2),  # wrist singularity
        (0.3, -1.0, 1.2, 0.5, np.pi, 0.2),
    ],
)
def test_a_singular_arm_does_not_move(joints: tuple[float, ...]) -> None:
    good, rates = solved(jacobian_at(np.array(joints)), np.ones(6))
    assert not good
    assert np.array_equal(rates, np.zeros(6))
    assert not solved(jacobian_at(np.array(joints) + 1e-4), np.ones(6))[0]  # nor does one next to it


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("place", [(0, 0), (0, 5), (2, 3), (5, 5)])
def test_a_jacobian_that_is_no_number_does_not_move_the_arm(value: float, place: tuple[int, int]) -> None:
    jacobian = random_jacobians(1)[0]
    jacobian[place] = value
    good, rates = solved(jacobian, np.ones(6))
    assert not good
    assert np.array_equal(rates, np.zeros(6))


@pytest.mark.parametrize("n", [1, 2, 3, 6])
def test_invert_agrees_with_numpy(n: int) -> None:
    rng = np.random.default_rng(n)
    for _ in range(50):
        matrix = rng.standard_normal((n, n))
        kept, inverse = matrix.copy(), np.empty((n, n))
        assert invert(matrix, inverse)
        expected = np.linalg.inv(matrix)
        assert inverse == pytest.approx(expected, abs=1e-13 * np.linalg.cond(matrix) * np.abs(expected).max())
        assert np.array_equal(matrix, kept)


def beside_the_identity(matrix: np.ndarray) -> np.ndarray:
    """A^-1 by turning (A | I) into (I | A^-1), row by row."""
    n = len(matrix)
    rows = np.hstack([matrix, np.eye(n)])
    for column in range(n):
        pivot = column + int(np.argmax(np.abs(rows[column:, column])))
        rows[[column, pivot]] = rows[[pivot, column]]
        rows[column] *= 1.0 / rows[column, column]
        for row in range(n):
            if row != column:
                rows[row] -= rows[row, column] * rows[column]
    return rows[:, n:]


def test_invert_in_place_gives_each_number_of_the_elimination_beside_the_identity() -> None:
    """The bits of every trace hang on it."""
    rng, inverse = np.random.default_rng(9), np.empty((6, 6))
    for matrix in [*random_jacobians(50), *rng.standard_normal((50, 6, 6))]:
        assert invert(matrix, inverse)
        assert np.array_equal(inverse, beside_the_identity(matrix))


def test_invert_swaps_rows_where_the_diagonal_is_zero() -> None:
    matrix, inverse = np.array([[0.0, 2.0, 0.0], [0.0, 0.0, 4.0], [8.0, 0.0, 0.0]]), np.empty((3, 3))
    assert invert(matrix, inverse)
    assert matrix @ inverse == pytest.approx(np.eye(3), abs=1e-15)


@pytest.mark.parametrize(
    "matrix", [np.zeros((3, 3)), np.ones((3, 3)), np.diag([1.0, 0.0, 2.0]), np.full((3, 3), np.nan)]
)
def test_invert_says_so_where_there_is_no_inverse(matrix: np.ndarray) -> None:
    assert not invert(matrix, np.empty((3, 3)))
