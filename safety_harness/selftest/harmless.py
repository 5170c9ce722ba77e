"""Changes that cannot matter, and why: said beforehand, so that an alarm about one is a false alarm."""

from __future__ import annotations

from functools import partial

import numpy as np

from safety_harness.admission.admit import Admitted
from safety_harness.avoidance.avoider import Avoider, Proposal, Vector
from safety_harness.controller.cycle import ControllerRecords
from safety_harness.selftest.avoider_faults import asked, spoilt
from safety_harness.selftest.fault import FaultyPart, SeededFault
from safety_harness.selftest.motion_faults import told
from safety_harness.selftest.perception_faults import parameters, seen
from safety_harness.selftest.servoing_faults import turned_alpha
from safety_harness.selftest.system import ChangedSystem, Records
from safety_harness.servoing.control import DESIRED

NOISE_M = 1e-7


def _mutating(avoider: Avoider, hand: Vector, tcp: Vector, seed: int) -> Proposal:
    proposal = asked(avoider, hand.copy(), tcp.copy(), seed)
    hand[:], tcp[:] = 0.0, 0.0
    return proposal


def _global_state(avoider: Avoider, hand: Vector, tcp: Vector, seed: int) -> Proposal:
    np.random.seed(0)  # noqa: NPY002 (that it does so is the point)
    return asked(avoider, hand, tcp, seed)


def _single_precision(avoider: Avoider, hand: Vector, tcp: Vector, seed: int) -> Proposal:
    proposal = asked(avoider, hand, tcp, seed)
    return Proposal(proposal.position_in_base_m.astype(np.float32), proposal.spread_m)


def _turned_half(records: ControllerRecords, magnitude: float) -> None:
    turned_alpha(records, np.pi)


def _half_turn_later(system: ChangedSystem, magnitude: float) -> ChangedSystem:
    joints = system.admitted.joint_position_rad.copy()
    joints[-1] += 2.0 * np.pi if joints[-1] < 0.0 else -2.0 * np.pi
    return system.starting_at(joints)


def _other_order(admitted: Admitted, magnitude: float, observation: Records) -> None:
    o = observation[0]
    o["boxes"][: o["box_count"]] = o["boxes"][: o["box_count"]][::-1].copy()


def _rubbish_behind(admitted: Admitted, magnitude: float, observation: Records) -> None:
    o = observation[0]
    o["boxes"][o["box_count"] :] = np.nan


def _stale_boxes(admitted: Admitted, magnitude: float, observation: Records) -> None:
    o = observation[0]
    if not o["boxes_new"]:
        o["boxes"], o["box_count"] = np.nan, 0


def _no_measurement(admitted: Admitted, magnitude: float, observation: Records) -> None:
    o = observation[0]
    if o["box_count"] < len(o["boxes"]):
        o["boxes"][o["box_count"]] = np.nan
        o["box_count"] += 1


def _unused_matrix(records: ControllerRecords, magnitude: float) -> None:
    if records.parameters["choice"][0] == DESIRED:
        records.parameters["desired_interaction"] = np.nan


def _tiny(records: ControllerRecords, magnitude: float) -> None:
    records.parameters["transform_sensor_to_base"][0, :3, 3] += NOISE_M


def _stopped_and_told(magnitude: float, command: Records) -> None:
    if command[0]["protective_stop"]:
        command[0]["joint_velocity_radps"] = 1.0


_of_avoider = partial(SeededFault, part=FaultyPart.AVOIDER)
_of_perception = partial(SeededFault, part=FaultyPart.PERCEPTION)

HARMLESS = (
    _of_avoider(
        name="mutates its inputs",
        hazard="an avoider that writes into what it is given",
        seed_into=spoilt(lambda _: _mutating),
        harmless="it is given copies",
    ),
    _of_avoider(
        name="seeds the global generator",
        hazard="an avoider that changes everybody's random numbers",
        seed_into=spoilt(lambda _: _global_state),
        harmless="nothing draws from the global generator",
    ),
    _of_avoider(
        name="answers in single precision",
        hazard="rounding to a tenth of a micrometre",
        seed_into=spoilt(lambda _: _single_precision),
        harmless="ten thousand times less than the arrival tolerance of 1 mm",
    ),
    SeededFault(
        name="direction of the object off by half a turn",
        part=FaultyPart.SERVOING,
        hazard="alpha off by pi",
        seed_into=parameters(_turned_half),
        harmless="an axis has no head: the error of alpha is taken modulo pi",
    ),
    SeededFault(
        name="matrix that is not used",
        part=FaultyPart.SERVOING,
        hazard="L* is lost",
        seed_into=parameters(_unused_matrix),
        harmless="the control law multiplies by its pseudoinverse, which is kept apart",
    ),
    SeededFault(
        name="wrist a whole turn on",
        part=FaultyPart.MOTION,
        hazard="another joint position for the same pose",
        seed_into=_half_turn_later,
        harmless="the pose is the same, and the joint stays within its limits of two turns",
    ),
    SeededFault(
        name="demand during a protective stop",
        part=FaultyPart.MOTION,
        hazard="the controller asks for motion while the arm is being stopped",
        seed_into=told(_stopped_and_told),
        harmless="the drives carry a stop through, whatever is asked for",
    ),
    _of_perception(
        name="boxes in another order",
        hazard="the hands change places in the frame",
        seed_into=seen(_other_order),
        harmless="boxes are paired with tracks by where they are",
    ),
    _of_perception(
        name="rubbish behind the last box",
        hazard="memory that nobody cleared",
        seed_into=seen(_rubbish_behind),
        harmless="only as many boxes are read as are counted",
    ),
    _of_perception(
        name="rubbish between frames",
        hazard="no new frame, and what stands in the old one is overwritten",
        seed_into=seen(_stale_boxes),
        harmless="boxes are read when a frame is new",
    ),
    _of_perception(
        name="a box that is no measurement",
        hazard="a detector that returns no number beside the hands",
        seed_into=seen(_no_measurement),
        harmless="what is not finite is passed over",
    ),
    _of_perception(
        name="extrinsics off by a tenth of a micrometre",
        hazard="rounding in a calibration file",
        seed_into=parameters(_tiny),
        harmless="less than any limit of a claim can tell",
    ),
)
