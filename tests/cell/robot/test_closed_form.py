"""The closed form beside eaik, which solves the same arms by subproblems, and by laws of its own."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from disagreement import noted
from eaik.IK_HP import HPRobot

from safety_harness.base.exceptions import ArmModelError
from safety_harness.base.geometry.rotations import rotation_from_vector
from safety_harness.base.geometry.transforms import transform_from
from safety_harness.cell.robot.closed_form import arm_geometry
from safety_harness.cell.robot.description import ArmModel, load_arm
from safety_harness.cell.robot.inverse import EXACT_POSE, InverseKinematics
from safety_harness.cell.robot.kinematics import geometric_jacobian
from tests.cell.robot.arms import ARMS, random_joints, transforms_of

POSES = 2000
SAME_RAD = 1e-6  # but for rounding
FAR_FROM_SINGULAR = 1e-3  # of the least singular value: there eaik loses no branch


class Library:
    """eaik's branches of an arm: those that give the pose, for it has least-squares answers too."""

    def __init__(self, arm: ArmModel) -> None:
        zero = transforms_of(arm, np.zeros(6))  # its tool frame is parallel to the base there
        axes = np.array([zero[i + 1, :3, :3] @ arm.joint_axes[i] for i in range(6)])
        self.arm, self.turn = arm, zero[7, :3, :3].T
        self.robot = HPRobot(axes, np.diff(zero[:, :3, 3], axis=0))

    def branches(self, pose: np.ndarray) -> np.ndarray:
        turned = pose.copy()
        turned[:3, :3] = pose[:3, :3] @ self.turn
        answers = np.array(self.robot.IK(turned).Q).reshape(-1, 6)
        return np.array([q for q in answers if off(self.arm, q, pose) <= EXACT_POSE]).reshape(-1, 6)


def off(arm: ArmModel, joints: np.ndarray, pose: np.ndarray) -> float:
    return float(np.abs(transforms_of(arm, joints)[7] - pose).max())


def wrapped(angles: np.ndarray) -> np.ndarray:
    return (angles + np.pi) % (2.0 * np.pi) - np.pi


def to_nearest(some: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Of each of (n, 6) the largest difference in a joint from the nearest of (m, 6), whole turns aside."""
    return np.abs(wrapped(some[:, None] - others)).max(axis=2).min(axis=1, initial=np.inf)


def singular_value(arm: ArmModel, joints: np.ndarray) -> float:
    jacobian = np.empty((6, 6))
    geometric_jacobian(arm.joint_axes, transforms_of(arm, joints), jacobian)
    return float(np.linalg.svd(jacobian, compute_uv=False)[-1])


@pytest.mark.parametrize("name", ARMS)
def test_the_branches_are_those_of_eaik(name: str) -> None:
    """Ours are none too few, and one too many only beside a singularity, where eaik loses some."""
    arm = load_arm(name)
    inverse, library = InverseKinematics(arm), Library(arm)
    for joints in random_joints(arm, POSES, seed=41):
        pose = transforms_of(arm, joints)[7]
        ours, theirs = inverse.branches(pose), library.branches(pose)
        assert (to_nearest(theirs, ours) < SAME_RAD).all()
        for extra in ours[to_nearest(ours, theirs) >= SAME_RAD]:
            assert singular_value(arm, extra) < FAR_FROM_SINGULAR
        pairs = ours[np.abs(wrapped(theirs[:, None] - ours)).max(axis=2).argmin(axis=1)]
        if all(singular_value(arm, branch) > FAR_FROM_SINGULAR for branch in theirs):
            noted("eaik", "joints of branches", "rad", wrapped(pairs - theirs), np.zeros_like(pairs))


@pytest.mark.parametrize("name", ARMS)
@pytest.mark.parametrize("joint", [2, 4], ids=["elbow", "wrist"])
@pytest.mark.parametrize("offset", [0.0, 1e-12, 1e-9, 1e-7, 1e-5, 1e-3])
def test_beside_a_singularity_no_branch_of_eaik_is_missing(name: str, joint: int, offset: float) -> None:
    arm = load_arm(name)
    inverse, library = InverseKinematics(arm), Library(arm)
    for joints in random_joints(arm, 100, seed=42):
        joints[joint] = np.pi * round(joints[joint] / np.pi) * (joint == 4) + offset
        pose = transforms_of(arm, joints)[7]
        ours, theirs = inverse.branches(pose), library.branches(pose)
        assert len(ours) > 0
        assert all(off(arm, branch, pose) <= EXACT_POSE for branch in ours)
        if joint == 2 or offset > 1e-8:  # else joints move while the TCP stays, and each has its own choice
            resolved = 1e-6 + 1e-8 / max(offset, 1e-3)
            assert (to_nearest(theirs, ours) < resolved).all()


@pytest.mark.parametrize("name", ARMS)
def test_at_the_edge_of_reach_it_is_the_arm_that_ends_not_the_solution(name: str) -> None:
    """Straight out until nothing is found: within 0.1 mm of there eaik agrees on both sides."""
    arm = load_arm(name)
    inverse, library = InverseKinematics(arm), Library(arm)
    rng = np.random.default_rng(43)
    for _ in range(50):
        pose = transform_from(rotation_from_vector(rng.normal(size=3)), np.zeros(3))
        way = rng.normal(size=3)
        way /= np.linalg.norm(way)

        def at(length: float, pose: np.ndarray = pose, way: np.ndarray = way) -> np.ndarray:
            moved: np.ndarray = pose.copy()
            moved[:3, 3] = length * way
            return moved

        reached, beyond = 0.3, 3.0
        if not len(inverse.branches(at(reached))):
            continue
        while beyond - reached > 1e-12:
            middle = 0.5 * (reached + beyond)
            if len(inverse.branches(at(middle))):
                reached = middle
            else:
                beyond = middle
        assert len(library.branches(at(reached - 1e-4))) > 0
        assert len(library.branches(at(beyond + 1e-4))) == 0
        assert len(inverse.branches(at(beyond + 1.0))) == 0


@pytest.mark.parametrize("name", ARMS)
def test_branches_come_in_pairs_and_each_gives_the_pose_to_rounding(name: str) -> None:
    arm = load_arm(name)
    inverse = InverseKinematics(arm)
    worst = 0.0
    for joints in random_joints(arm, POSES, seed=44):
        pose = transforms_of(arm, joints)[7]
        branches = inverse.branches(pose)
        assert len(branches) in (2, 4, 6, 8)
        worst = max(worst, *(off(arm, branch, pose) for branch in branches))
    assert worst < 1e-14


def test_the_same_pose_has_the_same_branches_to_the_bit_in_the_order_of_the_docstring() -> None:
    arm = load_arm("ur10")
    first, second = InverseKinematics(arm), InverseKinematics(arm)
    for joints in random_joints(arm, 200, seed=45):
        pose = transforms_of(arm, joints)[7]
        branches = first.branches(pose)
        assert branches.tobytes() == second.branches(pose).tobytes()
        for before, after in pairwise(branches):
            if before[0] == after[0]:
                assert np.sin(before[4]) >= np.sin(after[4]) - 1e-9


@pytest.mark.parametrize("numeric", [False, True])
@pytest.mark.parametrize("name", ARMS[:1])
def test_poses_that_are_followed_are_each_nearest_to_the_one_before_until_one_has_none(
    name: str, numeric: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    arm = load_arm(name)
    inverse = InverseKinematics(arm)
    if numeric:
        monkeypatch.setattr(inverse, "_geometry", None)
    (joints,) = random_joints(arm, 1, seed=47)
    poses = np.repeat(transforms_of(arm, joints)[7][None], 8, axis=0)
    poses[:, 0, 3] += 0.01 * np.arange(8)
    poses[6, :3, 3] += 3.0
    found = inverse.followed(poses, joints)
    for pose, solution in zip(poses[:6], found, strict=False):
        alone = inverse.nearest(pose, joints)
        assert alone is not None
        assert solution.tobytes() == alone.tobytes()
        joints = alone
    assert np.isnan(found[6:]).all()


@pytest.mark.parametrize("name", ARMS)
def test_many_at_once_are_those_one_by_one_to_the_bit(name: str) -> None:
    arm = load_arm(name)
    inverse = InverseKinematics(arm)
    reference, *others = random_joints(arm, 300, seed=46)
    poses = np.array([transforms_of(arm, joints)[7] for joints in others])
    poses[::3, :3, 3] += 3.0
    together = inverse.nearest_of_each(poses, reference)
    assert together.shape == (299, 6)
    for pose, solution in zip(poses, together, strict=True):
        alone = inverse.nearest(pose, reference)
        assert np.isnan(solution).all() if alone is None else alone.tobytes() == solution.tobytes()
    assert np.isnan(together[::3, 0]).all()
    assert not np.isnan(together[1::3, 0]).any()
    assert inverse.nearest_of_each(poses[:0], reference).shape == (0, 6)


@pytest.mark.parametrize("entry", [(0, 0), (2, 3), (3, 3)])
@pytest.mark.parametrize("value", [np.nan, np.inf, 2.0])
def test_what_is_no_pose_has_no_branch(entry: tuple[int, int], value: float) -> None:
    arm = load_arm("ur10")
    inverse = InverseKinematics(arm)
    pose = transforms_of(arm, np.array([-0.22, -1.27, 1.98, -2.27, -1.57, -0.22]))[7]
    pose[entry] = value
    assert inverse.branches(pose).shape == (0, 6)
    assert inverse.nearest(pose, np.zeros(6)) is None


def tilted(joint: int, axis: int) -> ArmModel:
    """The UR10 with a joint a thousandth of a turn off."""
    arm, tilt, origins = load_arm("ur10"), np.zeros(3), load_arm("ur10").joint_origins.copy()
    tilt[axis] = 1e-3 * 2.0 * np.pi
    origins[joint] = origins[joint] @ transform_from(rotation_from_vector(tilt), np.zeros(3))
    return replace(arm, joint_origins=origins)


@pytest.mark.parametrize(
    ("joint", "axis"), [(1, 2), (2, 0), (2, 2), (3, 0), (3, 2), (4, 0), (4, 2), (5, 0), (5, 2)]
)
def test_an_arm_whose_wrist_is_another_has_no_closed_form_and_is_solved(joint: int, axis: int) -> None:
    assert_is_numeric(tilted(joint, axis))


def assert_is_numeric(arm: ArmModel) -> None:
    """No closed form would be right, and yet a pose of its joints is reached."""
    with pytest.raises(ArmModelError, match="UR family"):
        arm_geometry(arm)
    (joints,) = random_joints(arm, 1, seed=48)
    pose = transforms_of(arm, joints)[7]
    found = InverseKinematics(arm).nearest(pose, joints + 0.1)
    assert found is not None
    assert off(arm, found, pose) <= EXACT_POSE


@pytest.mark.parametrize(("joint", "axis"), [(0, 2), (1, 0), (1, 1), (2, 1), (3, 1), (4, 1), (5, 1)])
def test_an_arm_that_only_counts_from_another_zero_is_solved(joint: int, axis: int) -> None:
    """Tilted about the axis of the joint itself, or of the one before."""
    arm = tilted(joint, axis)
    inverse = InverseKinematics(arm)
    for joints in random_joints(arm, 50, seed=47):
        pose = transforms_of(arm, joints)[7]
        branches = inverse.branches(pose)
        assert to_nearest(joints[None], branches)[0] < SAME_RAD
        assert all(off(arm, branch, pose) < 1e-10 for branch in branches)


def test_an_arm_whose_axes_5_and_6_do_not_meet_has_no_closed_form_and_is_solved() -> None:
    arm = load_arm("ur10")
    origins = arm.joint_origins.copy()
    origins[5, 0, 3] += 1e-3
    assert_is_numeric(replace(arm, joint_origins=origins))
