"""Find the joint positions of a pose, the position nearest to a reference, and straight paths of the TCP."""

from __future__ import annotations

from math import ceil, pi, sqrt

import numpy as np
from numpy.typing import ArrayLike, NDArray

from safety_harness.base.compiled import compiled
from safety_harness.base.elementary import length
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

MENDED_POSE = 1e-6  # the largest error of a branch's pose that is polished
MOST_POLISHING = 4  # steps
POLISH_DAMPING = 1e-6  # steps do not use the directions of smaller singular values
# ``reach_along`` may fall short by this. Claims that judge a reach allow for it
# (claims/properties/positions).
REACH_RESOLUTION_M = 1e-4
MOST_STEPS = 4000  # of ``straight_way``


class InverseKinematics:
    """A solver for the inverse kinematics of an arm.

    The solver uses a closed form for the wrist of the UR family, and a numeric method for other arms. An arm
    with more than six joints has infinitely many joint positions for a pose. An arm with fewer than six
    joints can take only some poses.
    """

    def __init__(self, arm: ArmModel) -> None:
        self.arm = arm
        self._geometry = arm_geometry(arm) if has_closed_form(arm) else None
        self._starts = starts_of(arm)

    def branches(self, transform_tcp_to_base: Array4x4) -> NDArray[np.float64]:
        """Return all joint positions of a pose, wrapped into (-pi, pi], shape (k, n) [rad].

        If the pose is out of reach, k is 0. The method checks each position by forward kinematics. The
        tolerance is 1e-9, both for positions in metres and for the entries of the rotation matrix. The closed
        form gives two shoulders, two wrists and two elbows, in the order of ``candidate_branches``. Positions
        less than 1e-6 rad apart count as the same, for example at a singularity. The method ignores position
        limits. At a wrist singularity (|sin theta_5| below 5e-10) joints can move while the TCP stays. The
        result then contains only some of the possible positions. The numeric inverse returns the positions
        that it finds from 200 starts. An arm with more than six joints has infinitely many positions, so
        these are only some of them.

        Args:
            transform_tcp_to_base: The pose (4, 4).

        """
        pose = np.array(transform_tcp_to_base, dtype=np.float64)
        if self._geometry is None:
            return all_found(self.arm.chain, self._starts, pose)
        return _branches(self.arm.chain, self._geometry, pose)

    def nearest(
        self, transform_tcp_to_base: Array4x4, reference_joint_position: Array6
    ) -> NDArray[np.float64] | None:
        """Return the joint position (n,) of a pose that is nearest to a reference.

        Return None if there is no solution. The solution is within the position limits. The distance is
        Euclidean in joint angles. The method also tries full turns of each joint. The numeric inverse moves
        each solution along its self-motion to the least distance. The numeric inverse first searches from the
        reference itself, and stops if it finds a solution within 0.5 rad.

        Args:
            transform_tcp_to_base: The pose (4, 4).
            reference_joint_position: The reference (n,).

        """
        (solution,) = self.nearest_of_each(np.array([transform_tcp_to_base]), reference_joint_position)
        return None if np.isnan(solution[0]) else solution

    def nearest_of_each(
        self,
        transforms_tcp_to_base: NDArray[np.float64],  # (m, 4, 4)
        reference_joint_position: Array6,
    ) -> NDArray[np.float64]:
        """Return the result of ``nearest`` for each of many poses, shape (m, n).

        A pose without a solution within the limits gives NaN.

        Args:
            transforms_tcp_to_base: The poses (m, 4, 4).
            reference_joint_position: The joint position (n,) to which each solution is nearest.

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
        """Return a solution for each pose, as near as possible to the previous solution, shape (m, n).

        If a pose has no solution within the limits, its row and all later rows are NaN.

        Args:
            transforms_tcp_to_base: The poses (m, 4, 4).
            joint_position_rad: The joint position (n,) from which the first solution has the least distance.

        """
        poses, joints = np.array(transforms_tcp_to_base), np.array(joint_position_rad)
        if self._geometry is not None:
            return _followed(self.arm.chain, self._geometry, poses, joints)
        solutions = np.full((len(poses), len(joints)), np.nan)
        for k, pose in enumerate(poses):
            (joints,) = solutions[k : k + 1] = self.nearest_of_each(pose[None], joints)
            if np.isnan(joints[0]):
                break
        return solutions

    def reach_along(
        self,
        joint_position_rad: Array6,
        direction_in_base: ArrayLike,  # (3,)
        length_m: float,
        *,
        step_m: float = 0.005,
        min_singular_value: float,
    ) -> float:
        """Return how far [m] the TCP can move straight along a direction without a rotation.

        The result is at most ``length_m``. On this path the joints move continuously within the position
        limits. Every singular value of the Jacobian stays above ``min_singular_value``. An arm with more than
        six joints makes the shortest joint steps. The result is at most 0.1 mm too short. The result is 0 if
        the start itself violates these bounds.

        Args:
            joint_position_rad: The start (n,).
            direction_in_base: The direction (3,), of any length above 0.
            length_m: The largest possible result [m]. The method ends when the path has this length.
            step_m: The longest distance between two checks.
            min_singular_value: The lower bound of the singular values, greater than 0.

        Raises:
            ValueError: The direction has no length, or a number is not valid.

        """
        direction = np.array(direction_in_base, dtype=np.float64)
        size = length(direction)
        if direction.shape != (3,) or not (0.0 < size < np.inf):
            raise ValueError(f"direction_in_base: expected a finite vector with a length, got {direction}")
        if not (step_m > 0.0 and min_singular_value > 0.0 and np.isfinite(length_m)):
            raise ValueError("step_m and min_singular_value must be positive and length_m finite")
        arm, start = self.arm, np.array(joint_position_rad, dtype=np.float64)
        limits_rad = arm.position_lower_rad, arm.position_upper_rad
        return _straight_reach(
            arm.chain, *limits_rad, start, direction / size, length_m, step_m, min_singular_value
        )


@compiled
def _branches(chains: ChainRecords, geometries: ArmGeometryRecords, pose: Array4x4) -> ArrayNx6:
    """Return the candidates (k, 6) that give ``pose`` (4, 4).

    Candidates that agree up to rounding appear only once.
    """
    candidates, transforms = np.empty((AT_ONCE, 6)), np.empty((FRAMES, 4, 4))
    kept = 0
    for k in range(candidate_branches(geometries[0], pose, candidates)):
        copy_vector(candidates[k], candidates[kept])
        if _gives(chains, pose, candidates[kept], transforms):
            kept += not is_among(candidates[kept], candidates[:kept])
    return candidates[:kept].copy()


@compiled
def _gives(chains: ChainRecords, pose: Array4x4, joints: Array6, transforms: ArrayNx4x4) -> bool:
    """Wrap and polish ``joints`` (6,), and return whether they give ``pose``.

    Every entry of the pose must agree to EXACT_POSE. Near a singularity, a rounding error e of the pose
    changes the joints by about the square root of e. Steps of ``_polish`` correct this error. The function
    overwrites ``joints`` and ``transforms``.
    """
    for _ in range(MOST_POLISHING):
        exact = nearly = True
        for i in range(6):
            joints[i] = wrapped_rad(joints[i])
        forward_kinematics(chains[0], joints, transforms)
        for i in range(4):
            for j in range(4):
                difference = abs(transforms[TCP, i, j] - pose[i, j])
                exact, nearly = exact and difference <= EXACT_POSE, nearly and difference <= MENDED_POSE
        if exact or not nearly or not _polish(chains, pose, joints, transforms):
            return exact
    return False


@compiled
def _polish(chains: ChainRecords, pose: Array4x4, joints: Array6, transforms: ArrayNx4x4) -> bool:
    """Move ``joints`` by a damped Newton step towards ``pose``: (J^T J + d^2 I) dq = J^T e.

    Here J is the Jacobian, d is POLISH_DAMPING, and e = (p* - p, log(R* R^T)) is the same as in
    ``follow_pose``. ``transforms`` must be the transforms at ``joints``. Return False if the equation has no
    solution.
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
    """Return the branch within the limits that is nearest to ``reference`` for each pose, shape (n, 6).

    This branch minimises |q + 2 pi k - reference| over all branches q and all full turns k of the joints. A
    pose without a solution gives NaN.
    """
    solutions = np.full((poses.shape[0], 6), np.nan)
    candidates, transforms, turned = np.empty((AT_ONCE, 6)), np.empty((FRAMES, 4, 4)), np.empty(6)
    for n in range(poses.shape[0]):
        _nearest(chains, geometries, poses[n], reference, candidates, transforms, turned, solutions[n])
    return solutions


@compiled
def _followed(
    chains: ChainRecords,
    geometries: ArmGeometryRecords,
    poses: NDArray[np.float64],  # (n, 4, 4)
    reference: Array6,
) -> ArrayNx6:
    """Return a solution for each pose, as near as possible to the previous solution, shape (n, 6).

    If a pose has no solution, its row and all later rows are NaN. The first solution is as near as possible
    to ``reference``.
    """
    solutions = np.full((poses.shape[0], 6), np.nan)
    candidates, transforms, turned = np.empty((AT_ONCE, 6)), np.empty((FRAMES, 4, 4)), np.empty(6)
    joints = reference.copy()
    for n in range(poses.shape[0]):
        if not _nearest(chains, geometries, poses[n], joints, candidates, transforms, turned, solutions[n]):
            break
        copy_vector(solutions[n], joints)
    return solutions


@compiled
def _nearest(
    chains: ChainRecords,
    geometries: ArmGeometryRecords,
    pose: Array4x4,
    reference: Array6,
    candidates: ArrayNx6,  # overwritten, like the next two
    transforms: ArrayNx4x4,
    turned: Array6,
    solution: Array6,  # written, if there is one
) -> bool:
    """Fill ``solution`` for a single pose, as ``_nearest_of_each`` does for many poses.

    Return whether there is a solution.
    """
    best = np.inf
    for k in range(candidate_branches(geometries[0], pose, candidates)):
        # The distance first: the check of the pose takes longer.
        if not _turned_towards(geometries, reference, candidates[k], turned) < best:
            continue
        if _gives(chains, pose, candidates[k], transforms):
            distance = _turned_towards(geometries, reference, candidates[k], turned)
            if distance < best:
                best = distance
                copy_vector(turned, solution)
    return best < np.inf


@compiled
def _turned_towards(geometries: ArmGeometryRecords, reference: Array6, joints: Array6, out: Array6) -> float:
    """Fill ``out`` with ``joints`` plus full turns, as near to ``reference`` as the position limits allow.

    Return the distance [rad] from ``reference``, or infinity if a joint has no equivalent angle within its
    limits.
    """
    total = 0.0
    for i in range(6):
        least, wrapped = np.inf, wrapped_rad(joints[i])
        # Enough for limits of up to two and a half turns to either side; a UR's are one turn.
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
    """Return how far [m] the TCP can move along p + s d with constant orientation.

    The joints start at ``start_rad``, where the TCP is at p. The vector d is ``direction``, whose length is
    1. The function halves the step of s if ``follow_pose`` or ``_acceptable`` fails, and doubles it after a
    success.
    """
    n = start_rad.shape[0]
    transforms = np.empty((n + 2, 4, 4))
    jacobian = np.empty((6, n))
    forward_kinematics(chains[0], start_rad, transforms)
    geometric_jacobian(chains[0].joint_axes, transforms, jacobian)
    # A start beyond the bounds has no reach, even if the first step would lead back.
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
        # The boundary is within the resolution: bisect no further.
        elif forward <= REACH_RESOLUTION_M:
            break
        else:
            step = 0.5 * forward
    return float(min(reached, length_m))


@compiled
def _acceptable(
    joints: Array6, lower_rad: Array6, upper_rad: Array6, jacobian: Array6x6, min_singular_value: float
) -> bool:
    """Return whether ``joints`` (n,) are within their limits and the singular values are above the bound."""
    for i in range(joints.shape[0]):
        if not (lower_rad[i] <= joints[i] <= upper_rad[i]):
            return False
    return is_well_conditioned(jacobian, min_singular_value)


@compiled
def follow_pose(
    chains: ChainRecords, target: Array4x4, joints: Array6, transforms: ArrayNx4x4, jacobian: Array6x6
) -> bool:
    """Move ``joints`` to the pose ``target`` on the same branch, by Newton's method.

    The function overwrites ``joints``. Let (R, p) be the pose at the joints q, and let (R*, p*) be the
    target. Both poses are in the base frame [m]. A step solves J dq = e for dq and replaces q by q + dq. Here
    e = (p* - p, log(R* R^T)), in which log gives a rotation vector [rad]. Lynch and Park describe the method
    (Modern Robotics, 2017, section 6.2). The first step is a prediction. All later steps in total may correct
    the first step by at most half of its size. Otherwise the prediction was poor, and the solution may belong
    to another branch. The function then returns False. For more than six joints, dq is the shortest step, J^T
    (J J^T)^-1 e. An arm with fewer than six joints cannot follow. The function writes ``transforms`` and
    ``jacobian``. On success, ``transforms`` and ``jacobian`` belong to the solution.
    """
    n = joints.shape[0]
    step, twist = np.empty(n), np.empty(6)
    matrix = np.empty((6, 6))
    predicted = 0.0
    corrected = 0.0
    # Newton's method converges quadratically, so more steps mean that it does not converge.
    for iteration in range(8):
        forward_kinematics(chains[0], joints, transforms)
        geometric_jacobian(chains[0].joint_axes, transforms, jacobian)
        pose_error(target, transforms[n + 1], twist)
        largest = 0.0
        for i in range(6):
            largest = max(largest, abs(twist[i]))
        # Below EXACT_POSE, so a followed pose also passes the check of the closed form.
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
    """Return joint positions along a straight path of the TCP with constant orientation, shape (k, n).

    The TCP moves at most ``step_m`` between two rows. If the path would then need over 4000 steps, the steps
    are longer. The rows end where the arm cannot follow continuously, and there is at least one row. The
    function ignores position limits and singularities.

    Args:
        arm: The arm.
        joint_position_rad: The start (n,).
        position_in_base_m: The end of the path (3,).
        step_m: The largest distance of the TCP between neighbouring rows.

    """
    start, end = (np.array(given, dtype=np.float64) for given in (joint_position_rad, position_in_base_m))
    return _straight_way(arm.chain, start, end, step_m)


@compiled
def _straight_way(chains: ChainRecords, start_rad: Array6, end_in_base_m: Array3, step_m: float) -> ArrayNx6:
    """Return joint positions (k, n) with the TCP at p + i/m (p* - p), for i from 0 to m.

    The rows end where ``follow_pose`` fails.
    """
    joint_count = start_rad.shape[0]
    transforms, jacobian = np.empty((joint_count + 2, 4, 4)), np.empty((6, joint_count))
    forward_kinematics(chains[0], start_rad, transforms)
    start_pose = transforms[joint_count + 1].copy()
    target, joints = start_pose.copy(), start_rad.copy()
    squared = 0.0
    for i in range(3):
        squared += (end_in_base_m[i] - start_pose[i, 3]) ** 2
    # A far target gets longer steps, so that it cannot exhaust time and memory.
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
