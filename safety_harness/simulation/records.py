"""The records of one episode's world: all of it but what moves the arm, which is each world's own."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from safety_harness.controller.records import (
    OBSERVATION,
    FaultRecords,
    ObservationRecords,
    overhead_transform_sensor_to_base,
)
from safety_harness.robot.capsules import load_capsules
from safety_harness.robot.description import ArmModel
from safety_harness.robot.drive import drive
from safety_harness.scenario.fault_table import fault_table
from safety_harness.scenario.model import Scenario
from safety_harness.simulation.cameras import sensors
from safety_harness.simulation.hand_programs import hands_at_start
from safety_harness.simulation.steps import (
    ArmRecords,
    CapsuleRecords,
    ClockRecords,
    DriveRecords,
    Floats,
    HandFrames,
    HandRecords,
    MoveRecords,
    ObjectFrames,
    SensorRecords,
    TruthRecords,
    sense,
)
from safety_harness.simulation.truth import arm_record, cell_capsules, fill_truth
from safety_harness.trace.records import TICK_COMPILED

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

    clock: ClockRecords  # (1,) CLOCK
    arm: ArmRecords  # (1,) ARM
    capsules: CapsuleRecords  # (n,) CAPSULE
    capsule_endpoints_in_base_m: Floats  # (n, 2, 3)
    hands: HandRecords  # (MAX_HANDS,) HAND
    moves: MoveRecords  # (m,) MOVE
    samples: Floats  # (s, 7)
    sensors: SensorRecords  # (1,) SENSORS
    object_frames: ObjectFrames  # (RING,) OBJECT_FRAME
    hand_frames: HandFrames  # (RING,) HAND_FRAME
    polygon_in_base_m: Floats  # (m, 3)
    normals: Floats  # (frames, MAX_DETECTIONS, 3)
    uniforms: Floats  # (frames, MAX_DETECTIONS)
    drives: DriveRecords  # (1,) DRIVE
    faults: FaultRecords  # (n,) FAULT
    observation: ObservationRecords  # (1,) OBSERVATION
    truth: TruthRecords  # (1,) TICK_COMPILED

    def sense(self) -> None:
        """``sense`` of the exact cameras."""
        sense(
            self.clock,
            self.sensors,
            self.object_frames,
            self.hand_frames,
            self.polygon_in_base_m,
            self.normals,
            self.uniforms,
            self.hands,
            self.capsules,
            self.capsule_endpoints_in_base_m,
            self.faults,
            self.truth,
            self.observation,
        )


def world_records(scenario: Scenario, arm: ArmModel, joint_position_rad: NDArray[np.float64]) -> WorldRecords:
    """As the scenario begins, the arm at rest at ``joint_position_rad`` (6,)."""
    settings = scenario.settings
    clock = np.zeros(1, CLOCK)
    clock["control_period_s"] = settings.clock.control_period_s
    capsules = cell_capsules(load_capsules(arm.name), settings)
    hands = hands_at_start(scenario)
    cameras = sensors(settings, scenario.seed, scenario.ticks, overhead_transform_sensor_to_base(settings))
    records = WorldRecords(
        clock=ClockRecords(clock),
        arm=ArmRecords(arm_record(arm, settings)),
        capsules=CapsuleRecords(capsules.records),
        capsule_endpoints_in_base_m=np.empty((len(capsules.names), 2, 3)),
        hands=HandRecords(hands.state),
        moves=MoveRecords(hands.moves),
        samples=hands.samples,
        sensors=SensorRecords(cameras.state),
        object_frames=ObjectFrames(cameras.object_frames),
        hand_frames=HandFrames(cameras.hand_frames),
        polygon_in_base_m=cameras.polygon_in_base_m,
        normals=cameras.normals,
        uniforms=cameras.uniforms,
        drives=DriveRecords(drive(settings)),
        faults=FaultRecords(fault_table(scenario.faults)),
        observation=ObservationRecords(np.zeros(1, OBSERVATION)),
        truth=TruthRecords(np.zeros(1, TICK_COMPILED)),
    )
    fill_truth(
        records.arm,
        records.capsules,
        records.capsule_endpoints_in_base_m,
        records.hands,
        np.array(joint_position_rad, dtype=np.float64),
        np.zeros(6),
        0.0,
        records.truth,
    )
    return records
