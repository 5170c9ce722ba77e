"""The records of one episode's world: all of it but what moves the arm, which is each world's own."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from safety_harness.controller.records import OBSERVATION, overhead_transform_sensor_to_base
from safety_harness.robot.capsules import load_capsules
from safety_harness.robot.description import ArmModel
from safety_harness.robot.drive import drive
from safety_harness.scenario.fault_table import fault_table
from safety_harness.scenario.model import Scenario
from safety_harness.simulation.cameras import sensors
from safety_harness.simulation.hand_programs import hands_at_start
from safety_harness.simulation.truth import arm_record, cell_capsules, fill_truth
from safety_harness.trace.records import TICK_COMPILED

Records = NDArray[np.void]
Floats = NDArray[np.float64]

CLOCK = np.dtype(
    [
        ("tick", np.int64),
        ("control_period_s", np.float64),
        ("acted_faults", np.int64),  # bits, since the last observation was asked for
        # what a step works with
        ("tcp_in_base_m", np.float64, (3,)),  # before it
        ("commanded_radps", np.float64, (6,)),  # the motors
        ("joint_position_rad", np.float64, (6,)),  # after it
    ],
    align=True,
)


class WorldRecords(NamedTuple):
    """One episode's hands, cameras, drives and faults, and the truth of now."""

    clock: Records  # (1,) CLOCK
    arm: Records  # (1,) ARM
    capsule_link: NDArray[np.int64]  # (n,)
    capsule_start_in_link: Floats  # (n, 3)
    capsule_end_in_link: Floats  # (n, 3)
    capsule_radius_m: Floats  # (n,)
    placed: Floats  # (n, 2, 3)
    hands: Records  # (MAX_HANDS,) HAND
    moves: Records  # (m,) MOVE
    samples: Floats  # (s, 7)
    sensors: Records  # (1,) SENSORS
    object_frames: Records  # (RING,) OBJECT_FRAME
    hand_frames: Records  # (RING,) HAND_FRAME
    polygon_in_base_m: Floats  # (m, 3)
    normals: Floats  # (frames, MAX_DETECTIONS, 3)
    uniforms: Floats  # (frames, MAX_DETECTIONS)
    drives: Records  # (1,) DRIVE
    faults: Records  # (n,) FAULT
    observation: Records  # (1,) OBSERVATION
    truth: Records  # (1,) TICK_COMPILED

    @property
    def for_sense(self) -> Any:
        """What ``sense`` takes."""
        return (
            self.clock,
            self.sensors,
            self.object_frames,
            self.hand_frames,
            self.polygon_in_base_m,
            self.normals,
            self.uniforms,
            self.hands,
            self.placed,
            self.capsule_radius_m,
            self.faults,
            self.truth,
            self.observation,
        )

    @property
    def for_object_frame(self) -> Any:
        """What ``exact_object_frame`` takes, and ``send_object_frame`` before the picture."""
        return (
            self.clock,
            self.sensors,
            self.object_frames,
            self.polygon_in_base_m,
            self.hands,
            self.faults,
            self.truth,
        )

    @property
    def for_hand_frame(self) -> Any:
        """What ``send_hand_frame`` takes before the boxes."""
        return (
            self.clock,
            self.sensors,
            self.hand_frames,
            self.normals,
            self.uniforms,
            self.faults,
            self.truth,
        )

    @property
    def for_exact_hand_frame(self) -> Any:
        """What ``exact_hand_frame`` takes."""
        shapes = (self.hands, self.placed, self.capsule_radius_m)
        return (*self.for_hand_frame[:5], *shapes, self.faults, self.truth)

    @property
    def for_hand_over(self) -> Any:
        """What ``hand_over`` takes."""
        frames = (self.object_frames, self.hand_frames)
        return (self.clock, self.sensors, *frames, self.truth, self.observation)

    @property
    def for_drives(self) -> Any:
        """What ``drive_on`` takes before the command."""
        return (self.clock, self.drives, self.faults, self.truth)

    @property
    def for_truth(self) -> Any:
        """What ``fill_truth`` takes before the hands."""
        return (
            self.arm,
            self.capsule_link,
            self.capsule_start_in_link,
            self.capsule_end_in_link,
            self.capsule_radius_m,
            self.placed,
        )

    @property
    def for_motion(self) -> Any:
        """What ``move_on`` takes before the joints."""
        return (self.clock, self.hands, self.moves, self.samples, *self.for_truth, self.truth)


def world_records(scenario: Scenario, arm: ArmModel, joint_position_rad: NDArray[np.float64]) -> WorldRecords:
    """As the scenario begins, the arm at rest at the joint position (6,)."""
    settings = scenario.settings
    clock = np.zeros(1, CLOCK)
    clock["control_period_s"] = settings.clock.control_period_s
    capsules = cell_capsules(load_capsules(arm.name), settings)
    hands = hands_at_start(scenario)
    cameras = sensors(settings, scenario.seed, scenario.ticks, overhead_transform_sensor_to_base(settings))
    records = WorldRecords(
        clock=clock,
        arm=arm_record(arm, settings),
        capsule_link=capsules.link_index,
        capsule_start_in_link=capsules.start_in_link,
        capsule_end_in_link=capsules.end_in_link,
        capsule_radius_m=capsules.radius_m,
        placed=np.empty((len(capsules.names), 2, 3)),
        hands=hands.state,
        moves=hands.moves,
        samples=hands.samples,
        sensors=cameras.state,
        object_frames=cameras.object_frames,
        hand_frames=cameras.hand_frames,
        polygon_in_base_m=cameras.polygon_in_base_m,
        normals=cameras.normals,
        uniforms=cameras.uniforms,
        drives=drive(settings),
        faults=fault_table(scenario.faults),
        observation=np.zeros(1, OBSERVATION),
        truth=np.zeros(1, TICK_COMPILED),
    )
    joints = np.array(joint_position_rad, dtype=np.float64)
    fill_truth(*(records.for_truth + (records.hands, joints, np.zeros(6), 0.0, records.truth)))
    return records
