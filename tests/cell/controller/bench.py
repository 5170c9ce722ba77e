"""A controller on the bench: it gets observations that a test makes up, and no world is behind it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from examples import scenario, ur10_gate

from safety_harness.admission.admit import admit
from safety_harness.base.geometry.transforms import inverse_transform
from safety_harness.base.settings import DEFAULTS, HandSensorKind, Settings
from safety_harness.cell.avoidance.avoider import Avoider
from safety_harness.cell.avoidance.gate import Gate
from safety_harness.cell.controller.controller import AvoidingServo
from safety_harness.cell.controller.records import observation_dtype, overhead_transform_sensor_to_base
from safety_harness.cell.perception.camera import transform_camera_to_tcp
from safety_harness.cell.perception.hand_boxes import sensor_principal_point_px, sphere_box
from safety_harness.cell.perception.moments import MOMENT_COUNT
from safety_harness.cell.robot.description import ArmModel
from safety_harness.cell.robot.kinematics import TCP
from safety_harness.cell.robot.robots import arm_model, inverse_kinematics
from safety_harness.cell.simulation.cameras import sensors
from safety_harness.cell.simulation.exact_views import exact_object
from safety_harness.scenario.robots import Robot
from safety_harness.trace.records import TICK
from tests.cell.robot.arms import transforms_of

Position = tuple[float, float, float] | np.ndarray
AWAY = (1.2, -0.9, 0.2)


class Bench:
    """``tick`` shows the controller hands and, if not hidden, the object; returns the trace's record.

    The arm stands where ``place`` put it: commands move nothing.
    """

    def __init__(
        self,
        *,
        settings: Settings = DEFAULTS,
        avoider: Avoider | None = None,
        gate: Gate | None = None,
        arm: ArmModel | None = None,
        recorded_late: tuple[str, ...] = (),
        offset: tuple[float, float, float] = (0.04, -0.12, 0.06),
        tilt: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> None:
        admitted = admit(scenario(offset=offset, tilt=tilt, settings=settings))
        self.settings = settings
        self.gate = gate or ur10_gate(settings)
        self.controller = AvoidingServo(
            settings,
            arm or admitted.arm,
            admitted.view,
            avoider or admitted.avoider,
            self.gate,
            1,
            recorded_late,
        )
        self._sensors = sensors(settings, 1, 0, overhead_transform_sensor_to_base(settings))
        self.joints = admitted.joint_position_rad.copy()
        self.velocity = np.zeros(6)
        self.object_seen = True
        self.ticks = 0
        self.command = np.zeros(0)

    @property
    def pose(self) -> np.ndarray:
        """(4, 4) TCP to base."""
        return transforms_of(arm_model(Robot.UR10), self.joints)[TCP].copy()

    @property
    def tcp(self) -> np.ndarray:
        """(3,) in base."""
        return self.pose[:3, 3]

    def beside(self, distance_m: float) -> np.ndarray:
        """A place for a hand at a distance from the TCP, where there is room for it."""
        return self.tcp + distance_m * np.array([0.6, -0.8, 0.0])

    def place(self, position: np.ndarray) -> None:
        """Put the TCP there, its orientation kept."""
        target = self.pose
        target[:3, 3] = position
        found = inverse_kinematics(Robot.UR10).nearest(target, self.joints)
        assert found is not None
        self.joints = found

    def observation(self, hands: tuple[Position, ...]) -> np.ndarray:
        o = np.zeros(1, observation_dtype(2))
        o["time_s"] = o["boxes_time_s"] = self.ticks * self.settings.clock.control_period_s
        o["joint_position_rad"], o["joint_velocity_radps"] = self.joints, self.velocity
        moments = np.full(MOMENT_COUNT, np.nan)
        visible = exact_object(self._sensors.state, self._sensors.polygon_in_base_m, self.pose, moments)
        o["image_new"], o["boxes_new"] = True, True
        o["object_visible"], o["moments"] = visible and self.object_seen, moments
        o["box_count"] = len(hands)
        sensor = self.settings.hand_sensor
        sensor_to_base = overhead_transform_sensor_to_base(self.settings)
        if sensor.kind is HandSensorKind.EYE_IN_HAND:
            sensor_to_base = self.pose @ transform_camera_to_tcp(self.settings.camera, calibrated=False)
        base_to_sensor = inverse_transform(sensor_to_base)
        for box, hand in zip(o["boxes"][0], hands, strict=False):
            centre = base_to_sensor[:3, :3] @ np.asarray(hand) + base_to_sensor[:3, 3]
            radius_m = self.settings.hand.radius_m
            assert sphere_box(centre, radius_m, sensor.focal_px, *sensor_principal_point_px(sensor), box)
        return o

    def tick(self, *hands: Position, count: int = 1) -> np.void:
        """``count`` ticks that look alike; the trace's record of the last one."""
        row = np.zeros(1, TICK)
        for _ in range(count):
            self.command = self.controller.step(self.observation(hands)).copy()
            self.controller.report(row)
            self.ticks += 1
        return row[0]


def with_avoidance(**changes: object) -> Settings:
    return replace(DEFAULTS, avoidance=replace(DEFAULTS.avoidance, **changes))


def with_motion(**changes: object) -> Settings:
    return replace(DEFAULTS, motion=replace(DEFAULTS.motion, **changes))
