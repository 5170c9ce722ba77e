"""Compute a run's hand distance independently, by PyBullet's own kinematics and distances.

The trace contributes the joints and the positions of the hands, and the package the sizes of the bodies.
Nothing else of the package is used. The computation assumes that joints and hands move straight from tick to
tick.
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
    """The finding of the geometry about a limit of the hand distance."""

    PROVEN = "kept"  # at every tick and between
    REFUTED = "broken"  # at a tick
    OPEN = "open"  # too near to tell


def hand_distance_kept(trace: Trace, limit_m: float) -> Kept:
    """Return whether all hands and forearms stay at least ``limit_m`` away from the arm's capsules.

    The distance is measured from surface to surface.  The function skips the ticks in which joints and hands
    cannot move far enough to use up the last distance. It bounds the arm's motion by the joints' motion times
    ``span_m_of``. The function assumes that a hand appears or disappears only at a tick.
    """
    ticks = trace.ticks
    present = ticks["hand_present"]
    read = [ticks["joint_position_rad"], *(ticks[name][present] for name in BODIES)]
    if not len(ticks) or not all(np.isfinite(column).all() for column in read):
        return Kept.OPEN
    moved_m = _most_moved_m(ticks, span_m_of(trace))
    stops = np.where((present[1:] != present[:-1]).any(axis=1), 2.0 * FAR_M, 0.0)
    spent_m = np.concatenate([[0.0], np.cumsum(moved_m + stops)])
    result = Kept.PROVEN
    with PyBulletArm(trace) as cell:
        k, distance_m = 0, cell.distance_m(ticks[0])
        while distance_m >= limit_m - ROUNDING_M:
            if k == len(ticks) - 1:
                return result
            spare_m = distance_m - limit_m - CLEAR_M
            last = int(np.searchsorted(spent_m, spent_m[k] + spare_m, side="right")) - 1
            following = max(last, k + 1)
            next_m = cell.distance_m(ticks[following])
            if following > last and distance_m + next_m - moved_m[k] < 2.0 * (limit_m + CLEAR_M):
                result = Kept.OPEN
            k, distance_m = following, next_m
    return Kept.REFUTED


def span_m_of(trace: Trace) -> float:
    """Return a length [m] that no point of the arm exceeds in its distance from any of the arm's joints."""
    robot = trace.scenario.robot
    return max(SPAN_M, float(arm_with(arm_model(robot), arm_capsules(robot)).reach_m.max()))


def _most_moved_m(ticks: NDArray[np.void], span_m: float) -> NDArray[np.float64]:
    """Return the largest change (n-1,) [m] of the distance between ticks, for hands present at both ticks."""
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
        """Return the least distance [m] from the arm to any hand or forearm at a tick, at most ``FAR_M``."""
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
        """Return rotation and origin of the frame of ``link``; link 0 is the base, and the last the TCP."""
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
            turn = np.array([-y, x, 0.0, 1.0 + z]) if z > -0.999999 else np.array([1.0, 0.0, 0.0, 0.0])
            turn /= length(turn)
        self._bullet.resetBasePositionAndOrientation(
            body, 0.5 * (start + end), turn, physicsClientId=self._client
        )
