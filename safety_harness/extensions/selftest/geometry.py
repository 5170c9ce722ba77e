"""Compute the hand distance in a run independently, with the kinematics and the distances of PyBullet.

The trace provides the joints and the positions of the hands, and the package provides the sizes of the
bodies. The computation uses no other part of the package. It assumes that joints and hands move in straight
lines from tick to tick.
"""

from __future__ import annotations

from enum import Enum
from types import TracebackType

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.elementary import length, product
from safety_harness.base.extras import PYBULLET
from safety_harness.cell.robot.capsules import arm_with
from safety_harness.cell.robot.robots import arm_capsules, arm_model
from safety_harness.cell.simulation.truth import cell_capsules
from safety_harness.trace.trace import Trace

SPAN_M = 2.0  # no point of a shipped arm is farther from one of its joints
ROUNDING_M = 1e-4  # PyBullet returns link frames in single precision
CLEAR_M = 1e-3  # reserve of a proof, because the claim's bound may lie below the distance by less
FAR_M = 20.0  # the reported distance if bodies are farther apart, or if there is no hand
BODIES = ("hand_position_in_base_m", "elbow_position_in_base_m")


class Kept(Enum):
    """The result of the geometric check of a limit on the hand distance."""

    PROVEN = "kept"  # at every tick and between
    REFUTED = "broken"  # at a tick
    OPEN = "open"  # too near to tell


def hand_distance_kept(trace: Trace, limit_m: float) -> Kept:
    """Return whether all hands and forearms stay at least ``limit_m`` away from the arm's capsules.

    The distance is measured from surface to surface. The function computes the distance only at some ticks.
    It skips the following ticks as long as the bodies cannot have moved far enough to reach the limit. The
    arm's motion is at most ``span_m_of`` times the joints' motion. The function assumes that a hand appears
    or disappears only at a tick.
    """
    ticks = trace.ticks
    present = ticks["hand_present"]
    read = [ticks["joint_position_rad"], *(ticks[name][present] for name in BODIES)]
    if not len(ticks) or not all(np.isfinite(column).all() for column in read):
        return Kept.OPEN
    moved_m = _most_moved_m(ticks, span_m_of(trace))
    # Longer than any spare distance, so that no skip passes a tick where a hand appears or disappears.
    stops = np.where((present[1:] != present[:-1]).any(axis=1), 2.0 * FAR_M, 0.0)
    spent_m = np.concatenate([[0.0], np.cumsum(moved_m + stops)])
    result = Kept.PROVEN
    with PyBulletArm(trace) as cell:
        k, distance_m = 0, cell.distance_m(ticks[0])
        while distance_m >= limit_m - ROUNDING_M:
            if k == len(ticks) - 1:
                return result
            spare_m = distance_m - limit_m - CLEAR_M
            # The last tick that the motion reaches without using up the spare distance.
            last = int(np.searchsorted(spent_m, spent_m[k] + spare_m, side="right")) - 1
            following = max(last, k + 1)
            next_m = cell.distance_m(ticks[following])
            # Nothing was to spare. Between the two ticks, the distance is at least half of the left side.
            if following > last and distance_m + next_m - moved_m[k] < 2.0 * (limit_m + CLEAR_M):
                result = Kept.OPEN
            k, distance_m = following, next_m
    return Kept.REFUTED


def span_m_of(trace: Trace) -> float:
    """Return an upper bound of the distance between any point of the arm and any joint of the arm [m]."""
    robot = trace.scenario.robot
    return max(SPAN_M, float(arm_with(arm_model(robot), arm_capsules(robot)).reach_m.max()))


def _most_moved_m(ticks: NDArray[np.void], span_m: float) -> NDArray[np.float64]:
    """Return a bound (n-1,) [m] on the change of the distance between ticks.

    Only hands that are present at both ticks contribute their own motion.
    """
    moved_m: NDArray[np.float64] = span_m * np.abs(np.diff(ticks["joint_position_rad"], axis=0)).sum(axis=1)
    stays = ticks["hand_present"][1:] & ticks["hand_present"][:-1]
    steps_m = [np.linalg.norm(np.diff(ticks[name], axis=0), axis=2) for name in BODIES]
    moved_m += np.where(stays, np.maximum(*steps_m), 0.0).max(axis=1, initial=0.0)
    return moved_m


class PyBulletArm:
    """A separate PyBullet client with the arm of a trace and one body for each of its capsules."""

    def __init__(self, trace: Trace) -> None:
        with PYBULLET.needed("geometry that is not ours"):
            from safety_harness.cell.simulation.cell import load_robot
            from safety_harness.cell.simulation.engine import pybullet
        self._bullet, self._load_robot = pybullet, load_robot
        self.trace = trace
        self._forearms: dict[float, int] = {}

    def __enter__(self) -> PyBulletArm:
        settings = self.trace.scenario.settings
        arm = arm_model(self.trace.scenario.robot)
        self._client = int(self._bullet.connect(self._bullet.DIRECT))
        self._arm, self._joints = self._load_robot(self._client, arm, visuals=False)
        capsules = cell_capsules(arm_capsules(self.trace.scenario.robot), settings)
        sizes = zip(capsules.start_in_link, capsules.end_in_link, capsules.radius_m, strict=True)
        bodies = [(self._capsule(float(length(b - a)), float(r)), a, b) for a, b, r in sizes]
        self._flange = arm.flange
        self._capsules = list(zip(capsules.link_index.tolist(), bodies, strict=True))
        self._hand = self._body(self._bullet.GEOM_SPHERE, radius=settings.hand.radius_m)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bullet.disconnect(physicsClientId=self._client)

    def distance_m(self, tick: np.void) -> float:
        """Return the least distance of a hand or forearm from the arm at a tick [m].

        If this distance exceeds ``FAR_M``, return ``FAR_M``.
        """
        hands = np.flatnonzero(tick["hand_present"])
        if len(hands):
            self._place_arm(tick["joint_position_rad"])
        return min((self._nearest_m(*(tick[name][k] for name in BODIES)) for k in hands), default=FAR_M)

    def _place_arm(self, joint_position_rad: NDArray[np.float64]) -> None:
        for joint, angle in zip(self._joints, joint_position_rad, strict=True):
            self._bullet.resetJointState(self._arm, joint, float(angle), physicsClientId=self._client)
        frames = {link: self._frame(link) for link in {link for link, _ in self._capsules}}
        for link, (body, start, end) in self._capsules:
            rotation, origin = frames[link]
            self._lay(body, product(rotation, start) + origin, product(rotation, end) + origin)

    def _frame(self, link: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the rotation and the origin of a link's frame.

        The index ``link`` is 0 for the base, and the last index is for the TCP.
        """
        if link == 0:
            return np.eye(3), np.zeros(3)
        if link > len(self._joints):
            rotation, origin = self._frame(link - 1)
            return product(rotation, self._flange[:3, :3]), product(rotation, self._flange[:3, 3]) + origin
        state = self._bullet.getLinkState(
            self._arm, self._joints[link - 1], computeForwardKinematics=True, physicsClientId=self._client
        )
        return np.reshape(self._bullet.getMatrixFromQuaternion(state[5]), (3, 3)), np.array(state[4])

    def _nearest_m(self, hand: NDArray[np.float64], elbow: NDArray[np.float64]) -> float:
        self._bullet.resetBasePositionAndOrientation(
            self._hand, hand, (0, 0, 0, 1), physicsClientId=self._client
        )
        # Rounding to a micrometre lets forearms of equal length share a body.
        forearm = self._forearm(round(float(length(elbow - hand)), 6))
        self._lay(forearm, hand, elbow)
        points = [
            point
            for _, (body, _, _) in self._capsules
            for limb in (self._hand, forearm)
            for point in self._bullet.getClosestPoints(body, limb, FAR_M, physicsClientId=self._client)
        ]
        return min((float(point[8]) for point in points), default=FAR_M)

    def _forearm(self, length_m: float) -> int:
        if length_m not in self._forearms:
            radius_m = self.trace.scenario.settings.hand.forearm_radius_m
            self._forearms[length_m] = self._capsule(length_m, radius_m)
        return self._forearms[length_m]

    def _capsule(self, length_m: float, radius_m: float) -> int:
        return self._body(self._bullet.GEOM_CAPSULE, radius=radius_m, height=length_m)

    def _body(self, kind: int, **size_m: float) -> int:
        shape = self._bullet.createCollisionShape(kind, **size_m, physicsClientId=self._client)
        return int(self._bullet.createMultiBody(0.0, shape, physicsClientId=self._client))

    def _lay(self, body: int, start: NDArray[np.float64], end: NDArray[np.float64]) -> None:
        """Place a capsule's body from ``start`` to ``end``.

        The body's z axis is the capsule's axis, and its origin is the capsule's middle.
        """
        axis_m = end - start
        length_m = float(length(axis_m))
        turn = np.array([0.0, 0.0, 0.0, 1.0])
        if length_m > 0.0:
            x, y, z = axis_m / length_m
            # The quaternion that turns z to the axis. It vanishes for the opposite axis, where a half turn
            # about x does.
            turn = np.array([-y, x, 0.0, 1.0 + z]) if z > -0.999999 else np.array([1.0, 0.0, 0.0, 0.0])
            turn /= length(turn)
        self._bullet.resetBasePositionAndOrientation(
            body, 0.5 * (start + end), turn, physicsClientId=self._client
        )
