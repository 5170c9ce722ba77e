"""Solve inverse kinematics of any chain of turning joints, by damped Newton steps from many starts.

Let J be the Jacobian at the joints q, (R*, p*) the target pose, and e = (p* - p, log(R* R^T)). A step from q
towards the target is

    dq = d + J^T (J J^T + l^2 I)^-1 (e - J d),        l^2 = DAMPING |e|^2

For d = 0 this is the damped least squares of Nakamura and Hanafusa (1986), which is Newton's method near a
solution. If d is a fraction of q_r - q, the steps also reduce the distance to the joints q_r. An arm with
more than six joints then moves along its self-motions to a place where this distance is stationary. If a step
would take a joint beyond its limit, the joint goes only to the limit. The function then computes the step of
the remaining joints again. The starts are always the same sequence, which fills the limits evenly (Roberts,
2018).

The search is not proven to be complete. The page docs/results/arms.md states the fraction of branches that it
finds.
"""

from __future__ import annotations

from math import sqrt

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import compiled, inlined
from safety_harness.base.elementary import power
from safety_harness.base.geometry.arrays import (
    Array4x4,
    Array6,
    Array6x6,
    Array6xN,
    ArrayN,
    ArrayNx4x4,
    ArrayNx6,
)
from safety_harness.base.geometry.linear import copy_vector, solve_in_place
from safety_harness.base.geometry.rotations import vector_from_rotation
from safety_harness.cell.robot.description import ArmModel, Chain, ChainRecords
from safety_harness.cell.robot.kinematics import TWIST, forward_kinematics, geometric_jacobian

# The figures are in docs/results/arms.md.
STARTS = 200  # to find all branches; for the UR family they find all that the closed form gives
GIVEN_UP = 96  # starts before a pose counts as out of reach; 1 in 1,000 poses of a Panda needs more
ENOUGH = 48  # starts for the nearest solution, if there is any solution
NEAR_RAD = 0.5  # a solution within this of the reference, found from it, counts as the nearest
# A choice: a start that has not converged by then is given up, and the next start is tried.
MOST_STEPS = 80
MOST_SLIDES = 60  # steps along a self-motion
# A choice. The damping l^2 falls with |e|^2, so it only acts far from a solution.
DAMPING = 0.01
# A choice: the linear model of a longer step no longer describes the arm.
LARGEST_STEP_RAD = 0.5
SOLVED = 1e-12  # largest entry of e [m, rad]
SETTLED_RAD = 1e-6  # largest step along a self-motion
# A choice: the largest fraction of the way to the reference in one step.
LARGEST_SHARE = 4.0
EXACT_POSE = 1e-9  # largest difference of a matrix entry (metres, or a direction cosine)
SAME_RAD = 1e-6


def starts_of(arm: ArmModel) -> NDArray[np.float64]:
    """Return joint positions (STARTS, n) that fill the position limits evenly.

    If the range of a joint exceeds one full turn, the positions fill one full turn.
    """
    lower, upper = arm.position_lower_rad, arm.position_upper_rad
    wide = ~(upper - lower < 2.0 * np.pi)
    lower, upper = np.where(wide, -np.pi, lower), np.where(wide, np.pi, upper)
    n = len(lower)
    # The root of x^(n+1) = x + 1 is a golden ratio for n dimensions. Multiples of its powers, modulo 1, fill
    # the unit cube evenly (Roberts, 2018). The fixed-point iteration converges in fewer than 60 steps.
    root = 2.0
    for _ in range(60):  # x^(n + 1) = x + 1
        root = power(1.0 + root, 1.0 / (n + 1))
    shares = (0.5 + np.outer(np.arange(1, STARTS + 1), power(root, -np.arange(1.0, n + 1.0)))) % 1.0
    starts: NDArray[np.float64] = lower + shares * (upper - lower)
    return starts


@compiled
def pose_error(target: Array4x4, reached: Array4x4, error_out: Array6) -> None:
    """Fill ``error_out`` (6,) with the pose error (p* - p, log(R* R^T)).

    ``target`` (4, 4) is the pose (R*, p*), and ``reached`` (4, 4) is the pose (R, p).
    """
    error_rotation = np.empty((3, 3))
    for i in range(3):
        error_out[i] = target[i, 3] - reached[i, 3]
        for j in range(3):
            error_rotation[i, j] = (
                target[i, 0] * reached[j, 0] + target[i, 1] * reached[j, 1] + target[i, 2] * reached[j, 2]
            )
    copy_vector(vector_from_rotation(error_rotation), error_out[3:])


@compiled
def least_step(jacobian: Array6xN, twist: Array6, matrix: Array6x6, step_out: ArrayN) -> bool:
    """Fill ``step_out`` (n,) with the shortest dq for which J dq = (v, w).

    This step is J^T (J J^T)^-1 (v, w). The function overwrites ``twist`` (6,) and ``matrix`` (6, 6). The
    function returns False if J (6, n) has fewer than six independent rows.
    """
    for i in range(TWIST):
        for j in range(TWIST):
            matrix[i, j] = 0.0
            for k in range(step_out.shape[0]):
                matrix[i, j] += jacobian[i, k] * jacobian[j, k]
    # With fewer than six joints J J^T is singular, and most twists have no step.
    if step_out.shape[0] < TWIST or not solve_in_place(matrix, twist):
        return False
    for i in range(step_out.shape[0]):
        step_out[i] = 0.0
        for k in range(TWIST):
            step_out[i] += jacobian[k, i] * twist[k]
    return True


@compiled
def solve_from(
    chains: ChainRecords,
    lower_rad: ArrayN,
    upper_rad: ArrayN,
    pose: Array4x4,
    joints: ArrayN,
    transforms: ArrayNx4x4,
    jacobian: Array6xN,
) -> bool:
    """Move ``joints`` (n,) to the pose (4, 4) within the position limits (n,).

    Return whether the steps converge. The function writes ``transforms`` and ``jacobian``.
    """
    n = joints.shape[0]
    step, pull, error = np.empty(n), np.zeros(n), np.empty(TWIST)
    for _ in range(MOST_STEPS):
        if _error_at(chains, pose, joints, transforms, jacobian, error) < SOLVED:
            return _is_same(pose, transforms[n + 1])
        if not _step(jacobian, error, pull, joints, lower_rad, upper_rad, step):
            return False
    return False


@inlined
def _is_same(pose: Array4x4, reached: Array4x4) -> bool:
    """Return whether two matrices (4, 4) agree to EXACT_POSE.

    If ``pose`` is not a valid transform, it never agrees with ``reached``, which is always a valid transform.
    """
    for i in range(4):
        for j in range(4):
            if not abs(pose[i, j] - reached[i, j]) <= EXACT_POSE:
                return False
    return True


@compiled
def slide(
    chains: ChainRecords,
    lower_rad: ArrayN,
    upper_rad: ArrayN,
    pose: Array4x4,
    reference_rad: ArrayN,
    joints: ArrayN,
    transforms: ArrayNx4x4,
    jacobian: Array6xN,
) -> float:
    """Move a solution along its self-motion, and by full turns, to the least distance from the reference.

    ``joints`` (n,) is the solution. Each step goes a fraction of the distance to ``reference_rad`` (n,), and
    then back to the pose. If the joints are not nearer after the step, the function undoes the step and makes
    the next step shorter. The function returns the remaining distance [rad].
    """
    n = joints.shape[0]
    step, pull, error, trial = np.empty(n), np.empty(n), np.empty(TWIST), joints.copy()
    away, share = _turned_towards(lower_rad, upper_rad, reference_rad, joints), 1.0
    # With at most six joints a branch is a point, so full turns are all that can be gained.
    for _ in range(MOST_SLIDES if n > TWIST else 0):
        copy_vector(joints, trial)
        for i in range(n):
            pull[i] = share * (reference_rad[i] - joints[i])
        _error_at(chains, pose, trial, transforms, jacobian, error)
        if not _step(jacobian, error, pull, trial, lower_rad, upper_rad, step):
            break
        moved = np.abs(step).max()
        if solve_from(chains, lower_rad, upper_rad, pose, trial, transforms, jacobian):
            nearer = _turned_towards(lower_rad, upper_rad, reference_rad, trial)
            if nearer < away:
                away, share = nearer, min(2.0 * share, LARGEST_SHARE)
                copy_vector(trial, joints)
                # The step grows with the fraction, so the threshold does too.
                if moved < SETTLED_RAD * share:
                    break
                continue
        if moved < SETTLED_RAD * share:
            break
        share *= 0.25
    return away


@inlined
def _error_at(
    chains: ChainRecords,
    pose: Array4x4,
    joints: ArrayN,
    transforms: ArrayNx4x4,
    jacobian: Array6xN,
    error: Array6,
) -> float:
    """Compute ``transforms``, ``jacobian`` and the pose error ``error`` at the joints.

    Return the largest entry of the error.
    """
    forward_kinematics(chains[0], joints, transforms)
    geometric_jacobian(chains[0].joint_axes, transforms, jacobian)
    pose_error(pose, transforms[joints.shape[0] + 1], error)
    largest = 0.0
    for i in range(TWIST):
        largest = max(largest, abs(error[i]))
    return largest


@compiled
def _step(
    jacobian: Array6xN,
    error: Array6,
    pull: ArrayN,
    joints: ArrayN,
    lower_rad: ArrayN,
    upper_rad: ArrayN,
    step: ArrayN,
) -> bool:
    """Move ``joints`` (n,) by a damped step, and store the step in ``step``.

    Return False if the step is not finite. If the step would take a joint beyond a limit, the joint goes to
    the limit. The function then computes the step of the other joints again.
    """
    n = joints.shape[0]
    fixed, rest = np.zeros(n, np.bool_), np.empty(TWIST)
    # Each further round fixes at least one more joint at its limit, so there are at most n of them.
    for _ in range(n + 1):
        copy_vector(error, rest)
        for i in range(n):
            moved = step[i] if fixed[i] else pull[i]
            for k in range(TWIST):
                rest[k] -= jacobian[k, i] * moved
        if not _damped(jacobian, error, rest, fixed):
            return False
        again, scale = False, 1.0
        for i in range(n):
            if not fixed[i]:
                step[i] = pull[i]
                for k in range(TWIST):
                    step[i] += jacobian[k, i] * rest[k]
                # Scale the whole step, so that its direction in joint space remains.
                scale = min(scale, LARGEST_STEP_RAD / max(abs(step[i]), LARGEST_STEP_RAD))
        for i in range(n):
            if not fixed[i]:
                step[i] *= scale
                inside = min(max(joints[i] + step[i], lower_rad[i]), upper_rad[i]) - joints[i]
                if inside != step[i]:
                    step[i], fixed[i], again = inside, True, True
        if not again:
            break
    for i in range(n):
        joints[i] += step[i]
    return True


@compiled
def _damped(jacobian: Array6xN, error: Array6, rest: Array6, fixed: NDArray[np.bool_]) -> bool:
    """Replace ``rest`` (6,) by the product of (J J^T + l^2 I)^-1 and ``rest``.

    J contains only the columns of the free joints, whose entry in ``fixed`` (n,) is False.
    """
    matrix, squared = np.empty((TWIST, TWIST)), 0.0
    for i in range(TWIST):
        squared += error[i] * error[i]
    for i in range(TWIST):
        for j in range(TWIST):
            # 1e-15 keeps the matrix regular at a solution, where |e| is 0, of an arm with fewer than six free
            # joints.
            total = DAMPING * squared + 1e-15 if i == j else 0.0
            for k in range(fixed.shape[0]):
                if not fixed[k]:
                    total += jacobian[i, k] * jacobian[j, k]
            matrix[i, j] = total
    return solve_in_place(matrix, rest)


@compiled
def all_found(chains: ChainRecords, starts: NDArray[np.float64], pose: Array4x4) -> NDArray[np.float64]:
    """Return the different solutions (k, n) that the search finds for ``pose`` (4, 4), in (-pi, pi].

    The search begins at each of the ``starts`` (m, n).
    """
    n = starts.shape[1]
    transforms, jacobian = np.empty((n + 2, 4, 4)), np.empty((TWIST, n))
    # ``branches`` ignores position limits.
    free = np.full(n, np.inf)
    solutions, kept, joints = np.empty(starts.shape), 0, np.empty(n)
    for s in range(starts.shape[0]):
        copy_vector(starts[s], joints)
        if solve_from(chains, -free, free, pose, joints, transforms, jacobian):
            for i in range(n):
                joints[i] = wrapped_rad(joints[i])
            if not is_among(joints, solutions[:kept]):
                copy_vector(joints, solutions[kept])
                kept += 1
    return solutions[:kept].copy()


@compiled
def is_among(joints: ArrayN, known: ArrayNx6) -> bool:
    """Return whether ``joints`` equals a row of ``known`` (k, n), up to whole turns.

    The tolerance is SAME_RAD.
    """
    for k in range(known.shape[0]):
        same = True
        for i in range(joints.shape[0]):
            same = same and abs(wrapped_rad(joints[i] - known[k, i])) < SAME_RAD
        if same:
            return True
    return False


@inlined
def wrapped_rad(angle: float) -> float:
    """Return the equivalent angle [rad] in (-pi, pi]."""
    wrapped = np.pi - np.mod(np.pi - angle, 2.0 * np.pi)
    return float(wrapped if wrapped > -np.pi else np.pi)  # np.mod may round up to the whole turn


@compiled
def nearest_found(
    chains: ChainRecords,
    lower_rad: ArrayN,
    upper_rad: ArrayN,
    starts: NDArray[np.float64],  # (k, n)
    poses: NDArray[np.float64],  # (m, 4, 4)
    reference_rad: ArrayN,
) -> NDArray[np.float64]:
    """Return the solution within the limits that is nearest to the reference for each pose, shape (m, n).

    A pose for which the search finds no such solution gives NaN.
    """
    n = starts.shape[1]
    transforms, jacobian, joints = np.empty((n + 2, 4, 4)), np.empty((TWIST, n)), np.empty(n)
    solutions = np.full((poses.shape[0], n), np.nan)
    for m in range(poses.shape[0]):
        best = np.inf
        # Start -1 is the reference itself, which usually converges in few steps to the nearest solution.
        for s in range(-1, 0 if _is_beyond(chains[0], poses[m]) else GIVEN_UP):
            if s >= ENOUGH and best < np.inf:
                break
            for i in range(n):
                start = reference_rad[i] if s < 0 else starts[s, i]
                joints[i] = min(max(start, lower_rad[i]), upper_rad[i])
            pose = poses[m]
            if not solve_from(chains, lower_rad, upper_rad, pose, joints, transforms, jacobian):
                continue
            away = slide(chains, lower_rad, upper_rad, pose, reference_rad, joints, transforms, jacobian)
            if away < best:
                best = away
                copy_vector(joints, solutions[m])
            if s < 0 and away < NEAR_RAD:
                break
    return solutions


@inlined
def _is_beyond(chain: Chain, pose: Array4x4) -> bool:
    """Return whether a pose (4, 4) is too far from the first joint.

    The TCP's distance from the first joint is at most the sum of the distances between all later frames.
    """
    reach_m, away_m = 0.0, 0.0
    for joint in range(1, chain.joint_origins.shape[0]):
        reach_m += _length_m(chain.joint_origins[joint])
    for i in range(3):
        away_m += (pose[i, 3] - chain.joint_origins[0, i, 3]) ** 2
    return sqrt(away_m) > reach_m + _length_m(chain.flange) + SOLVED


@inlined
def _length_m(frame: Array4x4) -> float:
    """Return the length [m] of the position in ``frame``."""
    return sqrt(frame[0, 3] ** 2 + frame[1, 3] ** 2 + frame[2, 3] ** 2)


@inlined
def _turned_towards(lower_rad: ArrayN, upper_rad: ArrayN, reference_rad: ArrayN, joints: ArrayN) -> float:
    """Turn each joint by full turns, so that it is as near to the reference as its limits allow.

    Return the remaining distance [rad] from the reference.
    """
    total = 0.0
    for i in range(joints.shape[0]):
        aim = min(max(reference_rad[i], lower_rad[i]), upper_rad[i])
        turns = np.round((aim - joints[i]) / (2.0 * np.pi))
        # The nearest turn may lie just beyond a limit, so the turns beside it are tried too.
        for more in (0.0, -1.0, 1.0):
            turned = joints[i] + (turns + more) * (2.0 * np.pi)
            if lower_rad[i] <= turned <= upper_rad[i]:
                joints[i] = turned
                break
        total += (joints[i] - reference_rad[i]) ** 2
    return sqrt(total)
