"""The reference world: the arm in PyBullet, with its meshes, motors and physics."""

from __future__ import annotations

from types import TracebackType

import numpy as np
from numpy.typing import NDArray

from safety_harness.controller.records import OBSERVATION, overhead_transform_sensor_to_base
from safety_harness.exceptions import SimulationError
from safety_harness.geometry.transforms import compose_into
from safety_harness.perception.detector import BoundingBoxDetector, SkinColourDetector, copy_detections
from safety_harness.perception.moments import MOMENT_COUNT
from safety_harness.perception.tracking import MAX_DETECTIONS
from safety_harness.robot.capsules import load_capsules
from safety_harness.robot.description import ArmModel
from safety_harness.robot.drive import drive, drive_tick
from safety_harness.scenario.fault_table import fault_table
from safety_harness.scenario.model import Scenario
from safety_harness.settings import DetectorKind, ImageSource
from safety_harness.simulation.cameras import sensors
from safety_harness.simulation.cell import build_cell, place_hands
from safety_harness.simulation.engine import pybullet
from safety_harness.simulation.exact_views import exact_boxes, exact_object, sensor_pose
from safety_harness.simulation.faults import (
    hold_joints,
    mount_camera,
    spoil_hand_frame,
    spoil_object_frame,
)
from safety_harness.simulation.hand_motion import advance_hands
from safety_harness.simulation.hand_programs import hands_at_start
from safety_harness.simulation.image_sources import render, rendered_object
from safety_harness.simulation.sensing import (
    deliver,
    hand_frame_due,
    object_frame_due,
    push_hand_frame,
    push_object_frame,
)
from safety_harness.simulation.truth import arm_record, cell_capsules, fill_truth
from safety_harness.trace.records import TICK, TICK_COMPILED


class PyBulletWorld:
    """One scenario in a PyBullet client of its own; use it as a context manager, once.

    The drives follow velocity motors with the torque limits of the URDF; a control period is
    ``physics_substeps`` steps of the engine.  Hands touch nothing: a contact is a distance below
    zero, not a push.
    """

    name = "pybullet"

    def __init__(
        self,
        scenario: Scenario,
        arm: ArmModel,
        joint_position_rad: NDArray[np.float64],
        *,
        detector: BoundingBoxDetector | None = None,
    ) -> None:
        settings = scenario.settings
        self._settings = settings
        self._substeps = settings.clock.physics_substeps
        self._render_object = settings.camera.source is ImageSource.RENDERED
        self._render_hands = settings.hand_sensor.detector is DetectorKind.RENDERED
        self._detector = detector or SkinColourDetector()
        self._hands = hands_at_start(scenario)
        self._sensors = sensors(
            settings, scenario.seed, scenario.ticks, overhead_transform_sensor_to_base(settings)
        )
        self._drive = drive(settings)
        self._faults = fault_table(scenario.faults)
        self._acted_faults = 0
        self._arm = arm_record(arm, settings)
        self._capsules = cell_capsules(load_capsules(arm.name), settings)
        self._placed = np.empty((len(self._capsules.names), 2, 3))
        self._observation = np.zeros(1, OBSERVATION)
        self._truth = np.zeros(1, TICK)
        self._tick = 0
        self._client = int(pybullet.connect(pybullet.DIRECT))
        if self._client < 0:
            raise SimulationError("PyBullet gave no client")
        try:
            self._bodies = build_cell(
                self._client,
                settings,
                arm,
                joint_position_rad,
                rendered=self._render_object or self._render_hands,
            )
            self._robot, self._joints = self._bodies.robot, list(self._bodies.joints)
            self._efforts = [float(effort) for effort in arm.effort_limit]
            self._observe_truth()
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> PyBulletWorld:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Give the client back; a second call does nothing."""
        if self._client >= 0:
            pybullet.disconnect(physicsClientId=self._client)
            self._client = -1

    @property
    def time_s(self) -> float:
        """The start of the coming control tick: a multiple of the period, never a running sum."""
        return self._tick * self._settings.clock.control_period_s

    @property
    def acted_faults(self) -> int:
        """Bits of the scenario's faults that have acted on this tick's pictures and, after it, its step."""
        return self._acted_faults

    def true_state(self, tick: NDArray[np.void]) -> None:
        """Write the truth part of ``tick``; the rest is the controller's to fill."""
        tick[0] = self._truth[0]

    def observe(self) -> NDArray[np.void]:
        """Let the cameras take what is due and deliver what has arrived; encoders are exact."""
        state = self._sensors.state
        time_s = self.time_s
        pose = self._truth[0]["transform_tcp_to_base"]
        self._acted_faults = mount_camera(self._faults, state, time_s)
        if object_frame_due(state, time_s):
            visible, moments = self._object_frame()
            push_object_frame(state, self._sensors.object_frames, time_s, visible, moments)
            self._acted_faults |= spoil_object_frame(
                self._faults,
                state,
                self._sensors.object_frames,
                self._sensors.polygon_in_base_m,
                self._hands.state,
                pose,
                time_s,
            )
        if hand_frame_due(state, time_s):
            boxes, count = self._hand_frame()
            push_hand_frame(
                state,
                self._sensors.hand_frames,
                self._sensors.normals,
                self._sensors.uniforms,
                time_s,
                boxes,
                count,
            )
            self._acted_faults |= spoil_hand_frame(
                self._faults, state, self._sensors.hand_frames, pose, time_s
            )
        deliver(state, self._sensors.object_frames, self._sensors.hand_frames, time_s, self._observation)
        self._observation["joint_position_rad"] = self._truth["joint_position_rad"]
        self._observation["joint_velocity_radps"] = self._truth["joint_velocity_radps"]
        return self._observation

    def step(self, command: NDArray[np.void]) -> bool:
        """Drives, motors and physics for one control period; hands move meanwhile."""
        braking = drive_tick(
            self._drive,
            command[0]["joint_velocity_radps"],
            bool(command[0]["protective_stop"]),
            float(self._truth[0]["tcp_speed_mps"]),
            self.time_s,
        )
        told_radps = self._drive[0]["setpoint_radps"].copy()
        self._acted_faults |= hold_joints(self._faults, told_radps, self.time_s)
        pybullet.setJointMotorControlArray(
            self._robot,
            self._joints,
            pybullet.VELOCITY_CONTROL,
            targetVelocities=told_radps.tolist(),
            forces=self._efforts,
            physicsClientId=self._client,
        )
        for _ in range(self._substeps):
            pybullet.stepSimulation(physicsClientId=self._client)
        advance_hands(
            self._hands.state,
            self._hands.moves,
            self._hands.samples,
            self._truth[0]["transform_tcp_to_base"][:3, 3].copy(),
            self.time_s,
            self._settings.clock.control_period_s,
        )
        self._tick += 1
        self._observe_truth()
        return braking

    def _observe_truth(self) -> None:
        """Read the engine's joints and derive everything else from them, once a tick."""
        states = pybullet.getJointStates(self._robot, self._joints, physicsClientId=self._client)
        capsules = self._capsules
        fill_truth(
            self._arm,
            capsules.link_index,
            capsules.start_in_link,
            capsules.end_in_link,
            capsules.radius_m,
            self._placed,
            self._hands.state,
            np.array([state[0] for state in states]),
            np.array([state[1] for state in states]),
            self.time_s,
            self._truth.view(TICK_COMPILED),
        )

    def _object_frame(self) -> tuple[bool, NDArray[np.float64]]:
        """The object's moments by the image source of the settings."""
        pose = self._truth[0]["transform_tcp_to_base"]
        if self._render_object:
            camera = self._settings.camera
            camera_to_base = np.empty((4, 4))
            compose_into(pose, self._sensors.state[0]["transform_camera_to_tcp"], camera_to_base)
            place_hands(self._client, self._bodies, self._hands.state)
            colour, _ = render(
                self._client, camera_to_base, camera.focal_px, camera.width_px, camera.height_px
            )
            return rendered_object(colour, camera.focal_px)
        moments = np.full(MOMENT_COUNT, np.nan)
        visible = exact_object(self._sensors.state, self._sensors.polygon_in_base_m, pose, moments)
        return visible, moments

    def _hand_frame(self) -> tuple[NDArray[np.float64], int]:
        """Bounding boxes of the hands by the detector of the settings."""
        pose = self._truth[0]["transform_tcp_to_base"]
        boxes = np.zeros((MAX_DETECTIONS, 5))
        if self._render_hands:
            hand_sensor = self._settings.hand_sensor
            sensor_to_base = np.empty((4, 4))
            sensor_pose(self._sensors.state, pose, sensor_to_base)
            place_hands(self._client, self._bodies, self._hands.state)
            colour, depth_m = render(
                self._client,
                sensor_to_base,
                hand_sensor.focal_px,
                hand_sensor.width_px,
                hand_sensor.height_px,
            )
            return boxes, copy_detections(self._detector.detect(colour, depth_m), boxes)
        count = exact_boxes(
            self._sensors.state, self._hands.state, pose, self._placed, self._capsules.radius_m, boxes
        )
        return boxes, count
