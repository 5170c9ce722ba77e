"""Simulate the reference world: the arm in PyBullet, with its meshes, motors and physics."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.exceptions import SimulationError
from safety_harness.base.geometry.arrays import ArrayN
from safety_harness.base.geometry.transforms import compose_into
from safety_harness.base.settings import DetectorKind, ImageSource
from safety_harness.cell.controller.records import CommandRecords
from safety_harness.cell.perception.detector import BoundingBoxDetector, SkinColourDetector, copy_detections
from safety_harness.cell.perception.moments import MOMENT_COUNT
from safety_harness.cell.robot.description import ArmModel
from safety_harness.cell.simulation.cameras import RING
from safety_harness.cell.simulation.cell import build_cell, place_hands, render, rendered_object
from safety_harness.cell.simulation.engine import pybullet
from safety_harness.cell.simulation.exact_views import exact_boxes, exact_object, sensor_pose
from safety_harness.cell.simulation.steps import (
    drive_on,
    hand_frame_due,
    hand_over,
    mount,
    move_on,
    now_s,
    object_frame_due,
    send_hand_frame,
    send_object_frame,
)
from safety_harness.cell.simulation.world import AMPLE, RecordedWorld, overshoot_radps
from safety_harness.scenario.fault_table import acting
from safety_harness.scenario.faults import FaultKind
from safety_harness.scenario.model import Scenario
from safety_harness.seams.contract import Image
from safety_harness.trace.records import as_compiled
from safety_harness.trace.trace import Trace


class PyBulletWorld(RecordedWorld):
    """A scenario in its own PyBullet client.

    The object is a context manager for a single use. The set points of the drives go to velocity motors with
    the torque limits of the URDF. A control period has ``physics_substeps`` steps of the engine. Hands do not
    push other bodies. A contact is only a distance less than zero.
    """

    name, renders = "pybullet", True

    def __init__(
        self,
        scenario: Scenario,
        arm: ArmModel,
        joint_position_rad: ArrayN,
        *,
        detector: BoundingBoxDetector | None = None,
    ) -> None:
        super().__init__(scenario, arm, joint_position_rad)
        self._settings = settings = scenario.settings
        self._substeps = settings.clock.physics_substeps
        self._render_object = settings.camera.source is ImageSource.RENDERED
        self._render_hands = settings.hand_sensor.detector is DetectorKind.RENDERED
        self._detector = detector or SkinColourDetector(self.records.observation["boxes"].shape[1])
        self._commanded_radps = np.empty(len(arm.joint_names))
        self.overshoot_radps = np.zeros((scenario.ticks + 1, len(arm.joint_names)))  # for the trace
        self._pictures: dict[int, NDArray[np.uint8]] = {}  # images of the object, by the number of the frame
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
                hands=len(self.records.hands),
            )
            self._robot, self._joints = self._bodies.robot, list(self._bodies.joints)
            # The model of the drives limits their torque, so the engine must not limit it a second time.
            more = AMPLE if self.records.drives[0]["limited"] else 1.0
            self._efforts = [more * float(effort) for effort in arm.effort_limit]
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Disconnect the client.

        A second call has no effect.
        """
        if self._client >= 0:
            pybullet.disconnect(physicsClientId=self._client)
            self._client = -1

    def observe(self) -> NDArray[np.void]:
        """Let the cameras take each frame that is due, and deliver each frame that has arrived.

        Encoders are exact.
        """
        r = self.records
        if not (self._render_object or self._render_hands):
            return super().observe()
        faulty_sensors = r.clock, r.faults, r.sensors
        mount(*faulty_sensors)
        if object_frame_due(r.clock, r.sensors):
            colour = self._picture() if self._render_object else None
            visible, moments = self._object(colour)
            frames, polygon_in_base_m = r.object_frames, r.polygon_in_base_m
            send_object_frame(r.truth, r.hands, *faulty_sensors, frames, polygon_in_base_m, visible, moments)
            if colour is not None:
                self._keep(colour)
        if hand_frame_due(r.clock, r.sensors):
            boxes, count = self._boxes()
            send_hand_frame(r.truth, *faulty_sensors, r.hand_frames, r.normals, r.uniforms, boxes, count)
        hand_over(r.truth, r.clock, r.observation, r.sensors, r.object_frames, r.hand_frames)
        return r.observation

    def step(self, command: NDArray[np.void]) -> bool:
        """Run drives, motors and physics for a control period, and move the hands.

        ``command`` (1,) is a record COMMAND. Return True while the brakes act.
        """
        r = self.records
        braking = drive_on(
            r.drives, r.arm, r.truth, r.clock, r.faults, CommandRecords(command), self._commanded_radps
        )
        pybullet.setJointMotorControlArray(
            self._robot,
            self._joints,
            pybullet.VELOCITY_CONTROL,
            targetVelocities=self._commanded_radps.tolist(),
            forces=self._efforts,
            physicsClientId=self._client,
        )
        # Copied now, because ``move_on`` overwrites the truth.
        before_radps, tick = r.truth[0]["joint_velocity_radps"].copy(), int(r.clock[0]["tick"])
        speeds_radps: list[list[float]] = []
        for _ in range(self._substeps):
            pybullet.stepSimulation(physicsClientId=self._client)
            states = pybullet.getJointStates(self._robot, self._joints, physicsClientId=self._client)
            speeds_radps.append([state[1] for state in states])
        own_radps = np.array(speeds_radps)  # (sub-steps, joints)
        move_on(*r[1:9], np.array([state[0] for state in states]), own_radps[-1])
        self.overshoot_radps[tick] = overshoot_radps(before_radps, own_radps)
        return braking

    def image(self) -> Image:
        """Return the last rendered image of the object that the camera has delivered."""
        r = self.records
        number = int(r.sensors[0]["object_delivered"]) - 1
        if number < 0:
            camera = self._settings.camera
            return Image(time_s=np.nan, new=False, pixels=_black((camera.height_px, camera.width_px, 3)))
        time_s, new = r.object_frames[number % RING]["time_s"], r.observation[0]["image_new"]
        return Image(time_s=float(time_s), new=bool(new), pixels=self._pictures[number])

    def images_of(self, trace: Trace) -> Iterator[Image]:
        """Yield the images of the object's camera in a run of this scenario.

        The method renders them at the recorded poses of arm and hands.
        """
        self._render_hands = False  # these images need no boxes of hands
        r, robot = self.records, (self._robot, self._joints)
        for number, tick in enumerate(as_compiled(trace.ticks)):
            r.truth[0], r.clock[0]["tick"] = tick, number
            r.hands["position_in_base_m"] = tick["hand_position_in_base_m"]
            r.hands["elbow_in_base_m"] = tick["elbow_position_in_base_m"]
            joints = [[q] for q in tick["joint_position_rad"]]
            pybullet.resetJointStatesMultiDof(*robot, joints, physicsClientId=self._client)
            if self.observe()[0]["image_new"]:
                yield self.image()

    def _keep(self, colour: NDArray[np.uint8]) -> None:
        """Store the newest frame's pixels, with the faults of the camera applied.

        A frozen camera repeats the previous frame. ``colour`` has the shape (height, width, 3).
        """
        r, time_s = self.records, now_s(self.records.clock)
        newest = int(r.sensors[0]["object_frames"]) - 1
        # The same order as in ``spoil_object_frame``, so that pixels and moments agree.
        if acting(r.faults, FaultKind.CAMERA_BLIND, time_s):
            colour = _black(colour.shape)
        if acting(r.faults, FaultKind.CAMERA_FROZEN, time_s):
            colour = self._pictures.get(newest - 1, _black(colour.shape))
        colour.setflags(write=False)
        # ``image`` needs the last delivered frame, and a frozen camera the frame before the newest.
        oldest = min(int(r.sensors[0]["object_delivered"]), newest) - 1
        self._pictures = {k: pixels for k, pixels in self._pictures.items() if k >= oldest} | {newest: colour}

    def _picture(self) -> NDArray[np.uint8]:
        """Return the rendered image (height, width, 3) of the object's camera."""
        camera, r = self._settings.camera, self.records
        pose, camera_to_base = r.truth[0]["transform_tcp_to_base"], np.empty((4, 4))
        compose_into(pose, r.sensors[0]["transform_camera_to_tcp"], camera_to_base)
        place_hands(self._client, self._bodies, r.hands)
        colour, _ = render(self._client, camera_to_base, camera.focal_px, camera.width_px, camera.height_px)
        return colour

    def _object(self, colour: NDArray[np.uint8] | None) -> tuple[bool, NDArray[np.float64]]:
        """Return whether the object is in view, and the object's moments.

        The two results come from a rendered image or from an exact view. ``colour`` has the shape (height,
        width, 3), and is None for an exact view.
        """
        r = self.records
        if colour is not None:
            return rendered_object(colour, self._settings.camera.focal_px)
        pose, moments = r.truth[0]["transform_tcp_to_base"], np.full(MOMENT_COUNT, np.nan)
        return exact_object(r.sensors, r.polygon_in_base_m, pose, moments), moments

    def _boxes(self) -> tuple[NDArray[np.float64], int]:
        """Return the bounding boxes of the hands, and their number.

        The boxes come from a rendered image or from an exact view.
        """
        sensor, r = self._settings.hand_sensor, self.records
        pose = r.truth[0]["transform_tcp_to_base"]
        boxes = np.zeros_like(r.observation["boxes"][0])
        if not self._render_hands:
            ends = r.capsule_endpoints_in_base_m
            return boxes, exact_boxes(r.sensors, r.hands, pose, r.capsules, ends, boxes)
        sensor_to_base = sensor_pose(r.sensors, pose)
        place_hands(self._client, self._bodies, r.hands)
        colour, depth_m = render(
            self._client, sensor_to_base, sensor.focal_px, sensor.width_px, sensor.height_px
        )
        return boxes, copy_detections(self._detector.detect(colour, depth_m), boxes)


def _black(shape: tuple[int, ...]) -> NDArray[np.uint8]:
    """Return a read-only black image."""
    pixels = np.zeros(shape, np.uint8)
    pixels.setflags(write=False)
    return pixels
