"""Which hazard a claim of the catalogue is about, and the terms of the standards that it is traced to.

Terms only: a claim speaks the standards' language so that an assessor finds the way, which is no statement
of conformity.  Clauses are named where this package's own formulas come from them.
"""

from __future__ import annotations

from dataclasses import dataclass

from safety_harness.certification.evidence import StandardTerm
from safety_harness.properties.answered import ANSWERED, DECISION_TIME
from safety_harness.properties.catalogue import CATALOGUE
from safety_harness.properties.clear_ways import CLEAR_WAYS
from safety_harness.properties.entry import CatalogueEntry
from safety_harness.properties.fallback import CERTAIN, FALLBACK_POSES, STOPS, UNCERTAIN
from safety_harness.properties.finite import FINITE_TRACE
from safety_harness.properties.giving_way import MOVES_AWAY
from safety_harness.properties.hand_distance import HAND_DISTANCE
from safety_harness.properties.hand_prediction import HAND_PREDICTIONS
from safety_harness.properties.limits import (
    JOINT_ACCELERATIONS,
    JOINT_POSITIONS,
    JOINT_SPEEDS,
    TCP_ACCELERATION,
    TCP_SPEED,
)
from safety_harness.properties.positions import PROPOSED_POSES, REPULSIVE_POSES
from safety_harness.properties.protective_separation import (
    PROTECTIVE_SEPARATION,
    PROTECTIVE_SEPARATION_AT,
    PROTECTIVE_SEPARATION_OWN,
)
from safety_harness.properties.reaction import (
    FALSE_ALARMS,
    FALSE_ALARMS_WITHIN,
    GIVES_WAY,
    GIVES_WAY_AT_MOST,
    GIVES_WAY_TO_TRUE_HAND,
)
from safety_harness.properties.servoing import (
    CONVERGED,
    GAIN_SWITCH,
    GAIN_SWITCH_ITERATIONS,
    GAIN_SWITCH_WITHIN,
    NEVER_STARVED,
    OBJECT_IN_VIEW,
)

CELL = "ISO 10218-2:2025"
ROBOT = "ISO 10218-1:2025"
COLLABORATION = "ISO/TS 15066"


@dataclass(frozen=True)
class Tracing:
    """A hazard in words, and terms."""

    hazard: str
    terms: tuple[StandardTerm, ...]


def _traced(hazard: str, *terms: tuple[str, str]) -> Tracing:
    return Tracing(hazard, tuple(StandardTerm(standard=standard, term=term) for standard, term in terms))


MONITORING = (CELL, "collaborative application, speed and separation monitoring")
SEPARATION = _traced(
    "impact, crushing or trapping of a hand or forearm by the moving arm",
    MONITORING,
    (COLLABORATION, "protective separation distance S_p (5.5.4)"),
)
DISTANCE = _traced(
    "impact, crushing or trapping of a hand or forearm by the arm",
    MONITORING,
    (COLLABORATION, "protective separation distance, held to a constant"),
)
REACTION = _traced(
    "the arm notices a hand, but gives way or stops too late",
    MONITORING,
    (COLLABORATION, "reaction time T_r"),
)
UNNOTICED = _traced(
    "a hand is near, and the arm does not notice it or notices it too late",
    MONITORING,
    (COLLABORATION, "reaction time T_r, and position uncertainty of the human, Z_d"),
)
LEARNED = _traced(
    "a learned proposal is followed where it should not be trusted",
    (CELL, "no term for learned parts: a fall-back within the safety function's own reach"),
)
LEARNED_ABSENT = _traced(
    "what was assessed is not what answers: the fallback stood in for the avoider",
    (CELL, "no term for learned parts: a fall-back within the safety function's own reach"),
)
AWAY = _traced("the avoiding motion itself leads towards a person", MONITORING)
SPACE = _traced(
    "the arm is sent where it cannot go, and stops or moves in an unforeseen way",
    (ROBOT, "operating space within the restricted space"),
)
SPEED = _traced(
    "the arm moves faster than separation and stopping distances allow for",
    (ROBOT, "reduced speed, monitored speed"),
    (COLLABORATION, "robot speed v_r of the protective separation distance"),
)
STOPPING = _traced(
    "the arm does not come to rest in the time that the distances allow for",
    (ROBOT, "protective stop, stopping time and stopping distance"),
    (COLLABORATION, "stopping time T_s"),
)
AVAILABILITY = _traced(
    "work is disturbed in vain, so that people come to bypass the safeguard",
    ("ISO 12100", "reasonably foreseeable misuse: defeating a safeguard"),
)
TASK = _traced("none of its own: the task, without which staying clear is no merit")
MEASUREMENT = _traced(
    "hands are taken to be where they are not", (COLLABORATION, "position uncertainty of the human, Z_d")
)

TRACED: dict[CatalogueEntry, Tracing] = {
    HAND_DISTANCE: DISTANCE,
    PROTECTIVE_SEPARATION: SEPARATION,
    PROTECTIVE_SEPARATION_AT: SEPARATION,
    PROTECTIVE_SEPARATION_OWN: SEPARATION,
    REPULSIVE_POSES: SPACE,
    PROPOSED_POSES: SPACE,
    MOVES_AWAY: AWAY,
    CLEAR_WAYS: AWAY,
    UNCERTAIN: LEARNED,
    CERTAIN: LEARNED,
    FALLBACK_POSES: LEARNED,
    STOPS: STOPPING,
    GIVES_WAY: REACTION,
    GIVES_WAY_TO_TRUE_HAND: UNNOTICED,
    DECISION_TIME: REACTION,
    ANSWERED: LEARNED_ABSENT,
    FALSE_ALARMS: AVAILABILITY,
    FALSE_ALARMS_WITHIN: AVAILABILITY,
    GIVES_WAY_AT_MOST: AVAILABILITY,
    NEVER_STARVED: AVAILABILITY,
    HAND_PREDICTIONS: MEASUREMENT,
    JOINT_POSITIONS: SPACE,
    JOINT_SPEEDS: SPEED,
    TCP_SPEED: SPEED,
    JOINT_ACCELERATIONS: SPEED,
    TCP_ACCELERATION: SPEED,
    OBJECT_IN_VIEW: TASK,
    GAIN_SWITCH: TASK,
    GAIN_SWITCH_WITHIN: TASK,
    GAIN_SWITCH_ITERATIONS: TASK,
    CONVERGED: TASK,
    FINITE_TRACE: _traced("none of its own: a record that is no record proves nothing"),
}
OWN = _traced("not stated by the plan: the claim is a formula of its author's")

EXCLUSIONS = (
    "contact forces and pressures: what happens once something touches is not modelled, so nothing here is "
    "about power and force limiting",
    "fingers: a hand is a sphere and its forearm a capsule",
    "the person's torso and head",
    "other people in the cell, and more than two hands",
    "real sensors and their failures beyond the noise, delay, dropout and faults that a scenario states",
    "the tool and the workpiece, friction and flexibility of the arm",
    "the robot maker's own safety functions: none is relied on, and no performance level is claimed",
)
ASSUMPTIONS = (
    "hands move and are distributed as the scenario spaces say; the plan's author answers for both",
    "the arm brakes as its maker's worst-case stop times say",
    "the model of the arm is that of its URDF; its capsules enclose every triangle of its meshes",
    "runs are independent: each has seeds of its own, from the plan's seed and its number",
)


def entry_of(sentence: str) -> CatalogueEntry | None:
    """The entry of the catalogue that a sentence claims; None for a formula."""
    return next((entry for entry in CATALOGUE if entry.understands(sentence)), None)


def traced(sentence: str) -> Tracing:
    """The hazard and the terms of a claim."""
    entry = entry_of(sentence)
    return OWN if entry is None else TRACED[entry]
