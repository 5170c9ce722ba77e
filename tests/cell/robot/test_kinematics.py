import numpy as np
import pytest
from disagreement import noted

from safety_harness.base.geometry.rotations import vector_from_rotation
from safety_harness.cell.robot.description import load_arm
from safety_harness.cell.robot.kinematics import (
    geometric_jacobian,
    is_well_conditioned,
    smallest_singular_value,
)
from tests.cell.robot.arms import ARMS, bullet_arm, random_joints, transforms_of

FLOAT32 = 2e-6  # PyBullet hands out link frames in single precision


def jacobian_of(name: str, joints: np.ndarray) -> np.ndarray:
    arm = load_arm(name)
    jacobian = np.full((6, 6), np.nan)
    geometric_jacobian(arm.joint_axes, transforms_of(arm, joints), jacobian)
    return jacobian


@pytest.mark.parametrize("name", ARMS)
def test_every_link_and_the_tcp_are_where_pybullet_puts_them(name: str) -> None:
    arm = load_arm(name)
    with bullet_arm(name) as bullet:
        for joints in random_joints(arm, 10, seed=1):
            bullet.move(joints)
            transforms = transforms_of(arm, joints)
            for link, ours in zip([*arm.link_names, "tool0"], transforms, strict=True):
                theirs = bullet.transform(link)
                noted("PyBullet", "where each link is", "mm", ours[:3, 3], theirs[:3, 3], 1e3)
                np.testing.assert_allclose(ours, theirs, atol=FLOAT32, err_msg=link)


@pytest.mark.parametrize("name", ARMS)
def test_the_jacobian_is_that_of_pybullet(name: str) -> None:
    with bullet_arm(name) as bullet:
        for joints in random_joints(load_arm(name), 10, seed=2):
            bullet.move(joints)
            np.testing.assert_allclose(
                jacobian_of(name, joints), bullet.jacobian(joints, "tool0"), atol=FLOAT32
            )


def test_the_jacobian_is_the_derivative_of_the_pose() -> None:
    arm, step = load_arm("ur10"), 1e-5
    for joints in random_joints(arm, 10, seed=3):
        differences = np.empty((6, 6))
        for i, shift in enumerate(step * np.eye(6)):
            after, before = transforms_of(arm, joints + shift)[7], transforms_of(arm, joints - shift)[7]
            differences[:3, i] = (after[:3, 3] - before[:3, 3]) / (2.0 * step)
            differences[3:, i] = vector_from_rotation(after[:3, :3] @ before[:3, :3].T) / (2.0 * step)
        np.testing.assert_allclose(jacobian_of("ur10", joints), differences, atol=1e-9)


def test_a_link_does_not_move_with_the_joints_beyond_it() -> None:
    arm = load_arm("ur10")
    joints = random_joints(arm, 1, seed=4)[0]
    for joint in range(6):
        moved = joints.copy()
        moved[joint] += 0.7
        before, after = transforms_of(arm, joints), transforms_of(arm, moved)
        np.testing.assert_array_equal(before[: joint + 1], after[: joint + 1])
        assert all(np.abs(before[k] - after[k]).max() > 0.1 for k in range(joint + 1, 8))


def test_the_smallest_singular_value_is_that_of_the_library() -> None:
    rng = np.random.default_rng(5)
    matrices = [jacobian_of("ur10", joints) for joints in random_joints(load_arm("ur10"), 100, seed=5)]
    matrices += [rng.normal(size=(6, 6)) * 10.0 ** rng.uniform(-4, 4, size=6) for _ in range(100)]
    for matrix in matrices:
        expected = np.linalg.svd(matrix, compute_uv=False)
        assert smallest_singular_value(matrix) == pytest.approx(expected[-1], abs=1e-14 * expected[0])


@pytest.mark.parametrize("joint", [2, 4])
def test_a_stretched_elbow_and_an_aligned_wrist_are_singular(joint: int) -> None:
    joints = np.array([0.3, -1.2, 1.5, -1.0, -1.4, 0.2])
    assert smallest_singular_value(jacobian_of("ur10", joints)) > 0.05
    joints[joint] = 0.0
    assert smallest_singular_value(jacobian_of("ur10", joints)) < 1e-12


def test_well_conditioned_means_that_the_smallest_singular_value_exceeds_the_bound() -> None:
    for joints in random_joints(load_arm("ur10"), 200, seed=6):
        jacobian = jacobian_of("ur10", joints)
        least = np.linalg.svd(jacobian, compute_uv=False)[-1]
        if least > 1e-4:
            assert is_well_conditioned(jacobian, least * (1.0 - 1e-6))
            assert not is_well_conditioned(jacobian, least * (1.0 + 1e-6))


def test_a_broken_jacobian_is_never_well_conditioned() -> None:
    for i in range(6):
        jacobian = np.eye(6)
        jacobian[i, (i + 2) % 6] = np.nan
        assert not is_well_conditioned(jacobian, 0.01)
        assert np.isnan(smallest_singular_value(jacobian))
