"""Check that servoing works at the start pose and at the desired pose of the TCP."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.elementary import product
from safety_harness.base.exceptions import InadmissibleError
from safety_harness.base.geometry.arrays import ArrayN
from safety_harness.base.geometry.rotations import rotation_from_vector
from safety_harness.base.settings import DEFAULTS, Settings
from safety_harness.cell.controller.desired import LOOKING_DOWN, desired_transform_tcp_to_base
from safety_harness.cell.perception.moments import MOMENT_COUNT
from safety_harness.cell.robot.description import ArmModel
from safety_harness.cell.robot.dynamics import holding_torques
from safety_harness.cell.robot.kinematics import geometric_jacobian, links_in_base, smallest_singular_value
from safety_harness.cell.robot.obstacles import box_records, distance_from
from safety_harness.cell.robot.robots import arm_capsules, drive_model, inverse_kinematics
from safety_harness.cell.simulation.cameras import SensorRecords, camera_state, object_polygon_in_base
from safety_harness.cell.simulation.exact_views import exact_object
from safety_harness.cell.simulation.truth import cell_capsules
from safety_harness.scenario.faults import Joint, JointStuck
from safety_harness.scenario.model import JointStart, PoseStart, Scenario
from safety_harness.scenario.robots import OwnRobot

START, DESIRED = "tcp start", "settings.cell.desired tcp position"
POSTURE = "settings.cell.preferred joint position"
# Further keys that may put the object out of view.
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


def checked_start(scenario: Scenario, arm: ArmModel, *, sees_object: bool = True) -> NDArray[np.float64]:
    """Return the joint angles of the start, after checking that the arm can work from there.

    The start must not be singular or too near to the table.  If ``sees_object`` is true, the object must be
    in view.
    """
    joints = start_joint_position(scenario, arm)
    _check_pose(scenario, arm, joints, "TCP start", START)
    if sees_object:
        _check_in_view(scenario, arm, joints, "TCP start", START)
    return joints


def start_joint_position(scenario: Scenario, arm: ArmModel) -> NDArray[np.float64]:
    """Return the joint angles of the start, which the scenario states or the inverse kinematics computes.

    The inverse kinematics prefers the branch near the preferred joint angles.
    """
    start = scenario.start
    if isinstance(start, JointStart):
        joints = np.array(start.joint_position_rad)
        _refuse_other_count(scenario, arm, len(joints), START)
        outside = (joints < arm.position_lower_rad) | (joints > arm.position_upper_rad)
        if outside.any():
            worst = int(np.argmax(outside))
            expected = (
                f"{arm.joint_names[worst]} between {np.degrees(arm.position_lower_rad[worst]):.0f} "
                f"and {np.degrees(arm.position_upper_rad[worst]):.0f} deg"
            )
            raise scenario.inadmissible(expected, f"{np.degrees(joints[worst]):.1f} deg", START)
        return joints
    target = desired_transform_tcp_to_base(scenario.settings)
    if isinstance(start, PoseStart):
        target[:3, 3] = start.position_in_base_m
    else:
        target[:3, 3] += start.offset_in_base_m
    target[:3, :3] = product(target[:3, :3], rotation_from_vector(np.array(start.tilt_in_tcp_rad)))
    return _reached(scenario, target, "TCP start", START)


def check_desired(scenario: Scenario, arm: ArmModel) -> None:
    """Refuse a desired pose that the arm cannot reach, or that the checks would refuse as a start."""
    target = desired_transform_tcp_to_base(scenario.settings)
    joints = _reached(scenario, target, "desired TCP position", DESIRED)
    _check_pose(scenario, arm, joints, "desired TCP position", DESIRED)
    _check_in_view(scenario, arm, joints, "desired TCP position", DESIRED)


def check_posture(scenario: Scenario, arm: ArmModel) -> None:
    """Refuse a preferred joint position that belongs to another arm.

    A position belongs to another arm if its number of angles is wrong, or if the arm is the user's own and
    the position is the default.
    """
    given = scenario.settings.cell.preferred_joint_position_rad
    if isinstance(scenario.robot, OwnRobot) and given == DEFAULTS.cell.preferred_joint_position_rad:
        ends = np.clip([arm.position_lower_rad, arm.position_upper_rad], -np.pi, np.pi)
        middle = ", ".join(f"{angle:.0f} deg" for angle in np.degrees(ends.mean(axis=0)))
        expected = "the joint angles near which your arm works"
        hint = f"settings: {{cell: {{preferred joint position: [...]}}}}; the middle is [{middle}]"
        raise scenario.inadmissible(expected, "none", POSTURE, "robot", hint=hint)
    _refuse_other_count(scenario, arm, len(given), POSTURE)


def check_stuck_joints(scenario: Scenario, arm: ArmModel) -> None:
    """Refuse a fault that blocks a joint which the arm does not have."""
    for number, fault in enumerate(scenario.faults):
        if isinstance(fault, JointStuck) and list(Joint).index(fault.joint) >= len(arm.joint_names):
            expected = f"one of the {len(arm.joint_names)} joints of the arm, counted from its foot"
            raise scenario.inadmissible(expected, fault.joint.value, f"faults[{number}]", "faults")


def check_obstacles(scenario: Scenario, arm: ArmModel, joint_position_rad: ArrayN) -> None:
    """Refuse an obstacle that touches the arm at its start."""
    for number, obstacle in enumerate(scenario.obstacles):
        capsules = cell_capsules(arm_capsules(scenario.robot), scenario.settings)
        distance_m = distance_from(box_records((obstacle,)), arm, capsules, joint_position_rad)
        if not distance_m > 0.0:
            expected = "an obstacle apart from the arm at its start"
            got = f"one {1e3 * distance_m:.0f} mm away"
            raise scenario.inadmissible(expected, got, f"obstacles[{number}]", "obstacles")


def check_drives(scenario: Scenario, arm: ArmModel, joint_position_rad: ArrayN) -> None:
    """Refuse drives that are too weak to hold the arm still at its start."""
    model = drive_model(scenario.robot)
    if model is None or model.masses is None or model.torque_limit_nm is None:
        return
    held_nm = np.abs(holding_torques(arm, model.masses, joint_position_rad))
    worst = int(np.argmax(held_nm / model.torque_limit_nm))
    if held_nm[worst] > model.torque_limit_nm[worst]:
        raise InadmissibleError(
            place=scenario.place("robot.drives.payload", "robot.drives.torque limit", "robot"),
            expected=f"drives that hold the arm where it starts: {held_nm[worst]:.3g} N m at "
            f"{arm.joint_names[worst]}",
            got=f"at most {model.torque_limit_nm[worst]:.3g} N m",
        )


def _refuse_other_count(scenario: Scenario, arm: ArmModel, count: int, field: str) -> None:
    """Refuse a list of ``count`` joint angles if the arm has another number of joints."""
    if count != len(arm.joint_names):
        expected = f"{len(arm.joint_names)} angles, of {', '.join(arm.joint_names)}"
        raise scenario.inadmissible(expected, f"{count}", field, "robot")


def _reached(
    scenario: Scenario, transform_tcp_to_base: NDArray[np.float64], pose: str, field: str
) -> NDArray[np.float64]:
    """Return the joint angles of a pose, as near as possible to the preferred angles.

    Raise InadmissibleError if the arm cannot reach the pose.
    """
    preferred = np.array(scenario.settings.cell.preferred_joint_position_rad)
    joints = inverse_kinematics(scenario.robot).nearest(transform_tcp_to_base, preferred)
    if joints is None:
        expected = f"a {pose} that the arm can reach within its joint limits"
        got = f"the position {_millimetres(transform_tcp_to_base[:3, 3])}, which has no inverse kinematics"
        raise scenario.inadmissible(expected, got, field)
    return joints


def _check_pose(
    scenario: Scenario, arm: ArmModel, joint_position_rad: NDArray[np.float64], pose: str, field: str
) -> None:
    """Refuse a pose that is singular, or too near to the table."""
    settings = scenario.settings
    transforms, jacobian = links_in_base(arm, joint_position_rad), np.empty((6, len(arm.joint_names)))
    geometric_jacobian(arm.joint_axes, transforms, jacobian)
    least, most = smallest_singular_value(jacobian), settings.motion.min_singular_value
    if not least > most:
        expected = f"a {pose} away from singularities (least singular value above {most:g})"
        raise scenario.inadmissible(expected, f"{least:.4f}", field, "settings.motion.min singular value")
    clearance_m = settings.avoidance.table_clearance_m
    if transforms[-1, 2, 3] < settings.cell.table_height_m + clearance_m:
        raise InadmissibleError(
            place=scenario.place(field, "settings.cell.table height", "settings.avoidance.table clearance"),
            expected=f"a {pose} at least {clearance_m * 1e3:.0f} mm above the table",
            got=f"the position {_millimetres(transforms[-1, :3, 3])}",
        )


def _check_in_view(
    scenario: Scenario, arm: ArmModel, joint_position_rad: NDArray[np.float64], pose: str, field: str
) -> None:
    """Refuse a pose from which the camera does not see the whole object."""
    settings, transforms = scenario.settings, links_in_base(arm, joint_position_rad)
    moments = np.empty(MOMENT_COUNT)
    camera, polygon_in_base_m = SensorRecords(camera_state(settings).copy()), object_polygon_in_base(settings)
    if not exact_object(camera, polygon_in_base_m, transforms[-1], moments):
        expected = f"a {pose} with the whole object in the camera's view"
        hint = _above(settings) if field == DESIRED else ""
        got = f"the position {_millimetres(transforms[-1, :3, 3])}, from which it is not"
        raise scenario.inadmissible(expected, got, field, *VIEW, hint=hint)


def _above(settings: Settings) -> str:
    """Return a hint with the desired TCP position that puts the camera right above the object.

    The position has the same height as the present desired position.
    """
    cell = settings.cell
    mount_in_base_m = product(LOOKING_DOWN, np.array(settings.camera.mount_offset_in_tcp_m))
    place_m = np.array(settings.object.position_in_base_m) - mount_in_base_m
    place_m[2] = cell.desired_tcp_position_in_base_m[2]
    x, y, z = (round(value * 1e3) for value in place_m)
    return (
        f"the camera is right above it with settings: {{cell: {{desired tcp position: "
        f"[{x} mm, {y} mm, {z} mm]}}}}"
    )


def _millimetres(position_m: NDArray[np.float64]) -> str:
    """Return a position as text in millimetres."""
    return "(" + ", ".join(str(round(value * 1e3)) for value in position_m) + ") mm"
