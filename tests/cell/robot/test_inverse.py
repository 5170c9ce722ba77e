import numpy as np
import pytest

from safety_harness.cell.robot.description import load_arm
from safety_harness.cell.robot.inverse import InverseKinematics
from safety_harness.cell.robot.kinematics import geometric_jacobian
from tests.cell.robot.arms import ARMS, random_joints, transforms_of

START = np.array([-0.22, -1.27, 1.98, -2.27, -1.57, -0.22])  # TCP over the table, looking down
LEAST = 0.02


@pytest.fixture(scope="module")
def ur10() -> InverseKinematics:
    return InverseKinematics(load_arm("ur10"))


def same_turn(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Largest difference of two joint positions, whole turns aside."""
    return np.abs((a - b + np.pi) % (2.0 * np.pi) - np.pi).max(axis=-1)


def singular_value_at(joints: np.ndarray) -> float:
    arm, jacobian = load_arm("ur10"), np.empty((6, 6))
    geometric_jacobian(arm.joint_axes, transforms_of(arm, joints), jacobian)
    return float(np.linalg.svd(jacobian, compute_uv=False)[-1])


@pytest.mark.parametrize("name", ARMS)
def test_every_branch_reproduces_the_pose_and_one_is_where_it_came_from(name: str) -> None:
    arm = load_arm(name)
    inverse = InverseKinematics(arm)
    counts = set()
    for joints in random_joints(arm, 300, seed=21):
        pose = transforms_of(arm, joints)[7]
        branches = inverse.branches(pose)
        counts.add(len(branches))
        for branch in branches:
            np.testing.assert_allclose(transforms_of(arm, branch)[7], pose, atol=1e-9)
        assert same_turn(branches, joints).min() < 1e-6
        assert ((branches > -np.pi) & (branches <= np.pi)).all()
        assert all(
            same_turn(branches[:i], branch).min(initial=9.0) > 1e-6 for i, branch in enumerate(branches)
        )
    assert max(counts) == 8


def test_a_pose_out_of_reach_has_no_solution(ur10: InverseKinematics) -> None:
    pose = transforms_of(ur10.arm, START)[7]
    pose[:3, 3] = [1.5, 0.0, 0.3]
    assert ur10.branches(pose).shape == (0, 6)
    assert ur10.nearest(pose, START) is None


def test_a_pose_on_the_base_axis_has_no_solution(ur10: InverseKinematics) -> None:
    pose = transforms_of(ur10.arm, START)[7]
    pose[:3, 3] = [0.0, 0.0, 0.8]
    assert ur10.branches(pose).shape == (0, 6)


def test_a_broken_pose_has_no_solution(ur10: InverseKinematics) -> None:
    pose = transforms_of(ur10.arm, START)[7]
    pose[0, 3] = np.nan
    assert ur10.branches(pose).shape == (0, 6)
    assert ur10.nearest(pose, START) is None


def test_nearest_gives_the_reference_back_even_beyond_half_a_turn(ur10: InverseKinematics) -> None:
    for joints in random_joints(ur10.arm, 200, seed=22):
        found = ur10.nearest(transforms_of(ur10.arm, joints)[7], joints)
        assert found is not None
        np.testing.assert_allclose(found, joints, atol=1e-6)


def test_nothing_within_the_limits_is_nearer_than_nearest(ur10: InverseKinematics) -> None:
    arm = ur10.arm
    poses, references = random_joints(arm, 50, seed=23), random_joints(arm, 50, seed=24)
    turns = 2.0 * np.pi * np.stack(np.meshgrid(*[[-1, 0, 1]] * 6), axis=-1).reshape(-1, 6)
    for joints, reference in zip(poses, references, strict=True):
        pose = transforms_of(arm, joints)[7]
        variants = (ur10.branches(pose)[:, None] + turns).reshape(-1, 6)
        allowed = ((variants >= arm.position_lower_rad) & (variants <= arm.position_upper_rad)).all(axis=1)
        best = np.linalg.norm(variants[allowed] - reference, axis=1).min()
        found = ur10.nearest(pose, reference)
        assert found is not None
        assert np.linalg.norm(found - reference) == pytest.approx(best, abs=1e-12)
        assert ((found >= arm.position_lower_rad) & (found <= arm.position_upper_rad)).all()


DIRECTIONS = [*np.eye(3), *-np.eye(3), *np.random.default_rng(25).normal(size=(6, 3))]


@pytest.mark.parametrize("direction", DIRECTIONS)
def test_reach_ends_where_exact_branches_say_so(ur10: InverseKinematics, direction: np.ndarray) -> None:
    """Follow the line with the closed form in small steps: fine before the end, not so just after it."""
    reached = ur10.reach_along(START, direction, 2.0, min_singular_value=LEAST)
    assert 0.1 < reached < 2.0
    start = transforms_of(ur10.arm, START)[7]
    unit = direction / np.linalg.norm(direction)
    joints = START

    def at(length: float) -> np.ndarray | None:
        pose = start.copy()
        pose[:3, 3] += length * unit
        return ur10.nearest(pose, joints)

    for length in np.append(np.arange(0.0, reached, 0.001), reached):
        found = at(length)
        assert found is not None
        assert np.abs(found - joints).max() < 0.1
        assert singular_value_at(found) >= LEAST * (1.0 - 1e-9)
        joints = found
    beyond = at(reached + 1.1e-4)
    assert beyond is None or np.abs(beyond - joints).max() > 0.1 or singular_value_at(beyond) < LEAST


def test_a_short_way_is_reached_to_its_end(ur10: InverseKinematics) -> None:
    for direction in DIRECTIONS:
        assert ur10.reach_along(START, direction, 0.1, min_singular_value=LEAST) == pytest.approx(
            0.1, abs=1e-12
        )


def test_the_step_does_not_change_the_answer(ur10: InverseKinematics) -> None:
    for direction in DIRECTIONS[:6]:
        coarse, fine = (
            ur10.reach_along(START, direction, 2.0, step_m=step, min_singular_value=LEAST)
            for step in (0.02, 0.001)
        )
        assert coarse == pytest.approx(fine, abs=1.1e-4)


def test_a_joint_limit_ends_the_way(ur10: InverseKinematics) -> None:
    """Turned to just short of the pan joint's limit, the way on is short and the way back is not."""
    joints = START.copy()
    joints[0] = ur10.arm.position_upper_rad[0] - 0.01
    tangent = np.array([-np.sin(joints[0]), np.cos(joints[0]), 0.0])
    ahead = ur10.reach_along(joints, tangent, 0.1, min_singular_value=LEAST)
    radius = np.hypot(*transforms_of(ur10.arm, joints)[7, :2, 3])
    assert 0.005 * radius < ahead < 0.02 * radius
    assert ur10.reach_along(joints, -tangent, 0.1, min_singular_value=LEAST) == pytest.approx(0.1)


def test_a_start_that_is_singular_or_outside_the_limits_leads_nowhere(ur10: InverseKinematics) -> None:
    singular, outside = START.copy(), START.copy()
    singular[4] = 0.0
    outside[2] = 3.5
    for joints in (singular, outside, np.full(6, np.nan)):
        assert ur10.reach_along(joints, [1.0, 0.0, 0.0], 0.1, min_singular_value=LEAST) == 0.0


@pytest.mark.parametrize("direction", [[0.0, 0.0, 0.0], [np.nan, 0.0, 0.0], [1.0, 0.0]])
def test_a_direction_without_length_is_refused(ur10: InverseKinematics, direction: list[float]) -> None:
    with pytest.raises(ValueError, match="direction_in_base"):
        ur10.reach_along(START, direction, 0.1, min_singular_value=LEAST)
