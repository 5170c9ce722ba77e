"""Draw pictures of an episode in any world, with PyBullet's software renderer.

The camera is outside the cell.
"""

from __future__ import annotations

from types import TracebackType

import numpy as np
import pybullet
from numpy.typing import NDArray

from safety_harness.admission.admit import Checked
from safety_harness.base.elementary import length
from safety_harness.cell.simulation.cell import build_cell, place_hands, render

EYE_IN_BASE_M, TARGET_IN_BASE_M = np.array([1.9, -1.5, 1.3]), np.array([0.4, -0.15, 0.25])
HEIGHT_PX, WIDTH_PX, FOCAL_PX = 480, 640, 560.0
_HAND = np.dtype(
    [("present", np.bool_), ("position_in_base_m", np.float64, 3), ("elbow_in_base_m", np.float64, 3)]
)


class Viewer:
    """A drawing of an episode's cell in a separate PyBullet client; use it as a context manager."""

    def __init__(self, checked: Checked) -> None:
        self._hands = len(checked.scenario.hands)
        self._client = int(pybullet.connect(pybullet.DIRECT))
        settings, joints_rad = checked.scenario.settings, checked.joint_position_rad
        self._bodies = build_cell(
            self._client, settings, checked.arm, joints_rad, rendered=True, hands=self._hands
        )

    def __enter__(self) -> Viewer:
        """Return this viewer."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Disconnect the client."""
        pybullet.disconnect(physicsClientId=self._client)

    def picture(self, tick: np.void) -> NDArray[np.uint8]:
        """Return a picture of the arm and the hands at ``tick``, shape (480, 640, 3)."""
        hands = np.zeros(self._hands, _HAND)
        hands["present"] = tick["hand_present"][: self._hands]
        hands["position_in_base_m"] = tick["hand_position_in_base_m"][: self._hands]
        hands["elbow_in_base_m"] = tick["elbow_position_in_base_m"][: self._hands]
        place_hands(self._client, self._bodies, hands)
        joints = [[q] for q in tick["joint_position_rad"]]
        pybullet.resetJointStatesMultiDof(
            self._bodies.robot, self._bodies.joints, joints, physicsClientId=self._client
        )
        colour, _ = render(self._client, _camera_to_base(), FOCAL_PX, WIDTH_PX, HEIGHT_PX)
        return colour


def _camera_to_base() -> NDArray[np.float64]:
    """Return the pose of a level camera that is at the eye and looks at the target, shape (4, 4).

    The camera's y axis points down.
    """
    ahead = (TARGET_IN_BASE_M - EYE_IN_BASE_M) / length(TARGET_IN_BASE_M - EYE_IN_BASE_M)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= length(right)
    pose = np.eye(4)
    pose[:3] = np.stack([right, np.cross(ahead, right), ahead, EYE_IN_BASE_M], axis=1)
    return pose
