"""Write the world's truth at a control tick into the trace: poses, speeds, distances."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import njit_no_nrt
from safety_harness.base.elementary import cos, sin
from safety_harness.base.geometry.arrays import ArrayN, ArrayNx2x3
from safety_harness.base.geometry.linear import copy_matrix, copy_vector
from safety_harness.base.settings import Camera, Hand, Settings
from safety_harness.cell.robot.capsules import CapsuleSet
from safety_harness.cell.robot.description import ArmModel, chain_of
from safety_harness.cell.robot.distance import CapsuleRecords, hand_distance_from, place_capsules
from safety_harness.cell.robot.kinematics import forward_kinematics, tcp_velocity
from safety_harness.cell.simulation.hand_motion import HandRecords


@lru_cache
def arm_dtype(joints: int) -> np.dtype[Any]:
    """Return the record type ARM with ``joints`` joints."""
    return np.dtype(
        [
            ("chain", chain_of(joints)),
            ("hand_radius_m", np.float64),
            ("forearm_radius_m", np.float64),
            ("link_transforms", np.float64, (joints + 2, 4, 4)),  # the arm's true pose at the last tick
        ],
        align=True,
    )


def arm_record(arm: ArmModel, settings: Settings) -> NDArray[np.void]:
    """Return a record ARM (1,)."""
    return _arm_record(arm, settings.hand).copy()


@lru_cache(maxsize=16)
def _arm_record(arm: ArmModel, hand: Hand) -> NDArray[np.void]:
    """Return the record of ``arm_record``, cached for each arm and hand."""
    record = np.zeros(1, arm_dtype(len(arm.joint_names)))
    record["chain"] = arm.chain
    record["hand_radius_m"] = hand.radius_m
    record["forearm_radius_m"] = hand.forearm_radius_m
    return record


def cell_capsules(capsules: CapsuleSet, settings: Settings) -> CapsuleSet:
    """Return the arm's capsules and one more capsule for the body of the hand-eye camera.

    A D435 camera is 90 mm wide, 25 mm high and 25 mm deep (Intel's data sheet). The middle of the camera's
    capsule is the optical centre, and the axis is along the image's u axis. The radius is half the diagonal
    of the camera's cross-section.
    """
    return _with_camera(capsules, settings.camera)


@lru_cache(maxsize=16)
def _with_camera(capsules: CapsuleSet, camera: Camera) -> CapsuleSet:
    """Return the capsules of ``cell_capsules``, cached for each set and camera."""
    offset = np.array(camera.mount_offset_in_tcp_m)
    along = np.array([cos(camera.mount_yaw_rad), sin(camera.mount_yaw_rad), 0.0])
    radius_m = 0.0177  # half the diagonal of 25 mm x 25 mm
    half_m = 0.045 - radius_m
    return capsules.with_capsule(
        "camera", capsules.frames - 1, offset - half_m * along, offset + half_m * along, radius_m
    )


@njit_no_nrt
def fill_truth(
    arms: NDArray[np.void],  # (1,) ARM
    ticks: NDArray[np.void],  # (1,) ``as_compiled``, written
    hands: HandRecords,
    capsules: CapsuleRecords,
    capsule_endpoints_in_base_m: ArrayNx2x3,  # written
    joint_position_rad: ArrayN,
    joint_velocity_radps: ArrayN,
    time_s: float,
) -> None:
    """Write the truth part of a tick, and update the capsules and link poses for the sensors."""
    arm, tick = arms[0], ticks[0]
    tick.time_s = time_s
    copy_vector(joint_position_rad, tick.joint_position_rad)
    copy_vector(joint_velocity_radps, tick.joint_velocity_radps)
    forward_kinematics(arm.chain, joint_position_rad, arm.link_transforms)
    copy_matrix(arm.link_transforms[arm.chain.joint_axes.shape[0] + 1], tick.transform_tcp_to_base)
    x, y, z = tcp_velocity(arm.chain.joint_axes, arm.link_transforms, joint_velocity_radps)
    tick.tcp_speed_mps = np.sqrt(x * x + y * y + z * z)
    place_capsules(capsules, arm.link_transforms, capsule_endpoints_in_base_m)
    for k in range(hands.shape[0]):
        hand = hands[k]
        tick.hand_present[k] = hand.present
        for i in range(3):
            tick.hand_position_in_base_m[k, i] = hand.position_in_base_m[i] if hand.present else 0.0
            tick.elbow_position_in_base_m[k, i] = hand.elbow_in_base_m[i] if hand.present else 0.0
        likely = min(
            tick.hand_distance_capsule[k], capsules.shape[0] - 1
        )  # the nearest capsule of the previous tick, if the hand was there: likely the nearest again
        tick.hand_distance_m[k] = np.inf
        tick.hand_distance_capsule[k] = -1
        if hand.present:
            at, elbow, radius_m = hand.position_in_base_m, hand.elbow_in_base_m, arm.hand_radius_m
            tick.hand_distance_m[k], tick.hand_distance_capsule[k] = hand_distance_from(
                capsules, capsule_endpoints_in_base_m, at, elbow, radius_m, arm.forearm_radius_m, likely
            )
