"""Kernels take the number of joints from what they are handed: chains of three, seven and eight."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from safety_harness.base.settings import DEFAULTS
from safety_harness.cell.robot.capsules import Arm
from safety_harness.cell.robot.closest_approach import MAX_BISECTIONS, closest_approach_between
from safety_harness.cell.robot.description import chain_of, read_arm
from safety_harness.cell.robot.distance import CAPSULE, chain_lengths, hand_distance, place_capsules
from safety_harness.cell.robot.drive import drive, drive_tick
from safety_harness.cell.robot.kinematics import (
    forward_kinematics,
    geometric_jacobian,
    is_well_conditioned,
    joint_velocity,
    links_in_base,
    smallest_singular_value,
    tcp_velocity,
)
from tests.cell.robot.urdfs import OTHERS

COUNTS = [3, 6, 7, pytest.param(8, marks=pytest.mark.long)]  # nobody else compiles for eight


def pose(rotation: Rotation, position: np.ndarray) -> np.ndarray:
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = rotation.as_matrix(), position
    return transform


def made_up(n: int) -> np.ndarray:
    """(1,) a chain of n joints, anyhow."""
    rng = np.random.default_rng(n)
    chain = np.zeros(1, chain_of(n))
    poses = [pose(Rotation.random(rng=rng), rng.uniform(-0.4, 0.4, 3)) for _ in range(n + 1)]
    axes = rng.normal(size=(n, 3))
    chain["joint_origins"], chain["flange"] = poses[:n], poses[n]
    chain["joint_axes"] = axes / np.linalg.norm(axes, axis=1, keepdims=True)
    return chain


def transforms_at(chain: np.ndarray, joints: np.ndarray) -> np.ndarray:
    transforms = np.full((len(joints) + 2, 4, 4), np.nan)
    forward_kinematics(chain[0], joints, transforms)
    return transforms


def jacobian_at(chain: np.ndarray, joints: np.ndarray) -> np.ndarray:
    jacobian = np.full((6, len(joints)), np.nan)
    geometric_jacobian(chain[0]["joint_axes"], transforms_at(chain, joints), jacobian)
    return jacobian


def by_matrices(chain: np.ndarray, joints: np.ndarray) -> list[np.ndarray]:
    """Every frame as a product of scipy's rotations."""
    frames = [np.eye(4)]
    for origin, axis, angle in zip(
        *(chain[0][k] for k in ("joint_origins", "joint_axes")), joints, strict=True
    ):
        frames.append(frames[-1] @ origin @ pose(Rotation.from_rotvec(angle * axis), np.zeros(3)))
    return [*frames, frames[-1] @ chain[0]["flange"]]


def some(n: int, count: int) -> np.ndarray:
    return np.random.default_rng(10 + n).uniform(-np.pi, np.pi, (count, n))


@pytest.mark.parametrize("n", COUNTS)
def test_frames_are_products_of_matrices(n: int) -> None:
    chain = made_up(n)
    for joints in some(n, 20):
        np.testing.assert_allclose(transforms_at(chain, joints), by_matrices(chain, joints), atol=1e-12)


@pytest.mark.parametrize("n", COUNTS)
def test_the_jacobian_is_the_derivative_of_those_products(n: int) -> None:
    chain, step = made_up(n), 1e-5
    for joints in some(n, 5):
        jacobian, rates = jacobian_at(chain, joints), some(n, 1)[0]
        for column, shift in zip(jacobian.T, step * np.eye(n), strict=True):
            after, before = (by_matrices(chain, joints + sign * shift)[-1] for sign in (1.0, -1.0))
            spin = Rotation.from_matrix(after[:3, :3] @ before[:3, :3].T).as_rotvec()
            moved = np.concatenate((after[:3, 3] - before[:3, 3], spin)) / (2.0 * step)
            np.testing.assert_allclose(column, moved, atol=1e-9)
        velocity = tcp_velocity(chain[0]["joint_axes"], transforms_at(chain, joints), rates)
        assert velocity == pytest.approx(jacobian[:3] @ rates, abs=1e-12)


@pytest.mark.parametrize("name", OTHERS)
def test_frames_of_other_makers_arms_are_products_of_matrices(name: str) -> None:
    file, base, tcp = OTHERS[name]
    arm = read_arm(file, base=base, tcp=tcp)
    for joints in some(len(arm.joint_names), 20):
        expected = by_matrices(arm.chain, joints)
        np.testing.assert_allclose(links_in_base(arm, joints), expected, atol=1e-12)


@pytest.mark.parametrize("n", COUNTS)
def test_the_joint_velocities_are_those_of_the_pseudo_inverse(n: int) -> None:
    """For more than six joints the twist exactly, with least norm; for fewer the twist that is nearest."""
    chain, twist, told = made_up(n), np.array([0.05, -0.1, 0.2, 0.1, -0.2, 0.3]), 0
    for joints in some(n, 100):
        jacobian, rates = jacobian_at(chain, joints), np.full(n, 7.0)
        good = joint_velocity(jacobian, twist, 0.02, rates)
        expected = np.linalg.pinv(jacobian) @ twist if good else np.zeros(n)
        assert rates == pytest.approx(expected, abs=1e-9)
        told += good
    assert told > 50


@pytest.mark.parametrize("n", COUNTS)
def test_the_bound_is_the_least_singular_value(n: int) -> None:
    chain, rates = made_up(n), np.empty(n)
    for joints in some(n, 100):
        jacobian = jacobian_at(chain, joints)
        least = np.linalg.svd(jacobian, compute_uv=False)[-1]
        assert smallest_singular_value(jacobian) == pytest.approx(least, abs=1e-13)
        if least > 1e-4:
            for bound, regular in ((least * (1.0 - 1e-6), True), (least * (1.0 + 1e-6), False)):
                assert is_well_conditioned(jacobian, bound) is regular
                assert joint_velocity(jacobian, np.ones(6), bound, rates) is regular


@pytest.mark.parametrize("n", COUNTS)
def test_a_singular_arm_and_one_that_is_no_number_do_not_move(n: int) -> None:
    chain = made_up(n)
    chain["joint_axes"] = [0.0, 0.0, 1.0]
    chain["joint_origins"][0, :, :3, :3] = np.eye(3)  # all in one plane
    chain["joint_origins"][0, 1:, :3, 3] = [0.3, 0.0, 0.0]
    flat = jacobian_at(chain, np.zeros(n))
    broken = jacobian_at(made_up(n), some(n, 1)[0])
    broken[4, n - 1] = np.nan
    for jacobian in (flat, broken):
        rates = np.full(n, 7.0)
        assert not joint_velocity(jacobian, np.ones(6), 0.001, rates)
        assert not is_well_conditioned(jacobian, 0.001)
        assert np.array_equal(rates, np.zeros(n))


def arm_of(n: int) -> Arm:
    """A made-up chain with a capsule on every frame."""
    rng = np.random.default_rng(20 + n)
    chain, capsules = made_up(n), np.zeros(n + 2, CAPSULE)
    capsules["link_index"], capsules["radius_m"] = np.arange(n + 2), 0.05
    capsules["start_in_link"], capsules["end_in_link"] = rng.uniform(-0.1, 0.1, (2, n + 2, 3))
    return Arm(chain, capsules, chain_lengths(chain, capsules))


@pytest.mark.parametrize("n", COUNTS)
def test_no_joint_takes_a_capsule_farther_than_its_chain_is_long(n: int) -> None:
    arm, rng = arm_of(n), np.random.default_rng(n)
    placed = np.empty((2, n + 2, 2, 3))
    for joints in some(n, 50):
        joint, turn = rng.integers(n), rng.uniform(0.01, np.pi)
        turned = joints + turn * np.eye(n)[joint]
        for ends, at in zip(placed, (joints, turned), strict=True):
            place_capsules(arm.capsules, transforms_at(arm.chain, at), ends)
        moved = np.linalg.norm(placed[1] - placed[0], axis=-1)
        assert moved.max() <= 2.0 * np.sin(turn / 2.0) * arm.reach_m[joint] + 1e-12
        assert moved[joint + 1 :].max() > 0.0
        assert not moved[: joint + 1].any()


@pytest.mark.parametrize("n", COUNTS)
def test_nothing_comes_nearer_between_two_instants_than_the_bound(n: int) -> None:
    arm, rng = arm_of(n), np.random.default_rng(30 + n)
    room, placed = np.empty((MAX_BISECTIONS + 1, n + 2, 2, 3)), np.empty((n + 2, 2, 3))
    for first in some(n, 10):
        last = first + rng.uniform(-0.3, 0.3, n)
        hand, elbow = rng.uniform(-0.8, 0.8, (2, 3))
        found = []
        for t in np.linspace(0.0, 1.0, 201):
            place_capsules(arm.capsules, transforms_at(arm.chain, first + t * (last - first)), placed)
            found.append(hand_distance(arm.capsules, placed, hand, elbow, 0.06, 0.045)[0])
        hands = (hand, hand, elbow, elbow, 0.06, 0.045)
        bound, _, _, at_end = closest_approach_between(arm, room, first, last, *hands, 1e-4, np.inf)
        assert bound <= min(found)
        assert bound >= min(found) - 1e-4 - 2e-3  # which leaves room for what lies between the samples
        assert at_end == pytest.approx(found[-1], abs=1e-12)


@pytest.mark.parametrize("n", COUNTS)
def test_drives_of_any_number_of_joints_brake_to_a_standstill(n: int) -> None:
    drives, demanded, period_s = (
        drive(DEFAULTS, n),
        np.linspace(-0.4, 0.5, n),
        DEFAULTS.clock.control_period_s,
    )
    drive_tick(drives, demanded, False, 0.5, 0.0)
    assert np.array_equal(drives[0]["setpoint_radps"], demanded)
    for tick in range(1, 100):
        drive_tick(drives, np.ones(n), True, 0.5, tick * period_s)
    assert np.array_equal(np.abs(drives[0]["setpoint_radps"]), np.zeros(n))
