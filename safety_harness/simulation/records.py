"""The records of one episode's world: all of it but what moves the arm, which is each world's own."""

from __future__ import annotations

from typing import NamedTuple

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
from safety_harness.simulation.truth import arm_record, cell_capsules
from safety_harness.trace.records import TICK_COMPILED

CLOCK = np.dtype(
    [
        ("tick", np.int64),
        ("control_period_s", np.float64),
        ("acted_faults", np.int64),  # bits, since the last observation was asked for
    ],
    align=True,
)


class WorldRecords(NamedTuple):
    """One episode's hands, cameras, drives and faults, and the truth of now."""

    clock: NDArray[np.void]  # (1,) CLOCK
    arm: NDArray[np.void]  # (1,) ARM
    capsule_link: NDArray[np.int64]  # (n,)
    capsule_start_in_link: NDArray[np.float64]  # (n, 3)
    capsule_end_in_link: NDArray[np.float64]  # (n, 3)
    capsule_radius_m: NDArray[np.float64]  # (n,)
    placed: NDArray[np.float64]  # (n, 2, 3)
    hands: NDArray[np.void]  # (MAX_HANDS,) HAND
    moves: NDArray[np.void]  # (m,) MOVE
    samples: NDArray[np.float64]  # (s, 7)
    sensors: NDArray[np.void]  # (1,) SENSORS
    object_frames: NDArray[np.void]  # (RING,) OBJECT_FRAME
    hand_frames: NDArray[np.void]  # (RING,) HAND_FRAME
    polygon_in_base_m: NDArray[np.float64]  # (m, 3)
    normals: NDArray[np.float64]  # (frames, MAX_DETECTIONS, 3)
    uniforms: NDArray[np.float64]  # (frames, MAX_DETECTIONS)
    drives: NDArray[np.void]  # (1,) DRIVE
    faults: NDArray[np.void]  # (n,) FAULT
    observation: NDArray[np.void]  # (1,) OBSERVATION
    truth: NDArray[np.void]  # (1,) TICK_COMPILED


def world_records(scenario: Scenario, arm: ArmModel) -> WorldRecords:
    """As the scenario begins; the truth of the arm is still to be written (``observe_truth``)."""
    settings = scenario.settings
    clock = np.zeros(1, CLOCK)
    clock["control_period_s"] = settings.clock.control_period_s
    capsules = cell_capsules(load_capsules(arm.name), settings)
    hands = hands_at_start(scenario)
    cameras = sensors(settings, scenario.seed, scenario.ticks, overhead_transform_sensor_to_base(settings))
    return WorldRecords(
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
