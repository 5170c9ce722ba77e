"""Inverse kinematics: the branches of a pose, the nearest one, and the straight ways of the TCP."""

from __future__ import annotations

from math import ceil, pi, sqrt

import numpy as np
from eaik.IK_HP import HPRobot
from numpy.typing import ArrayLike, NDArray

from safety_harness.compiled import compiled
from safety_harness.exceptions import ArmModelError
from safety_harness.geometry.arrays import Array3, Array4x4, Array6, Array6x6, Array8x4x4, ArrayNx6
from safety_harness.geometry.linear import copy_matrix, copy_vector, solve_in_place
from safety_harness.geometry.rotations import vector_from_rotation
from safety_harness.robot.description import ArmModel, ChainRecords
from safety_harness.robot.kinematics import (
    FRAMES,
    TCP,
    forward_kinematics,
    geometric_jacobian,
    is_well_conditioned,
)
from safety_harness.robot.wrist_singularity import AT_ONCE, wrist_branches

EXACT_POSE = 1e-9  # largest difference of a matrix entry (metres, or a direction cosine)
REACH_RESOLUTION_M = 1e-4
SAME_RAD = 1e-6  # of two ways to compute one branch near a singularity
MOST_STEPS = 4000  # of ``straight_way``


class InverseKinematics:
    """All closed-form solutions of one arm.

    The library eaik takes the joint axes H (6, 3) at q = 0 and the steps P (7, 3) between points
    on them, both in the base frame, as the URDF gives them; it answers for a tool frame that is
    parallel to the base at q = 0, so poses are turned by the tool's own zero rotation first.
    """

    def __init__(self, arm: ArmModel) -> None:
        self.arm = arm
        zero = np.empty((FRAMES, 4, 4))
        forward_kinematics(arm.chain[0], np.zeros(6), zero)
        axes = np.array([zero[i + 1, :3, :3] @ arm.joint_axes[i] for i in range(6)])
        points = zero[:, :3, 3]
        self._zero_rotation_inverse = zero[TCP, :3, :3].T.copy()
        self._axes, self._steps = axes, np.diff(points, axis=0)
        self._solver = HPRobot(self._axes, self._steps)
        if not self._solver.hasKnownDecomposition():
            raise ArmModelError(f"{arm.name}: its inverse kinematics has no closed form")

    def branches(self, transform_tcp_to_base: Array4x4) -> NDArray[np.float64]:
        """All joint positions (k, 6) [rad] of a pose, wrapped into (-pi, pi]; (0, 6) out of reach.

        Each is checked with our own forward kinematics to 1e-9 (metres, and entries of the rotation), which
        also drops the library's least-squares answers to unreachable poses.  Position limits are not
        considered.  At a wrist singularity (|sin theta_5| below 5e-10) joints can move while the TCP stays,
        and what is returned are some of those positions.  Up to 1e-4 the branches of ``wrist_branches`` stand
        before the library's, which loses some below 1e-5.  Where shoulder and elbow are singular at once, to
        some 1e-8 of the reach, and the wrist is not, a few per cent of the poses have no branch here.

        ``transform_tcp_to_base`` (4, 4).
        """
        pose = np.array(transform_tcp_to_base, dtype=np.float64)
        if not np.isfinite(pose).all():
            return np.empty((0, 6))
        turned = pose.copy()
        turned[:3, :3] = pose[:3, :3] @ self._zero_rotation_inverse
        theirs = np.array(self._solver.IK(turned).Q, dtype=np.float64).reshape(-1, 6)
        answers = _exact(self.arm.chain, pose, theirs)
        own = np.empty((AT_ONCE, 6))
        count = wrist_branches(self._axes, self._steps, turned[:3, :3].copy(), pose[:3, 3].copy(), own)
        if count == 0:
            return answers
        return _distinct(np.concatenate([_exact(self.arm.chain, pose, own[:count]), answers]))

    def nearest(
        self, transform_tcp_to_base: Array4x4, reference_joint_position: Array6
    ) -> NDArray[np.float64] | None:
        """The solution (6,) within the position limits that is nearest to a joint position (6,).

        Distance is Euclidean in joint angles; full turns of each joint are tried.  None when no
        solution is within the limits.

        ``transform_tcp_to_base`` (4, 4), ``reference_joint_position`` (6,).
        """
        branches = self.branches(transform_tcp_to_base)
        reference = np.array(reference_joint_position, dtype=np.float64)
        solution = np.empty(6)
        arm = self.arm
        found = _nearest(branches, reference, arm.position_lower_rad, arm.position_upper_rad, solution)
        return solution if found else None

    def reach_along(
        self,
        joint_position_rad: Array6,
        direction_in_base: ArrayLike,  # (3,)
        length_m: float,
        *,
        step_m: float = 0.005,
        min_singular_value: float,
    ) -> float:
        """How far (at most ``length_m``) the TCP can go straight along a direction, not turning.

        The joints follow continuously from ``joint_position_rad`` (6,), within the position
        limits and with every singular value of the Jacobian above ``min_singular_value``, which
        is looked at every ``step_m`` at least.  The answer is at most 0.1 mm short; it is 0 when
        the start itself is outside these bounds.  ``ValueError`` for a direction without length.
        """
        direction = np.array(direction_in_base, dtype=np.float64)
        length = float(np.linalg.norm(direction))
        if direction.shape != (3,) or not (0.0 < length < np.inf):
            raise ValueError(f"direction_in_base: expected a finite vector with a length, got {direction}")
        if not (step_m > 0.0 and min_singular_value > 0.0 and np.isfinite(length_m)):
            raise ValueError("step_m and min_singular_value must be positive and length_m finite")
        arm, start = self.arm, np.array(joint_position_rad, dtype=np.float64)
        limits_rad = arm.position_lower_rad, arm.position_upper_rad
        return _straight_reach(
            arm.chain, *limits_rad, start, direction / length, length_m, step_m, min_singular_value
        )


@compiled
def _exact(chains: ChainRecords, pose: Array4x4, answers: ArrayNx6) -> ArrayNx6:
    """Those of ``answers``, which are overwritten, that give ``pose``, wrapped into (-pi, pi].

    Those with max |T_7(q) - pose| <= EXACT_POSE over all entries.
    """
    transforms = np.empty((FRAMES, 4, 4))
    kept = 0
    for k in range(answers.shape[0]):
        for i in range(6):
            answers[kept, i] = pi - np.mod(pi - answers[k, i], 2.0 * pi)
        forward_kinematics(chains[0], answers[kept], transforms)
        exact = True
        for i in range(4):
            for j in range(4):
                exact = exact and abs(transforms[TCP, i, j] - pose[i, j]) <= EXACT_POSE
        kept += exact
    return answers[:kept]


def _distinct(answers: NDArray[np.float64]) -> NDArray[np.float64]:
    """The first of those (k, 6) that are the same but for rounding, whole turns aside."""
    apart = np.abs((answers[:, None] - answers + pi) % (2.0 * pi) - pi).max(axis=2)
    kept: NDArray[np.float64] = answers[~np.any(np.tril(apart < SAME_RAD, -1), axis=1)]
    return kept


@compiled
def _nearest(
    branches: ArrayNx6, reference: Array6, lower_rad: Array6, upper_rad: Array6, solution_out: Array6
) -> bool:
    """Fill the nearest of the branches and their full turns within the limits; False if there is none.

    argmin over branches q and turns k of |q + 2 pi k - reference|, joint by joint in [lower, upper].
    """
    candidate = np.empty(6)
    best = np.inf
    for k in range(branches.shape[0]):
        total = 0.0
        for i in range(6):
            least = np.inf
            for turn in range(-2, 3):
                angle = branches[k, i] + turn * (2.0 * pi)
                away = abs(angle - reference[i])
                if lower_rad[i] <= angle <= upper_rad[i] and away < least:
                    candidate[i], least = angle, away
            total += least * least
        distance = np.sqrt(total)
        if distance < best:
            best = distance
            copy_vector(candidate, solution_out)
    return bool(best < np.inf)


@compiled
def _straight_reach(
    chains: ChainRecords,
    lower_rad: Array6,
    upper_rad: Array6,
    start_rad: Array6,
    direction: Array3,  # of length 1
    length_m: float,
    step_m: float,
    min_singular_value: float,
) -> float:
    """How far [m] the TCP follows p + s d, its orientation kept, from the joints ``start_rad``.

    In steps of s: halved at each failure of ``follow_pose`` or ``_acceptable``, doubled at each success.
    """
    transforms = np.empty((8, 4, 4))
    jacobian = np.empty((6, 6))
    forward_kinematics(chains[0], start_rad, transforms)
    geometric_jacobian(chains[0].joint_axes, transforms, jacobian)
    if not _acceptable(start_rad, lower_rad, upper_rad, jacobian, min_singular_value):
        return 0.0
    start_pose = transforms[7].copy()
    target = start_pose.copy()
    joints = start_rad.copy()
    trial = np.empty(6)
    reached = 0.0
    step = step_m
    while reached < length_m:
        forward = min(step, length_m - reached)
        for i in range(3):
            target[i, 3] = start_pose[i, 3] + (reached + forward) * direction[i]
        copy_vector(joints, trial)
        follows = follow_pose(chains, target, trial, transforms, jacobian)
        if follows and _acceptable(trial, lower_rad, upper_rad, jacobian, min_singular_value):
            copy_vector(trial, joints)
            reached += forward
            step = min(2.0 * step, step_m)
        elif forward <= REACH_RESOLUTION_M:
            break
        else:
            step = 0.5 * forward
    return float(min(reached, length_m))


@compiled
def _acceptable(
    joints: Array6, lower_rad: Array6, upper_rad: Array6, jacobian: Array6x6, min_singular_value: float
) -> bool:
    """Are joints (6,) within their limits, and all singular values of their Jacobian large enough?"""
    for i in range(6):
        if not (lower_rad[i] <= joints[i] <= upper_rad[i]):
            return False
    return is_well_conditioned(jacobian, min_singular_value)


@compiled
def follow_pose(
    chains: ChainRecords, target: Array4x4, joints: Array6, transforms: Array8x4x4, jacobian: Array6x6
) -> bool:
    """Newton's method from ``joints`` (overwritten) to the pose ``target`` on the same branch.

    J dq = (p* - p, log(R* R^T)), q <- q + dq, with the pose (R, p) at q and (R*, p*) wanted, both in the base
    frame [m], and log a rotation's vector [rad].  (Lynch and Park, Modern Robotics, 2017, 6.2.)  The first
    Newton step predicts; the later ones together may only correct it by half of its own size, else the
    prediction was no good and the solution may be another branch's.  ``transforms`` and
    ``jacobian`` are written; on success they are those of the solution.
    """
    step = np.empty(6)
    error_rotation = np.empty((3, 3))
    matrix = np.empty((6, 6))
    predicted = 0.0
    corrected = 0.0
    for iteration in range(8):
        forward_kinematics(chains[0], joints, transforms)
        geometric_jacobian(chains[0].joint_axes, transforms, jacobian)
        reached = transforms[7]
        for i in range(3):
            step[i] = target[i, 3] - reached[i, 3]
            for j in range(3):
                error_rotation[i, j] = (
                    target[i, 0] * reached[j, 0] + target[i, 1] * reached[j, 1] + target[i, 2] * reached[j, 2]
                )
        copy_vector(vector_from_rotation(error_rotation), step[3:])
        largest = 0.0
        for i in range(6):
            largest = max(largest, abs(step[i]))
        if iteration > 0 and largest < 1e-10:
            return True
        copy_matrix(jacobian, matrix)
        if not solve_in_place(matrix, step):
            return False
        size = 0.0
        for i in range(6):
            joints[i] += step[i]
            size = max(size, abs(step[i]))
        if iteration == 0:
            predicted = size
        else:
            corrected += size
            if not corrected <= 0.5 * predicted:
                return False
    return False


def straight_way(
    arm: ArmModel, joint_position_rad: Array6, position_in_base_m: Array3, *, step_m: float
) -> NDArray[np.float64]:
    """(k, 6) joints from ``joint_position_rad`` (6,) straight to ``position_in_base_m`` (3,), k >= 1.

    Neighbouring rows are at most ``step_m`` of way apart (more on a way of over 4000 steps).  The rows
    end where the arm cannot follow continuously; position limits and singularities are not looked at.
    """
    start, end = (np.array(given, dtype=np.float64) for given in (joint_position_rad, position_in_base_m))
    return _straight_way(arm.chain, start, end, step_m)


@compiled
def _straight_way(chains: ChainRecords, start_rad: Array6, end_in_base_m: Array3, step_m: float) -> ArrayNx6:
    """(k, 6) joints at p + i/n (p* - p), i = 0 to n, as far as ``follow_pose`` can follow."""
    transforms, jacobian = np.empty((8, 4, 4)), np.empty((6, 6))
    forward_kinematics(chains[0], start_rad, transforms)
    start_pose = transforms[7].copy()
    target, joints = start_pose.copy(), start_rad.copy()
    squared = 0.0
    for i in range(3):
        squared += (end_in_base_m[i] - start_pose[i, 3]) ** 2
    steps = int(min(ceil(sqrt(squared) / step_m), MOST_STEPS))
    rows = np.empty((steps + 1, 6))
    copy_vector(start_rad, rows[0])
    for k in range(1, steps + 1):
        for i in range(3):
            target[i, 3] = start_pose[i, 3] + k / steps * (end_in_base_m[i] - start_pose[i, 3])
        if not follow_pose(chains, target, joints, transforms, jacobian):
            return rows[:k].copy()
        copy_vector(joints, rows[k])
    return rows
