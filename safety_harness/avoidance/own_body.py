"""How near the arm's wrist is to the rest of the arm: what the gate asks along a way."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from safety_harness.compiled import compiled
from safety_harness.geometry.segments import ROUNDING_M, axes_lower_m, segment_segment_distance
from safety_harness.robot.capsules import CapsuleSet
from safety_harness.robot.description import ArmModel
from safety_harness.robot.distance import place_capsules
from safety_harness.robot.kinematics import FRAMES, forward_kinematics

LAST_OF_THE_BODY = 2  # base, shoulder, upper arm
FIRST_OF_THE_WRIST = 4  # the three wrist links and the TCP's frame; the forearm touches both


@compiled
def wrist_distance(
    placed: NDArray[np.float64], radius_m: NDArray[np.float64], link_index: NDArray[np.int64]
) -> float:
    """Least distance [m] between capsules of the wrist and of base, shoulder and upper arm.

    ``placed`` (n, 2, 3) as ``place_capsules`` fills it; negative in penetration, NaN if any is NaN.
    """
    least = np.inf  # pairs are passed over that cannot be as near
    for wrist in range(link_index.shape[0]):
        if link_index[wrist] < FIRST_OF_THE_WRIST:
            continue
        for body in range(link_index.shape[0]):
            if link_index[body] > LAST_OF_THE_BODY:
                continue
            radii_m = radius_m[wrist] + radius_m[body]
            if axes_lower_m(placed[wrist], placed[body]) - radii_m - ROUNDING_M > least:  # never of a NaN
                continue
            axes = segment_segment_distance(
                placed[wrist, 0], placed[wrist, 1], placed[body, 0], placed[body, 1]
            )
            distance = axes - radius_m[wrist] - radius_m[body]
            if not distance >= least:  # takes a NaN over, and nothing is less than a NaN
                least = distance
                if np.isnan(least):
                    return float(least)
    return float(least)


def own_distance(arm: ArmModel, capsules: CapsuleSet, joint_position_rad: NDArray[np.float64]) -> float:
    """``wrist_distance`` [m] of ``arm`` at the joint position (6,)."""
    transforms = np.empty((FRAMES, 4, 4))
    placed = np.empty((len(capsules.names), 2, 3))
    forward_kinematics(arm.joint_origins, arm.joint_axes, arm.flange, joint_position_rad, transforms)
    place_capsules(transforms, capsules.link_index, capsules.start_in_link, capsules.end_in_link, placed)
    return wrist_distance(placed, capsules.radius_m, capsules.link_index)
