"""Numeric inverse kinematics, of makers' arms and of made-up ones, beside the closed form and NumPy."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_any_joints import jacobian_at, made_up

from safety_harness.cell.robot.description import ArmModel, load_arm, read_arm
from safety_harness.cell.robot.inverse import InverseKinematics
from safety_harness.cell.robot.kinematics import links_in_base
from safety_harness.cell.robot.numeric_inverse import all_found, nearest_found, starts_of
from tests.cell.robot.arms import random_joints
from tests.cell.robot.urdfs import OTHERS

SIX, SEVEN = ["xarm6", "six", "six endless"], ["panda", "iiwa", "seven", "seven endless"]
OTHER_COUNTS = ["three", "five", "eight"]
COUNTS = {"three": 3, "five": 5, "six": 6, "seven": 7, "eight": 8}


@lru_cache
def arm_named(name: str) -> ArmModel:
    """One of PyBullet's data, or one of so many joints anyhow: up to 2 rad both ways, or endless."""
    if name in OTHERS:
        file, base, tcp = OTHERS[name]
        return read_arm(file, base=base, tcp=tcp)
    count, _, endless = name.partition(" ")
    n = COUNTS[count]
    (chain,) = made_up(n)
    limit = np.full(n, np.inf if endless else 2.0)
    return replace(
        load_arm("ur10"),
        name=name,
        joint_names=tuple("abcdefgh"[:n]),
        link_names=("base", *"abcdefgh"[:n]),
        **{key: chain[key] for key in ("joint_origins", "joint_axes", "flange")},
        position_lower_rad=-limit,
        position_upper_rad=limit,
    )


def pose_at(arm: ArmModel, joints: np.ndarray) -> np.ndarray:
    return np.array(links_in_base(arm, joints)[-1])


def some(arm: ArmModel, count: int, seed: int) -> np.ndarray:
    """Joint positions (count, n) within the limits, of a joint without limits within four turns."""
    rng = np.random.default_rng(seed)
    lower, upper = (
        np.maximum(arm.position_lower_rad, -8 * np.pi),
        np.minimum(arm.position_upper_rad, 8 * np.pi),
    )
    return rng.uniform(lower, upper, (count, len(lower)))


def within_limits(arm: ArmModel, joints: np.ndarray) -> bool:
    return bool(((arm.position_lower_rad <= joints) & (joints <= arm.position_upper_rad)).all())


def numeric_nearest(arm: ArmModel, pose: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """(n,) the nearest by numbers, even where there is a closed form; NaN for none."""
    limits = arm.position_lower_rad, arm.position_upper_rad
    return np.array(nearest_found(arm.chain, *limits, starts_of(arm), pose[None], reference)[0])


def turns_apart(joints: np.ndarray, others: np.ndarray) -> np.ndarray:
    """(k,) the largest difference of joints (n,) from each of (k, n), whole turns aside."""
    return np.abs((others - joints + np.pi) % (2.0 * np.pi) - np.pi).max(axis=-1)


@pytest.mark.parametrize(
    "name",
    [
        *SIX,
        *SEVEN,
        OTHER_COUNTS[0],
        *(pytest.param(name, marks=pytest.mark.long) for name in OTHER_COUNTS[1:]),  # each is compiled anew
    ],
)
def test_a_pose_that_joints_within_limits_give_is_reached_exactly_within_limits(name: str) -> None:
    arm = arm_named(name)
    inverse = InverseKinematics(arm)
    count = 8 if name in OTHER_COUNTS else 12  # a pose of arms made up anyhow takes ten times as long
    for joints, reference in zip(some(arm, count, 1), some(arm, count, 2), strict=True):
        pose = pose_at(arm, joints)
        found = inverse.nearest(pose, reference)
        assert found is not None
        np.testing.assert_allclose(pose_at(arm, found), pose, rtol=0.0, atol=1e-9)
        assert within_limits(arm, found)


@pytest.mark.parametrize("name", SIX + SEVEN)
def test_every_branch_that_is_found_gives_the_pose_and_none_is_there_twice(name: str) -> None:
    arm = arm_named(name)
    for joints in some(arm, 3, 3):
        pose = pose_at(arm, joints)
        branches = InverseKinematics(arm).branches(pose)
        assert len(branches) > 0
        for i, branch in enumerate(branches):
            np.testing.assert_allclose(pose_at(arm, branch), pose, rtol=0.0, atol=1e-9)
            assert turns_apart(branch, branches[:i]).min(initial=9.0) > 1e-6
        assert ((branches > -np.pi) & (branches <= np.pi)).all()
        if len(joints) == 6:
            assert turns_apart(joints, branches).min() < 1e-6


@pytest.mark.parametrize("name", ["ur10", *SIX, *SEVEN])
def test_what_is_no_pose_or_out_of_reach_has_no_solution(name: str) -> None:
    arm = load_arm(name) if name == "ur10" else arm_named(name)
    (joints,) = some(arm, 1, 4)
    pose = pose_at(arm, joints)
    length = np.linalg.norm([*arm.joint_origins[1:, :3, 3], arm.flange[:3, 3]], axis=1).sum()
    for there in ("far", "just too far", "not a number", "endless", "mirrored", "swollen"):
        spoilt = pose.copy()
        match there:
            case "far":
                spoilt[:3, 3] += 100.0
            case "just too far":
                spoilt[:3, 3] = arm.joint_origins[0, :3, 3] + [0.0, 0.0, length + 1e-6]
            case "not a number" | "endless":
                spoilt[0, 3] = np.nan if there == "not a number" else np.inf
            case "mirrored":
                spoilt[:3, 2] *= -1.0
            case _:
                spoilt[:3, :3] *= 1.1
        assert np.isnan(numeric_nearest(arm, spoilt, joints)).all(), there
        assert len(all_found(arm.chain, starts_of(arm), spoilt)) == 0, there


def test_numbers_find_a_ur10s_pose_exactly_where_the_closed_form_does() -> None:
    """Of any pose in a cube about the arm, some of which are out of reach though not beyond its length."""
    arm, rng = load_arm("ur10"), np.random.default_rng(5)
    inverse, reached = InverseKinematics(arm), 0
    for rotation, position in zip(Rotation.random(80, rng), rng.uniform(-1.2, 1.2, (80, 3)), strict=True):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotation.as_matrix(), position
        exact, numeric = inverse.nearest(pose, np.zeros(6)), numeric_nearest(arm, pose, np.zeros(6))
        assert np.isnan(numeric).all() == (exact is None)
        reached += exact is not None
    assert 10 < reached < 70


def test_the_branches_found_for_a_ur10_are_those_of_the_closed_form() -> None:
    arm = load_arm("ur10")
    found = of_closed_form = 0
    for joints in random_joints(arm, 50, 6):
        pose = pose_at(arm, joints)
        exact, numeric = InverseKinematics(arm).branches(pose), all_found(arm.chain, starts_of(arm), pose)
        assert all(turns_apart(branch, exact).min() < 1e-6 for branch in numeric)
        found, of_closed_form = found + len(numeric), of_closed_form + len(exact)
    assert found > 0.97 * of_closed_form


def test_the_nearest_found_for_a_ur10_is_the_closed_forms() -> None:
    arm = load_arm("ur10")
    for joints, reference in zip(random_joints(arm, 80, 7), random_joints(arm, 80, 8), strict=True):
        pose = pose_at(arm, joints)
        exact = InverseKinematics(arm).nearest(pose, reference)
        numeric = numeric_nearest(arm, pose, reference)
        assert exact is not None
        assert np.linalg.norm(numeric - reference) == pytest.approx(
            np.linalg.norm(exact - reference), abs=1e-6
        )


@pytest.mark.parametrize("name", SIX + SEVEN)
def test_from_close_by_a_pose_is_reached_close_by(name: str) -> None:
    arm, rng = arm_named(name), np.random.default_rng(9)
    for joints in some(arm, 30, 10):
        shifted = np.clip(
            joints + rng.normal(0.0, 0.02, len(joints)), arm.position_lower_rad, arm.position_upper_rad
        )
        found = InverseKinematics(arm).nearest(pose_at(arm, joints), shifted)
        assert found is not None
        assert np.linalg.norm(found - shifted) <= np.linalg.norm(joints - shifted) + 1e-6


@pytest.mark.parametrize("name", SEVEN)
def test_no_step_along_its_self_motion_takes_a_redundant_arm_nearer(name: str) -> None:
    """The null space of J is one line here: on it the distance is level, or a joint is at its stop."""
    arm, free = arm_named(name), 0
    for joints, reference in zip(some(arm, 40, 11), some(arm, 40, 12), strict=True):
        found = InverseKinematics(arm).nearest(pose_at(arm, joints), reference)
        assert found is not None
        _, values, rows = np.linalg.svd(jacobian_at(arm.chain, found))
        assert values[-1] > 1e-6  # so that the null space is a line
        down = rows[6] * (rows[6] @ (reference - found))
        below, above = found - arm.position_lower_rad < 1e-5, arm.position_upper_rad - found < 1e-5
        stopped = (below & (down < 0.0)) | (above & (down > 0.0))
        assert stopped.any() or np.linalg.norm(down) < 5e-3
        free += not stopped.any()
    assert free > 15


@pytest.mark.parametrize("name", ["six endless", "seven endless"])
def test_a_joint_without_a_limit_ends_within_half_a_turn_of_where_it_is(name: str) -> None:
    arm = arm_named(name)
    for joints, reference in zip(some(arm, 20, 13), some(arm, 20, 14), strict=True):
        found = InverseKinematics(arm).nearest(pose_at(arm, joints), reference)
        assert found is not None
        assert np.abs(found - reference).max() <= np.pi + 1e-9
    assert max(np.abs(some(arm, 20, 14)).max(axis=1)) > 4.0 * np.pi
