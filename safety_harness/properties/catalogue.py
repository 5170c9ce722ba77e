"""The catalogue: every property that a scenario file can claim, in the order of the pages."""

from __future__ import annotations

from safety_harness.properties.accelerations import JOINT_ACCELERATIONS, TCP_ACCELERATION
from safety_harness.properties.alternation import GIVES_WAY_AT_MOST
from safety_harness.properties.answered import ANSWERED
from safety_harness.properties.clear_ways import CLEAR_WAYS
from safety_harness.properties.decision_time import DECISION_TIME
from safety_harness.properties.entry import CatalogueEntry
from safety_harness.properties.fallback import CERTAIN, UNCERTAIN
from safety_harness.properties.fallback_poses import FALLBACK_POSES
from safety_harness.properties.false_alarms import FALSE_ALARMS, FALSE_ALARMS_WITHIN
from safety_harness.properties.finite import FINITE_TRACE
from safety_harness.properties.giving_way import MOVES_AWAY
from safety_harness.properties.hand_distance import HAND_DISTANCE
from safety_harness.properties.hand_prediction import HAND_PREDICTIONS
from safety_harness.properties.iterations import GAIN_SWITCH_ITERATIONS
from safety_harness.properties.limits import JOINT_POSITIONS, JOINT_SPEEDS, TCP_SPEED
from safety_harness.properties.object_view import OBJECT_IN_VIEW
from safety_harness.properties.protective_separation import (
    PROTECTIVE_SEPARATION,
    PROTECTIVE_SEPARATION_AT,
    PROTECTIVE_SEPARATION_OWN,
)
from safety_harness.properties.reaction import GIVES_WAY, GIVES_WAY_TO_TRUE_HAND
from safety_harness.properties.repulsive_pose import PROPOSED_POSES, REPULSIVE_POSES
from safety_harness.properties.servoing import CONVERGED, GAIN_SWITCH, GAIN_SWITCH_WITHIN
from safety_harness.properties.starvation import NEVER_STARVED
from safety_harness.properties.stopping import STOPS

CATALOGUE: tuple[CatalogueEntry, ...] = (
    HAND_DISTANCE,
    PROTECTIVE_SEPARATION,
    PROTECTIVE_SEPARATION_AT,
    PROTECTIVE_SEPARATION_OWN,
    REPULSIVE_POSES,
    PROPOSED_POSES,
    MOVES_AWAY,
    CLEAR_WAYS,
    UNCERTAIN,
    CERTAIN,
    STOPS,
    FALLBACK_POSES,
    GIVES_WAY,
    GIVES_WAY_TO_TRUE_HAND,
    FALSE_ALARMS,
    FALSE_ALARMS_WITHIN,
    HAND_PREDICTIONS,
    DECISION_TIME,
    ANSWERED,
    JOINT_POSITIONS,
    JOINT_SPEEDS,
    TCP_SPEED,
    JOINT_ACCELERATIONS,
    TCP_ACCELERATION,
    OBJECT_IN_VIEW,
    GAIN_SWITCH,
    GAIN_SWITCH_WITHIN,
    GAIN_SWITCH_ITERATIONS,
    CONVERGED,
    GIVES_WAY_AT_MOST,
    NEVER_STARVED,
    FINITE_TRACE,
)
