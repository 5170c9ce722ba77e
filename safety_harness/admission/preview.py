"""A preview of an admitted scenario before its run: the paths of the hands, and the camera's view.

The preview simulates no run, so a hand that moves towards the TCP moves towards the start position of the
TCP.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from safety_harness.admission.admit import Checked
from safety_harness.base.elementary import product
from safety_harness.base.geometry.arrays import Array3, Array4x4
from safety_harness.base.geometry.transforms import inverse_transform
from safety_harness.cell.controller.desired import desired_transform_tcp_to_base
from safety_harness.cell.perception.camera import principal_point_px, transform_camera_to_tcp
from safety_harness.cell.robot.kinematics import links_in_base
from safety_harness.cell.simulation.cameras import object_polygon_in_base
from safety_harness.cell.simulation.hand_motion import advance_hands
from safety_harness.cell.simulation.hand_programs import hands_at_start
from safety_harness.scenario.model import Scenario

Floats = NDArray[np.float64]
STEP_S = 0.02  # between two points of a drawn path; a choice


@dataclass(frozen=True, eq=False)
class Preview:
    """The scene of a scenario, with positions in the base frame.

    ``links_in_base_m`` (n + 2, 3) holds the arm's link frames at the start; the last frame is the TCP.
    ``hand_paths_in_base_m`` holds an array (n, 3) for each hand.  ``object_in_base_m`` (k, 3) holds the
    object's corners.  ``start_image_px`` and ``desired_image_px`` (k, 2) hold these corners in the camera's
    image.
    """

    scenario: Scenario
    links_in_base_m: Floats
    object_in_base_m: Floats
    hand_paths_in_base_m: tuple[Floats, ...]
    start_image_px: Floats
    desired_image_px: Floats

    @property
    def tcp_in_base_m(self) -> Floats:
        """The TCP position (3,) at the start."""
        tcp: Floats = self.links_in_base_m[-1]
        return tcp


def preview_of(checked: Checked) -> Preview:
    """Return the preview of a scenario that can run."""
    scenario, arm = checked.scenario, checked.arm
    transforms = links_in_base(arm, checked.joint_position_rad)
    return Preview(
        scenario=scenario,
        links_in_base_m=transforms[:, :3, 3].copy(),
        object_in_base_m=object_polygon_in_base(scenario.settings),
        hand_paths_in_base_m=hand_paths(scenario, transforms[-1, :3, 3].copy()),
        start_image_px=object_image_px(scenario, transforms[-1]),
        desired_image_px=object_image_px(scenario, desired_transform_tcp_to_base(scenario.settings)),
    )


def hand_paths(scenario: Scenario, tcp_in_base_m: Array3) -> tuple[Floats, ...]:
    """Return the path (n, 3) of each hand while the TCP stays at ``tcp_in_base_m`` (3,)."""
    hands = hands_at_start(scenario)
    steps = int(np.ceil(scenario.duration_s / STEP_S))
    paths = np.empty((len(scenario.hands), steps + 1, 3))
    for step in range(steps + 1):
        paths[:, step] = hands.state["position_in_base_m"][: len(scenario.hands)]
        advance_hands(hands.state, hands.moves, hands.samples, tcp_in_base_m, step * STEP_S, STEP_S)
    return tuple(paths)


def object_image_px(scenario: Scenario, transform_tcp_to_base: Array4x4) -> Floats:
    """Return the object's corners (k, 2) in pixels from the image's upper left corner.

    Corners outside the image are included.
    """
    camera = scenario.settings.camera
    camera_to_base = product(transform_tcp_to_base, transform_camera_to_tcp(camera, calibrated=False))
    base_to_camera = inverse_transform(camera_to_base)
    corners = (
        product(object_polygon_in_base(scenario.settings), base_to_camera[:3, :3].T) + base_to_camera[:3, 3]
    )
    centre_px = np.array(principal_point_px(camera.width_px, camera.height_px))
    image: Floats = camera.focal_px * corners[:, :2] / corners[:, 2:] + centre_px
    return image
