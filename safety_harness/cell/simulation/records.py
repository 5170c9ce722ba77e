"""Define the records of an episode's world.

These records do not contain the data that only one kind of world needs to move the arm.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from safety_harness.base.geometry.arrays import ArrayN
from safety_harness.cell.controller.records import (
    FaultRecords,
    ObservationRecords,
    observation_dtype,
    overhead_transform_sensor_to_base,
)
from safety_harness.cell.robot.description import ArmModel
from safety_harness.cell.robot.distance import CapsuleRecords
from safety_harness.cell.robot.drive import DriveRecords, drive
from safety_harness.cell.robot.robots import arm_capsules, drive_model
from safety_harness.cell.simulation.cameras import HandFrames, ObjectFrames, SensorRecords, sensors
from safety_harness.cell.simulation.hand_motion import HandRecords, MoveRecords
from safety_harness.cell.simulation.hand_programs import hands_at_start
from safety_harness.cell.simulation.steps import ArmRecords, ClockRecords, Floats, TruthRecords
from safety_harness.cell.simulation.truth import arm_record, cell_capsules, fill_truth
from safety_harness.scenario.fault_table import fault_table
from safety_harness.scenario.model import Scenario
from safety_harness.trace.records import as_compiled, tick_dtype


@lru_cache
def clock_dtype(joints: int) -> np.dtype[Any]:
    """Return the record type CLOCK of a world whose arm has ``joints`` joints."""
    return np.dtype(
        [
            ("tick", np.int64),
            ("control_period_s", np.float64),
            ("acted_faults", np.int64),  # bits, since the last observation
            # of a step
            ("tcp_in_base_m", np.float64, (3,)),  # before it
            ("commanded_radps", np.float64, (joints,)),  # the motors
            ("joint_position_rad", np.float64, (joints,)),  # after it
        ],
        align=True,
    )


class WorldRecords(NamedTuple):
    """The hands, cameras, drives, faults and present truth of an episode.

    The order of the records lets each function take consecutive records as its arguments. ``step`` of the
    kinematic world takes the first ten records. ``move_on`` takes the second to the ninth record. ``sense``
    takes all records from ``truth`` on.
    """

    drives: DriveRecords  # (1,) DRIVE
    moves: MoveRecords  # (m,) MOVE
    samples: Floats  # (s, 7)
    arm: ArmRecords  # (1,) ARM
    truth: TruthRecords  # (1,) of a tick ``as_compiled``
    hands: HandRecords  # (hands,) HAND
    capsules: CapsuleRecords  # (n,) CAPSULE
    capsule_endpoints_in_base_m: Floats  # (n, 2, 3)
    clock: ClockRecords  # (1,) CLOCK
    faults: FaultRecords  # (n,) FAULT
    observation: ObservationRecords  # (1,) OBSERVATION
    sensors: SensorRecords  # (1,) SENSORS
    object_frames: ObjectFrames  # (RING,) OBJECT_FRAME
    hand_frames: HandFrames  # (RING,) HAND_FRAME
    polygon_in_base_m: Floats  # (m, 3)
    normals: Floats  # (frames, boxes, 3)
    uniforms: Floats  # (frames, boxes)


def world_records(scenario: Scenario, arm: ArmModel, joint_position_rad: ArrayN) -> WorldRecords:
    """Return the records at the scenario's start, with the arm at rest at ``joint_position_rad`` (n,)."""
    settings, slots = scenario.settings, scenario.hand_slots
    joints = len(arm.joint_names)
    clock = np.zeros(1, clock_dtype(joints))
    clock["control_period_s"] = settings.clock.control_period_s
    capsules = cell_capsules(arm_capsules(scenario.robot), settings)
    hands = hands_at_start(scenario)
    records = WorldRecords(
        drive(settings, joints, drive_model(scenario.robot)),
        hands.moves,
        hands.samples,
        ArmRecords(arm_record(arm, settings)),
        TruthRecords(as_compiled(np.zeros(1, tick_dtype(slots, joints)))),
        hands.state,
        capsules.records,
        np.empty((len(capsules.names), 2, 3)),
        ClockRecords(clock),
        FaultRecords(fault_table(scenario.faults)),
        ObservationRecords(np.zeros(1, observation_dtype(slots, joints))),
        *sensors(settings, scenario.seed, scenario.ticks, overhead_transform_sensor_to_base(settings), slots),
    )
    fill_truth(*records[3:8], np.array(joint_position_rad, dtype=np.float64), np.zeros(joints), 0.0)
    return records
