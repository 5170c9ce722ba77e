"""No reachable pose is without a branch, near a singularity, at it, or at two at once."""

from __future__ import annotations

import numpy as np
import pytest

from safety_harness.cell.robot.closed_form import FREE
from safety_harness.cell.robot.description import load_arm
from safety_harness.cell.robot.inverse import InverseKinematics
from tests.cell.robot.arms import ARMS, random_joints, transforms_of

OFFSETS = (0.0, 1e-16, 1e-12, 1e-10, 4e-10, 6e-10, 1e-9, 1e-8, 1e-7, 1e-6, 1e-5, 0.99e-4, 1e-4, 1.01e-4)
COUNT = 60  # poses of each kind; ten of those for which the shoulder's is sought


def away(branches: np.ndarray, joints: np.ndarray) -> float:
    """Largest difference in a joint from the nearest branch, whole turns aside."""
    apart = np.abs((branches - joints + np.pi) % (2.0 * np.pi) - np.pi).max(axis=1)
    return float(apart.min(initial=np.inf))


def singular(
    arm_name: str, offset: float, *, elbow: bool, shoulder: bool, seed: int, count: int = COUNT
) -> np.ndarray:
    """(n, 6) joints beside the wrist's singularity, and perhaps at the elbow's and the shoulder's too."""
    arm, rng = load_arm(arm_name), np.random.default_rng(seed)
    joints = random_joints(arm, count, seed=seed) % (2.0 * np.pi) - np.pi
    joints[:, 4] = rng.choice([0.0, np.pi], count) + rng.choice([-1.0, 1.0], count) * offset
    if elbow:
        joints[:, 2] = rng.choice([-1.0, 1.0], count) * offset
    if shoulder:  # joint 6 above the base axis: a shoulder that turns in place
        for row in joints:
            row[1] = root_of_reach(arm_name, row)
    return joints


def root_of_reach(arm_name: str, joints: np.ndarray) -> float:
    """The angle of joint 2 for which joint 6 is as near to the base axis as it can be."""
    angles = np.linspace(-np.pi, np.pi, 181)
    for _ in range(6):
        rows = np.repeat(joints[None], len(angles), axis=0)
        rows[:, 1] = angles
        reach = [np.hypot(*transforms_of(load_arm(arm_name), row)[6, :2, 3]) for row in rows]
        best, step = angles[int(np.argmin(reach))], angles[1] - angles[0]
        angles = np.linspace(best - step, best + step, 41)
    return float(best)


@pytest.mark.parametrize("offset", OFFSETS)
@pytest.mark.parametrize("arm_name", ARMS)
def test_a_pose_beside_the_wrist_singularity_has_the_branch_that_it_came_from(
    arm_name: str, offset: float
) -> None:
    arm = load_arm(arm_name)
    inverse = InverseKinematics(arm)
    for joints in singular(arm_name, offset, elbow=False, shoulder=False, seed=31):
        pose = transforms_of(arm, joints)[7]
        branches = inverse.branches(pose)
        assert len(branches) > 0
        for branch in branches:
            np.testing.assert_allclose(transforms_of(arm, branch)[7], pose, atol=1e-9)
        if offset > FREE:  # else the TCP stays while joints move
            assert away(branches, joints) < 1e-3
        assert all(away(branches[:i], branch) > 1e-6 for i, branch in enumerate(branches))


@pytest.mark.parametrize(
    ("elbow", "shoulder", "offset"),
    [(True, False, offset) for offset in OFFSETS]
    + [(False, True, offset) for offset in OFFSETS]
    + [(True, True, offset) for offset in OFFSETS if offset < 1e-5],
)
def test_a_pose_at_two_singularities_or_three_has_a_branch(
    elbow: bool, shoulder: bool, offset: float
) -> None:
    arm = load_arm("ur10")
    inverse = InverseKinematics(arm)
    count = COUNT // 6 if shoulder else COUNT
    for joints in singular("ur10", offset, elbow=elbow, shoulder=shoulder, seed=32, count=count):
        pose = transforms_of(arm, joints)[7]
        branches = inverse.branches(pose)
        assert len(branches) > 0
        for branch in branches:
            np.testing.assert_allclose(transforms_of(arm, branch)[7], pose, atol=1e-9)


def test_out_of_reach_there_is_none_beside_the_singularity_either() -> None:
    inverse = InverseKinematics(load_arm("ur10"))
    for joints in singular("ur10", 0.0, elbow=False, shoulder=False, seed=34)[:20]:
        pose = transforms_of(inverse.arm, joints)[7]
        pose[:3, 3] *= 3.0 / np.linalg.norm(pose[:3, 3])
        assert inverse.branches(pose).shape == (0, 6)
