"""Inverse kinematics: the branches of a pose, the nearest one, and the straight ways of the TCP."""

from __future__ import annotations

from math import ceil, pi, sqrt

import numpy as np
from numpy.typing import ArrayLike, NDArray

from safety_harness.base.compiled import compiled
from safety_harness.base.geometry.arrays import Array3, Array4x4, Array6, Array6x6, ArrayNx4x4, ArrayNx6
from safety_harness.base.geometry.linear import copy_matrix, copy_vector, solve_in_place
from safety_harness.cell.robot.closed_form import (
    AT_ONCE,
    ArmGeometryRecords,
    arm_geometry,
    candidate_branches,
    has_closed_form,
)
from safety_harness.cell.robot.description import ArmModel, ChainRecords
from safety_harness.cell.robot.kinematics import (
    FRAMES,
    TCP,
    forward_kinematics,
    geometric_jacobian,
    is_well_conditioned,
)
from safety_harness.cell.robot.numeric_inverse import (
    EXACT_POSE,
    all_found,
    is_among,
    least_step,
    nearest_found,
    pose_error,
    starts_of,
    wrapped_rad,
)

MENDED_POSE = 1e-6  # by which a branch may miss its pose to be polished
MOST_POLISHING = 4  # steps
POLISH_DAMPING = 1e-6  # where the arm is singular, directions below this are left alone
REACH_RESOLUTION_M = 1e-4
MOST_STEPS = 4000  # of ``straight_way``


class InverseKinematics:
    """Joint positions of poses, in closed form where the arm's wrist is that of the UR family, else numeric.

    An arm of more than six joints can take a pose in infinitely many ways, one of fewer only some poses.
    """

    def __init__(self, arm: ArmModel) -> None:
        self.arm = arm
        self._geometry = arm_geometry(arm) if has_closed_form(arm) else None
        self._starts = starts_of(arm)

    def branches(self, transform_tcp_to_base: Array4x4) -> NDArray[np.float64]:
        """All joint positions (k, n) [rad] of a pose, wrapped into (-pi, pi]; (0, n) out of reach.

        Each is checked with forward kinematics to 1e-9 (metres, and entries of the rotation).  Two shoulders,
        two wrists and two elbows, in the order of ``candidate_branches``; those that are less than 1e-6
        apart, as at a singularity, are one.  Position limits are not considered.  At a wrist singularity
        (|sin theta_5| below 5e-10) joints can move while the TCP stays, and what is returned are some of
        those positions.  Numeric ones are those that 200 starts led to, of more than six joints some of
        infinitely many.

        ``transform_tcp_to_base`` (4, 4).
        """
        pose = np.array(transform_tcp_to_base, dtype=np.float64)
        if self._geometry is None:
            return all_found(self.arm.chain, self._starts, pose)
        return _branches(self.arm.chain, self._geometry, pose)

    def nearest(
        self, transform_tcp_to_base: Array4x4, reference_joint_position: Array6
    ) -> NDArray[np.float64] | None:
        """The solution (n,) within the position limits that is nearest to a joint position (n,).

        Distance is Euclidean in joint angles; full turns of each joint are tried.  None when no
        solution is within the limits.  Numeric: the nearest of those that were found, each carried along its
        self-motion to where its distance is least; one within 0.5 rad ends the search.

        ``transform_tcp_to_base`` (4, 4), ``reference_joint_position`` (n,).
        """
        (solution,) = self.nearest_of_each(np.array([transform_tcp_to_base]), reference_joint_position)
        return None if np.isnan(solution[0]) else solution

    def nearest_of_each(
        self,
        transforms_tcp_to_base: NDArray[np.float64],  # (m, 4, 4)
        reference_joint_position: Array6,
    ) -> NDArray[np.float64]:
        """``nearest`` of many poses (m, 4, 4): (m, n), NaN where no solution is within the limits.

        ``reference_joint_position`` (n,).
        """
        poses = np.array(transforms_tcp_to_base, dtype=np.float64)
        reference = np.array(reference_joint_position, dtype=np.float64)
        if self._geometry is None:
            limits_rad = self.arm.position_lower_rad, self.arm.position_upper_rad
            return nearest_found(self.arm.chain, *limits_rad, self._starts, poses, reference)
        return _nearest_of_each(self.arm.chain, self._geometry, poses, reference)

    def followed(
        self,
        transforms_tcp_to_base: NDArray[np.float64],  # (m, 4, 4)
        joint_position_rad: Array6,
    ) -> NDArray[np.float64]:
        """``nearest`` of poses (m, 4, 4) in turn, each to that of the one before: (m, n).

        NaN from the first on that has none within the limits.
        ``joint_position_rad`` (n,): what the first is nearest to.
        """
        poses, joints = np.array(transforms_tcp_to_base), np.array(joint_position_rad)
        if self._geometry is not None:
            return _followed(self.arm.chain, self._geometry, poses, joints)
        found = np.full((len(poses), len(joints)), np.nan)
        for k, pose in enumerate(poses):
            (joints,) = found[k : k + 1] = self.nearest_of_each(pose[None], joints)
            if np.isnan(joints[0]):
                break
        return found

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

        The joints follow continuously from ``joint_position_rad`` (n,), more than six with the least steps,
        within the position limits and with every singular value of the Jacobian above
        ``min_singular_value``, which is looked at every ``step_m`` at least.  The answer is at most 0.1 mm
        short; it is 0 when the start itself is outside these bounds.  ``ValueError`` for a direction without
        length.
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
def _branches(chains: ChainRecords, geometries: ArmGeometryRecords, pose: Array4x4) -> ArrayNx6:
    """The candidates that give ``pose``, those that are the same but for rounding once."""
    found, transforms = np.empty((AT_ONCE, 6)), np.empty((FRAMES, 4, 4))
    kept = 0
    for k in range(candidate_branches(geometries[0], pose, found)):
        copy_vector(found[k], found[kept])
        if _gives(chains, pose, found[kept], transforms):
            kept += not is_among(found[kept], found[:kept])
    return found[:kept].copy()


@compiled
def _gives(chains: ChainRecords, pose: Array4x4, joints: Array6, transforms: ArrayNx4x4) -> bool:
    """Whether ``joints`` (6,), wrapped and if need be polished, give ``pose`` to EXACT_POSE in every entry.

    Near a singularity rounding of the pose moves joints by its root: the steps of ``_polish`` mend that.
    ``transforms`` are written.
    """
    for _ in range(MOST_POLISHING):
        exact = nearly = True
        for i in range(6):
            joints[i] = wrapped_rad(joints[i])
        forward_kinematics(chains[0], joints, transforms)
        for i in range(4):
            for j in range(4):
                off = abs(transforms[TCP, i, j] - pose[i, j])
                exact, nearly = exact and off <= EXACT_POSE, nearly and off <= MENDED_POSE
        if exact or not nearly or not _polish(chains, pose, joints, transforms):
            return exact
    return False


@compiled
def _polish(chains: ChainRecords, pose: Array4x4, joints: Array6, transforms: ArrayNx4x4) -> bool:
    """A damped Newton step of ``joints`` towards ``pose``: (J^T J + d^2 I) dq = J^T e.

    e = (p* - p, log(R* R^T)) as in ``follow_pose``; ``transforms`` are those of ``joints``.
    """
    jacobian, matrix = np.empty((6, 6)), np.empty((6, 6))
    error, step = np.empty(6), np.empty(6)
    geometric_jacobian(chains[0].joint_axes, transforms, jacobian)
    pose_error(pose, transforms[TCP], error)
    for i in range(6):
        step[i] = 0.0
        for k in range(6):
            step[i] += jacobian[k, i] * error[k]
        for j in range(6):
            matrix[i, j] = POLISH_DAMPING * POLISH_DAMPING if i == j else 0.0
            for k in range(6):
                matrix[i, j] += jacobian[k, i] * jacobian[k, j]
    if not solve_in_place(matrix, step):
        return False
    for i in range(6):
        joints[i] += step[i]
    return True


@compiled
def _nearest_of_each(
    chains: ChainRecords,
    geometries: ArmGeometryRecords,
    poses: NDArray[np.float64],  # (n, 4, 4)
    reference: Array6,
) -> ArrayNx6:
    """(n, 6): of the branches of each pose and their full turns within the limits the nearest, or NaN.

    argmin over branches q and turns k of |q + 2 pi k - reference|, joint by joint in [lower, upper].
    """
    solutions = np.full((poses.shape[0], 6), np.nan)
    found, transforms, turned = np.empty((AT_ONCE, 6)), np.empty((FRAMES, 4, 4)), np.empty(6)
    for n in range(poses.shape[0]):
        _nearest(chains, geometries, poses[n], reference, found, transforms, turned, solutions[n])
    return solutions


@compiled
def _followed(
    chains: ChainRecords,
    geometries: ArmGeometryRecords,
    poses: NDArray[np.float64],  # (n, 4, 4)
    reference: Array6,
) -> ArrayNx6:
    """(n, 6): the nearest of the first pose to ``reference``, of each other to the one before it, or NaN."""
    solutions = np.full((poses.shape[0], 6), np.nan)
    found, transforms, turned = np.empty((AT_ONCE, 6)), np.empty((FRAMES, 4, 4)), np.empty(6)
    joints = reference.copy()
    for n in range(poses.shape[0]):
        if not _nearest(chains, geometries, poses[n], joints, found, transforms, turned, solutions[n]):
            break
        copy_vector(solutions[n], joints)
    return solutions


@compiled
def _nearest(
    chains: ChainRecords,
    geometries: ArmGeometryRecords,
    pose: Array4x4,
    reference: Array6,
    found: ArrayNx6,  # these three to work with
    transforms: ArrayNx4x4,
    turned: Array6,
    solution: Array6,  # written, if there is one
) -> bool:
    """One of ``_nearest_of_each``; False without a solution."""
    best = np.inf
    for k in range(candidate_branches(geometries[0], pose, found)):
        # first how near it is, then, which takes longer, whether it gives the pose
        if not _turned_towards(geometries, reference, found[k], turned) < best:
            continue
        if _gives(chains, pose, found[k], transforms):
            distance = _turned_towards(geometries, reference, found[k], turned)
            if distance < best:
                best = distance
                copy_vector(turned, solution)
    return best < np.inf


@compiled
def _turned_towards(geometries: ArmGeometryRecords, reference: Array6, joints: Array6, out: Array6) -> float:
    """Fill ``out`` with those full turns of ``joints`` that are nearest to ``reference`` within the limits.

    Returns how far that is [rad], infinity if a joint has none.
    """
    total = 0.0
    for i in range(6):
        least, wrapped = np.inf, wrapped_rad(joints[i])
        for turn in range(-2, 3):
            angle = wrapped + turn * (2.0 * pi)
            away = abs(angle - reference[i])
            if geometries[0].lower_rad[i] <= angle <= geometries[0].upper_rad[i] and away < least:
                out[i], least = angle, away
        total += least * least
    return sqrt(total)


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
    n = start_rad.shape[0]
    transforms = np.empty((n + 2, 4, 4))
    jacobian = np.empty((6, n))
    forward_kinematics(chains[0], start_rad, transforms)
    geometric_jacobian(chains[0].joint_axes, transforms, jacobian)
    if not _acceptable(start_rad, lower_rad, upper_rad, jacobian, min_singular_value):
        return 0.0
    start_pose = transforms[n + 1].copy()
    target = start_pose.copy()
    joints = start_rad.copy()
    trial = np.empty(n)
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
    """Are joints (n,) within their limits, and all singular values of their Jacobian large enough?"""
    for i in range(joints.shape[0]):
        if not (lower_rad[i] <= joints[i] <= upper_rad[i]):
            return False
    return is_well_conditioned(jacobian, min_singular_value)


@compiled
def follow_pose(
    chains: ChainRecords, target: Array4x4, joints: Array6, transforms: ArrayNx4x4, jacobian: Array6x6
) -> bool:
    """Newton's method from ``joints`` (overwritten) to the pose ``target`` on the same branch.

    J dq = (p* - p, log(R* R^T)), q <- q + dq, with the pose (R, p) at q and (R*, p*) wanted, both in the base
    frame [m], and log a rotation's vector [rad].  (Lynch and Park, Modern Robotics, 2017, 6.2.)  The first
    Newton step predicts; the later ones together may only correct it by half of its own size, else the
    prediction was no good and the solution may be another branch's.  Of more than six joints dq is the least
    one, J^T (J J^T)^-1 e; fewer do not follow.  ``transforms`` and ``jacobian`` are written; on success they
    are those of the solution.
    """
    n = joints.shape[0]
    step, twist = np.empty(n), np.empty(6)
    matrix = np.empty((6, 6))
    predicted = 0.0
    corrected = 0.0
    for iteration in range(8):
        forward_kinematics(chains[0], joints, transforms)
        geometric_jacobian(chains[0].joint_axes, transforms, jacobian)
        pose_error(target, transforms[n + 1], twist)
        largest = 0.0
        for i in range(6):
            largest = max(largest, abs(twist[i]))
        if iteration > 0 and largest < 1e-10:
            return True
        if n == 6:
            copy_vector(twist, step)
            copy_matrix(jacobian, matrix)
            if not solve_in_place(matrix, step):
                return False
        elif not least_step(jacobian, twist, matrix, step):
            return False
        size = 0.0
        for i in range(n):
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
    """(k, n) joints from ``joint_position_rad`` (n,) straight to ``position_in_base_m`` (3,), k >= 1.

    Neighbouring rows are at most ``step_m`` of way apart (more on a way of over 4000 steps).  The rows
    end where the arm cannot follow continuously; position limits and singularities are not looked at.
    """
    start, end = (np.array(given, dtype=np.float64) for given in (joint_position_rad, position_in_base_m))
    return _straight_way(arm.chain, start, end, step_m)


@compiled
def _straight_way(chains: ChainRecords, start_rad: Array6, end_in_base_m: Array3, step_m: float) -> ArrayNx6:
    """(k, joints) at p + i/n (p* - p), i = 0 to n, as far as ``follow_pose`` can follow."""
    joint_count = start_rad.shape[0]
    transforms, jacobian = np.empty((joint_count + 2, 4, 4)), np.empty((6, joint_count))
    forward_kinematics(chains[0], start_rad, transforms)
    start_pose = transforms[joint_count + 1].copy()
    target, joints = start_pose.copy(), start_rad.copy()
    squared = 0.0
    for i in range(3):
        squared += (end_in_base_m[i] - start_pose[i, 3]) ** 2
    steps = int(min(ceil(sqrt(squared) / step_m), MOST_STEPS))
    rows = np.empty((steps + 1, joint_count))
    copy_vector(start_rad, rows[0])
    for k in range(1, steps + 1):
        for i in range(3):
            target[i, 3] = start_pose[i, 3] + k / steps * (end_in_base_m[i] - start_pose[i, 3])
        if not follow_pose(chains, target, joints, transforms, jacobian):
            return rows[:k].copy()
        copy_vector(joints, rows[k])
    return rows
