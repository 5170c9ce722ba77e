"""The catalogue: every property that a scenario file can claim, in the order of the pages."""

from __future__ import annotations

import re
from functools import lru_cache

from safety_harness.base.extension_points import ExtensionPoint, Registry
from safety_harness.claims.properties.answered import ANSWERED, DECISION_TIME_CLAIM
from safety_harness.claims.properties.clear_ways import CLEAR_WAYS
from safety_harness.claims.properties.entry import CatalogueEntry
from safety_harness.claims.properties.fallback import CERTAIN, FALLBACK_POSES, STOPS, UNCERTAIN
from safety_harness.claims.properties.finite import FINITE_TRACE
from safety_harness.claims.properties.giving_way import MOVES_AWAY
from safety_harness.claims.properties.hand_distance import HAND_DISTANCE
from safety_harness.claims.properties.hand_prediction import HAND_PREDICTIONS
from safety_harness.claims.properties.limits import (
    JOINT_ACCELERATIONS,
    JOINT_POSITIONS,
    JOINT_SPEEDS,
    TCP_ACCELERATION,
    TCP_SPEED,
)
from safety_harness.claims.properties.obstacles import OBSTACLE_DISTANCE
from safety_harness.claims.properties.outcome import KEEPS_ITS_PLACE, REACTS
from safety_harness.claims.properties.positions import PROPOSED_POSES, REPULSIVE_POSES
from safety_harness.claims.properties.proposals import (
    FEW_OVERRULED,
    LEAD_AWAY,
    NEAR_OPTIMUM,
    NEVER_SURE_AND_OFF,
    WITHIN_SPREAD,
)
from safety_harness.claims.properties.protective_separation import (
    PROTECTIVE_SEPARATION,
    PROTECTIVE_SEPARATION_AT,
    PROTECTIVE_SEPARATION_OWN,
)
from safety_harness.claims.properties.reaction import (
    FALSE_ALARMS,
    FALSE_ALARMS_WITHIN,
    GIVES_WAY,
    GIVES_WAY_AT_MOST,
    GIVES_WAY_TO_TRUE_HAND,
)
from safety_harness.claims.properties.servoing import (
    CONVERGED,
    GAIN_SWITCH,
    GAIN_SWITCH_ITERATIONS,
    GAIN_SWITCH_WITHIN,
    NEVER_STARVED,
    OBJECT_IN_VIEW,
)
from safety_harness.claims.properties.touching import NO_MOVING_PART_TOUCHES
from safety_harness.claims.properties.within_region import WITHIN_REGION

_OWN = (
    HAND_DISTANCE,
    NO_MOVING_PART_TOUCHES,
    PROTECTIVE_SEPARATION,
    PROTECTIVE_SEPARATION_AT,
    PROTECTIVE_SEPARATION_OWN,
    REPULSIVE_POSES,
    PROPOSED_POSES,
    LEAD_AWAY,
    NEAR_OPTIMUM,
    WITHIN_SPREAD,
    NEVER_SURE_AND_OFF,
    FEW_OVERRULED,
    WITHIN_REGION,
    MOVES_AWAY,
    CLEAR_WAYS,
    OBSTACLE_DISTANCE,
    UNCERTAIN,
    CERTAIN,
    STOPS,
    FALLBACK_POSES,
    GIVES_WAY,
    GIVES_WAY_TO_TRUE_HAND,
    REACTS,
    FALSE_ALARMS,
    FALSE_ALARMS_WITHIN,
    HAND_PREDICTIONS,
    DECISION_TIME_CLAIM,
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
    KEEPS_ITS_PLACE,
    FINITE_TRACE,
)
CATALOGUE = Registry(_OWN, ExtensionPoint.CLAIMS, CatalogueEntry)
"""Every claim; another is an entry here, or an entry point of a package."""


@lru_cache(maxsize=256)  # the scenarios of a space claim the same
def entry_claimed(sentence: str) -> tuple[CatalogueEntry, re.Match[str]] | None:
    """Return the catalogue entry that ``sentence`` claims, and the match with the values in the sentence.

    Return None if no entry matches.
    """
    return next(((entry, match) for entry in CATALOGUE if (match := entry.understands(sentence))), None)


def in_words_of_today(sentence: str) -> str:
    """Return ``sentence`` in the present wording if it has the wording of an earlier release.

    Any other sentence is returned unchanged.
    """
    return next(filter(None, (entry.in_words_of_today(sentence) for entry in CATALOGUE)), sentence)
