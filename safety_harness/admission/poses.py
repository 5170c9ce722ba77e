"""Where the TCP starts and where it is to end: both must be poses that servoing can work at."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from safety_harness.controller.desired import DOWN, desired_transform_tcp_to_base
from safety_harness.exceptions import InadmissibleError
from safety_harness.geometry.rotations import rotation_from_vector
from safety_harness.perception.moments import MOMENT_COUNT
from safety_harness.robot.description import ArmModel, load_arm
from safety_harness.robot.inverse import InverseKinematics
from safety_harness.robot.kinematics import geometric_jacobian, links_in_base, smallest_singular_value
from safety_harness.scenario.model import JointStart, PoseStart, Scenario
from safety_harness.settings import Settings
from safety_harness.simulation.cameras import SensorRecords, camera_state, object_polygon_in_base
from safety_harness.simulation.exact_views import exact_object

START, DESIRED = "tcp start", "settings.cell.desired tcp position"
# What else the user may have written that puts the object out of view.
VIEW = (
    "object.position",
    "object.polygon",
    "object.yaw",
    "settings.servo.object kind",
    "camera.focal",
    "camera.width",
    "camera.height",
    "camera.mount offset",
    "camera.mount yaw",
)


@lru_cache
def kinematics(arm_name: str = "ur10") -> InverseKinematics:
    """The arm's inverse kinematics, built once a process."""
    return InverseKinematics(load_arm(arm_name))


def checked_start(scenario: Scenario, arm: ArmModel) -> NDArray[np.float64]:
    """The start's joint angles; one that is singular, too low, or without the object in view is refused."""
    joints = start_joint_position(scenario, arm)
    _check_pose(scenario, arm, joints, "TCP start", START)
    return joints


def start_joint_position(scenario: Scenario, arm: ArmModel) -> NDArray[np.float64]:
    """The joint angles of the TCP start: given, or by inverse kinematics on the preferred branch."""
    start = scenario.start
    if isinstance(start, JointStart):
        joints = np.array(start.joint_position_rad)
        outside = (joints < arm.position_lower_rad) | (joints > arm.position_upper_rad)
        if outside.any():
            worst = int(np.argmax(outside))
            raise InadmissibleError(
                place=scenario.place(START),
                expected=f"{arm.joint_names[worst]} between {np.degrees(arm.position_lower_rad[worst]):.0f} "
                f"and {np.degrees(arm.position_upper_rad[worst]):.0f} deg",
                got=f"{np.degrees(joints[worst]):.1f} deg",
            )
        return joints
    target = desired_transform_tcp_to_base(scenario.settings)
    if isinstance(start, PoseStart):
        target[:3, 3] = start.position_in_base_m
    else:
        target[:3, 3] += start.offset_in_base_m
    target[:3, :3] = target[:3, :3] @ rotation_from_vector(np.array(start.tilt_in_tcp_rad))
    return _reached(scenario, arm, target, "TCP start", START)


def check_desired(scenario: Scenario, arm: ArmModel) -> None:
    """Refuse a desired pose that the arm cannot reach, or where a start would be refused too."""
    target = desired_transform_tcp_to_base(scenario.settings)
    joints = _reached(scenario, arm, target, "desired TCP position", DESIRED)
    _check_pose(scenario, arm, joints, "desired TCP position", DESIRED)


def _reached(
    scenario: Scenario, arm: ArmModel, transform_tcp_to_base: NDArray[np.float64], pose: str, field: str
) -> NDArray[np.float64]:
    preferred = np.array(scenario.settings.cell.preferred_joint_position_rad)
    found = kinematics(arm.name).nearest(transform_tcp_to_base, preferred)
    if found is None:
        raise InadmissibleError(
            place=scenario.place(field),
            expected=f"a {pose} that the arm can reach within its joint limits",
            got=f"the position {_millimetres(transform_tcp_to_base[:3, 3])}, which has no inverse kinematics",
        )
    return found


def _check_pose(
    scenario: Scenario, arm: ArmModel, joint_position_rad: NDArray[np.float64], pose: str, field: str
) -> None:
    settings = scenario.settings
    transforms, jacobian = links_in_base(arm, joint_position_rad), np.empty((6, len(arm.joint_names)))
    geometric_jacobian(arm.joint_axes, transforms, jacobian)
    least, most = smallest_singular_value(jacobian), settings.motion.min_singular_value
    if not least > most:
        raise InadmissibleError(
            place=scenario.place(field, "settings.motion.min singular value"),
            expected=f"a {pose} away from singularities (least singular value above {most:g})",
            got=f"{least:.4f}",
        )
    clearance_m = settings.avoidance.table_clearance_m
    if transforms[-1, 2, 3] < settings.cell.table_height_m + clearance_m:
        raise InadmissibleError(
            place=scenario.place(field, "settings.cell.table height", "settings.avoidance.table clearance"),
            expected=f"a {pose} at least {clearance_m * 1e3:.0f} mm above the table",
            got=f"the position {_millimetres(transforms[-1, :3, 3])}",
        )
    moments = np.empty(MOMENT_COUNT)
    camera, polygon_in_base_m = SensorRecords(camera_state(settings).copy()), object_polygon_in_base(settings)
    if not exact_object(camera, polygon_in_base_m, transforms[-1], moments):
        raise InadmissibleError(
            place=scenario.place(field, *VIEW),
            expected=f"a {pose} with the whole object in the camera's view",
            got=f"the position {_millimetres(transforms[-1, :3, 3])}, from which it is not",
            hint=_above(settings) if field == DESIRED else "",
        )


def _above(settings: Settings) -> str:
    """The desired TCP position whose camera is right above the object, as high as now."""
    cell = settings.cell
    mount_in_base_m = DOWN @ np.array(settings.camera.mount_offset_in_tcp_m)
    place_m = np.array(settings.object.position_in_base_m) - mount_in_base_m
    place_m[2] = cell.desired_tcp_position_in_base_m[2]
    x, y, z = (round(value * 1e3) for value in place_m)
    return (
        f"the camera is right above it with settings: {{cell: {{desired tcp position: "
        f"[{x} mm, {y} mm, {z} mm]}}}}"
    )


def _millimetres(position_m: NDArray[np.float64]) -> str:
    return "(" + ", ".join(str(round(value * 1e3)) for value in position_m) + ") mm"
