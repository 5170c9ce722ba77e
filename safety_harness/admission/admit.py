"""Admission: resolve a scenario's references and refuse what cannot be tried, before anything runs."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from safety_harness.admission.avoiders import avoider_of
from safety_harness.admission.claims import property_of
from safety_harness.avoidance.avoider import Avoider
from safety_harness.avoidance.gate import Gate
from safety_harness.controller.controller import AvoidingServo
from safety_harness.controller.desired import desired_transform_tcp_to_base, view_of
from safety_harness.controller.records import overhead_transform_sensor_to_base
from safety_harness.exceptions import InadmissibleError, SettingsError
from safety_harness.geometry.rotations import rotation_from_vector
from safety_harness.perception.moments import MOMENT_COUNT
from safety_harness.properties.base import Property
from safety_harness.robot.description import ArmModel, load_arm
from safety_harness.robot.inverse import InverseKinematics
from safety_harness.robot.kinematics import (
    forward_kinematics,
    geometric_jacobian,
    smallest_singular_value,
)
from safety_harness.scenario.model import JointStart, MovingHand, Scenario
from safety_harness.servoing.control import DesiredView
from safety_harness.settings import HandSensorKind
from safety_harness.simulation.cameras import sensors
from safety_harness.simulation.exact_views import exact_object

ARM_NAME = "ur10"


@lru_cache
def kinematics(arm_name: str = ARM_NAME) -> InverseKinematics:
    """The arm's inverse kinematics, built once a process."""
    return InverseKinematics(load_arm(arm_name))


@dataclass(frozen=True, eq=False)
class Admitted:
    """A scenario with everything resolved: ready to be run and judged."""

    scenario: Scenario
    arm: ArmModel
    view: DesiredView
    joint_position_rad: NDArray[np.float64]  # (6,) where the arm starts
    avoider: Avoider
    properties: tuple[Property, ...]  # in the order of the scenario's claims

    def controller(self) -> AvoidingServo:
        """A fresh controller for one run."""
        settings = self.scenario.settings
        gate = Gate.of(settings, kinematics(self.arm.name))
        return AvoidingServo(settings, self.arm, self.view, self.avoider, gate, self.scenario.seed)


def admit(scenario: Scenario, *, avoider: Avoider | None = None) -> Admitted:
    """Resolve and check; InadmissibleError names the place, what was expected and what came.

    ``avoider`` takes the place of the one that the scenario names.
    """
    arm = load_arm(ARM_NAME)
    try:
        view = view_of(scenario.settings)
        start = start_joint_position(scenario, arm)
        check_start(scenario, arm, start)
    except SettingsError as error:
        raise InadmissibleError(
            place=scenario.place(error.place.field or "settings"),
            expected=error.expected,
            got=error.got,
            hint=error.hint,
        ) from error
    check_hands(scenario)
    check_restart_delay(scenario)
    check_hand_sensor(scenario)
    properties = tuple(property_of(claim, scenario) for claim in scenario.claims)
    if avoider is None:
        avoider = avoider_of(scenario)
    return Admitted(scenario, arm, view, start, avoider, properties)


def start_joint_position(scenario: Scenario, arm: ArmModel) -> NDArray[np.float64]:
    """The joint angles of the TCP start: given, or by inverse kinematics on the preferred branch."""
    start = scenario.start
    if isinstance(start, JointStart):
        joints = np.array(start.joint_position_rad)
        outside = (joints < arm.position_lower_rad) | (joints > arm.position_upper_rad)
        if outside.any():
            worst = int(np.argmax(outside))
            raise InadmissibleError(
                place=scenario.place("tcp start"),
                expected=f"{arm.joint_names[worst]} between {np.degrees(arm.position_lower_rad[worst]):.0f} "
                f"and {np.degrees(arm.position_upper_rad[worst]):.0f} deg",
                got=f"{np.degrees(joints[worst]):.1f} deg",
            )
        return joints
    target = desired_transform_tcp_to_base(scenario.settings)
    target[:3, 3] += start.offset_in_base_m
    target[:3, :3] = target[:3, :3] @ rotation_from_vector(np.array(start.tilt_in_tcp_rad))
    preferred = np.array(scenario.settings.cell.preferred_joint_position_rad)
    found = kinematics(arm.name).nearest(target, preferred)
    if found is None:
        raise InadmissibleError(
            place=scenario.place("tcp start"),
            expected="a TCP start that the arm can reach within its joint limits",
            got=f"the position {_millimetres(target[:3, 3])}, which has no inverse kinematics",
        )
    return found


def check_start(scenario: Scenario, arm: ArmModel, joint_position_rad: NDArray[np.float64]) -> None:
    """Refuse a start that is singular, below the table's clearance, or without the object in view."""
    settings = scenario.settings
    transforms, jacobian = np.empty((8, 4, 4)), np.empty((6, 6))
    forward_kinematics(arm.joint_origins, arm.joint_axes, arm.flange, joint_position_rad, transforms)
    geometric_jacobian(arm.joint_axes, transforms, jacobian)
    least = smallest_singular_value(jacobian)
    if not least > settings.motion.min_singular_value:
        raise InadmissibleError(
            place=scenario.place("tcp start"),
            expected=f"a TCP start away from singularities (least singular value above "
            f"{settings.motion.min_singular_value:g})",
            got=f"{least:.4f}",
        )
    lowest_m = settings.cell.table_height_m + settings.avoidance.table_clearance_m
    if transforms[7, 2, 3] < lowest_m:
        raise InadmissibleError(
            place=scenario.place("tcp start"),
            expected="a TCP start at least "
            f"{settings.avoidance.table_clearance_m * 1e3:.0f} mm above the table",
            got=f"the position {_millimetres(transforms[7, :3, 3])}",
        )
    cameras = sensors(settings, scenario.seed, 0, overhead_transform_sensor_to_base(settings))
    moments = np.empty(MOMENT_COUNT)
    if not exact_object(cameras.state, cameras.polygon_in_base_m, transforms[7], moments):
        raise InadmissibleError(
            place=scenario.place("tcp start"),
            expected="a TCP start with the whole object in the camera's view",
            got=f"the position {_millimetres(transforms[7, :3, 3])}, from which it is not",
        )


def check_hands(scenario: Scenario) -> None:
    """Refuse a hand that begins inside the table, which no scenario means."""
    settings = scenario.settings
    for number, hand in enumerate(scenario.hands):
        if isinstance(hand, MovingHand):
            height_m = hand.starts_at_in_base_m[2]
            if height_m < settings.cell.table_height_m:
                raise InadmissibleError(
                    place=scenario.place(f"hands[{number}].starts at"),
                    expected=f"a start above the table (z = {settings.cell.table_height_m * 1e3:.0f} mm)",
                    got=f"z = {height_m * 1e3:.0f} mm",
                )


def check_restart_delay(scenario: Scenario) -> None:
    """Refuse a restart before the longest stop is over: the drives would take up a command in one jump."""
    settings = scenario.settings
    braking = settings.braking
    speed_mps = max(settings.motion.max_tcp_speed_mps, settings.avoidance.repulsion_speed_mps)
    stop_s = braking.reaction_time_s + braking.stop_time_base_s + braking.stop_time_per_speed_s2pm * speed_mps
    if settings.avoidance.restart_delay_s < stop_s:
        raise InadmissibleError(
            place=scenario.place("settings.avoidance.restart delay"),
            expected=f"a restart delay of at least {stop_s:.3f} s, which a stop from full speed takes",
            got=f"{settings.avoidance.restart_delay_s:g} s",
        )


def check_hand_sensor(scenario: Scenario) -> None:
    """Refuse an eye-in-hand sensor with optics of its own: it is the servoing camera."""
    camera, sensor = scenario.settings.camera, scenario.settings.hand_sensor
    if sensor.kind is not HandSensorKind.EYE_IN_HAND:
        return
    for name in ("width_px", "height_px", "focal_px"):
        if getattr(camera, name) != getattr(sensor, name):
            raise InadmissibleError(
                place=scenario.place("hand sensor"),
                expected=f"an eye-in-hand sensor with the camera's {name}, {getattr(camera, name):g}",
                got=f"{getattr(sensor, name):g}",
            )


def _millimetres(position_m: NDArray[np.float64]) -> str:
    return "(" + ", ".join(f"{value * 1e3:.0f}" for value in position_m) + ") mm"
