"""Define harmless changes, each with the reason why it cannot matter.

An alarm about a harmless change is a false alarm.
"""

from __future__ import annotations

import numpy as np

from safety_harness.admission.admit import Admitted
from safety_harness.cell.avoidance.avoider import Avoider, Proposal, Vector
from safety_harness.cell.controller.cycle import ControllerRecords
from safety_harness.cell.servoing.control import DESIRED
from safety_harness.cell.servoing.features import ALPHA
from safety_harness.extensions.selftest.avoider_faults import answered, queried, sound_answer
from safety_harness.extensions.selftest.fault import (
    anywhere,
    commanded,
    declared,
    faults_in,
    known,
    of_avoider,
    of_motion,
    of_perception,
    of_servoing,
    seeded,
    seen,
)
from safety_harness.extensions.selftest.system import ChangedSystem, Records

NOISE_M = 1e-7  # as in the name of the fault that uses it


@declared(harmless="it is given copies")
@of_avoider("mutates its inputs", "an avoider that writes into its inputs")
@seeded(queried)
def _mutating(_: float, avoider: Avoider, hand: Vector, tcp: Vector, seed: int) -> Proposal:
    proposal = sound_answer(avoider, hand.copy(), tcp.copy(), seed)
    hand[:], tcp[:] = 0.0, 0.0
    return proposal


@declared(harmless="the harness never draws from the global generator")
@of_avoider("seeds the global generator", "an avoider that changes everybody's random numbers")
@seeded(queried)
def _global_state(_: float, avoider: Avoider, hand: Vector, tcp: Vector, seed: int) -> Proposal:
    np.random.seed(0)  # noqa: NPY002 (that it does so is the point)
    return sound_answer(avoider, hand, tcp, seed)


@declared(harmless="ten thousand times less than the arrival tolerance of 1 mm")
@of_avoider("answers in single precision", "rounding to a tenth of a micrometre")
@seeded(answered)
def _single_precision(_: float, proposal: Proposal, hand: Vector, tcp: Vector, seed: int) -> Proposal:
    return Proposal(proposal.position_in_base_m.astype(np.float32), proposal.spread_m)


@declared(harmless="an axis has no head: alpha's error counts modulo pi")
@of_servoing("direction of the object off by half a turn", "alpha off by pi")
@seeded(known)
def _turned_half(records: ControllerRecords, magnitude: float) -> None:
    records.parameters["desired_features"][0, ALPHA] += np.pi


@declared(harmless="the control law multiplies by its pseudoinverse, a separate array")
@of_servoing("matrix that is not used", "L* is lost")
@seeded(known)
def _unused_matrix(records: ControllerRecords, magnitude: float) -> None:
    if records.parameters["choice"][0] == DESIRED:
        records.parameters["desired_interaction"] = np.nan


@declared(harmless="the pose is the same, and the joint stays a radian from its limits")
@of_motion("wrist a whole turn on", "another joint position for the same pose")
@seeded(anywhere)
def _half_turn_later(system: ChangedSystem, magnitude: float) -> ChangedSystem:
    joints = system.admitted.joint_position_rad.copy()
    joints[-1] += 2.0 * np.pi if joints[-1] < 0.0 else -2.0 * np.pi
    arm = system.admitted.arm
    left_rad = min(joints[-1] - arm.position_lower_rad[-1], arm.position_upper_rad[-1] - joints[-1])
    return system.starting_at(joints) if left_rad >= 1.0 else system


@declared(harmless="the drives carry a stop through, against any command")
@of_motion("demand during a protective stop", "the controller asks for motion while the arm is being stopped")
@seeded(commanded)
def _stopped_and_told(magnitude: float, command: Records) -> None:
    if command[0]["protective_stop"]:
        command[0]["joint_velocity_radps"] = 1.0


@declared(harmless="the controller pairs boxes with tracks by their places")
@of_perception("boxes in another order", "the hands change places in the frame")
@seeded(seen)
def _other_order(admitted: Admitted, magnitude: float, observation: Records) -> None:
    o = observation[0]
    o["boxes"][: o["box_count"]] = o["boxes"][: o["box_count"]][::-1].copy()


@declared(harmless="the controller reads only the counted boxes")
@of_perception("rubbish behind the last box", "memory that was not cleared")
@seeded(seen)
def _rubbish_behind(admitted: Admitted, magnitude: float, observation: Records) -> None:
    o = observation[0]
    o["boxes"][o["box_count"] :] = np.nan


@declared(harmless="the controller reads boxes only of a new frame")
@of_perception("rubbish between frames", "no new frame, and rubbish overwrites the old frame")
@seeded(seen)
def _stale_boxes(admitted: Admitted, magnitude: float, observation: Records) -> None:
    o = observation[0]
    if not o["boxes_new"]:
        o["boxes"], o["box_count"] = np.nan, 0


@declared(harmless="the controller skips boxes that are not finite")
@of_perception("a box that is no measurement", "a detector that returns no number beside the hands")
@seeded(seen)
def _no_measurement(admitted: Admitted, magnitude: float, observation: Records) -> None:
    o = observation[0]
    if o["box_count"] < len(o["boxes"]):
        o["boxes"][o["box_count"]] = np.nan
        o["box_count"] += 1


@declared(harmless="too small for the limit of any claim")
@of_perception("extrinsics off by a tenth of a micrometre", "rounding in a calibration file")
@seeded(known)
def _tiny(records: ControllerRecords, magnitude: float) -> None:
    records.parameters["transform_sensor_to_base"][0, :3, 3] += NOISE_M


HARMLESS = faults_in(globals())
