"""Read the statements in LOG.yaml about joints and hands, and about their uncertainties."""

from __future__ import annotations

import numpy as np

from safety_harness.cell.robot.description import ArmModel
from safety_harness.extensions.field.logs.frozen import REPEATS, at_rest
from safety_harness.extensions.field.logs.model import (
    JOINTS_KNOWN_TO_RAD,
    JOINTS_LONGEST_GAP_S,
    HandFacts,
    JointFacts,
)
from safety_harness.extensions.field.logs.streams import LATEST_S
from safety_harness.scenario.fields import Fields
from safety_harness.scenario.nodes import Mapping
from safety_harness.scenario.units import (
    ANGLE,
    ANGULAR_ACCELERATION,
    ANGULAR_SPEED,
    LENGTH,
    SPEED,
    TIME,
    Dimension,
)

FORMAT, RATE = "format", "rate"
OF_JOINTS = (
    *("names", FORMAT, "unit", "time", "known to", "speeds known to"),
    *("move at most", "accelerate at most", "longest gap", REPEATS),
)
OF_HANDS = (
    *("forearm", "left out", "longest gap", "moves at most", "known to", "frame", "unit", "time"),
    *(RATE, "speeds", REPEATS),
)


def said_of_joints(given: Fields) -> Fields:
    """Return the keys below "joints" in LOG.yaml; the result is empty if LOG.yaml has no key "joints"."""
    field = given.optional("joints")
    return Fields(given.whole, {}) if field is None else field.fields(OF_JOINTS)


def facts_of_joints(keys: Fields, arm: ArmModel) -> JointFacts:
    """Return the facts about joints from the keys below "joints"."""
    most = arm.velocity_limit_radps.copy()
    if (field := keys.optional("move at most")) is not None:
        most = np.full(len(most), field.quantity(ANGULAR_SPEED, above=0.0))
    hard = keys.optional("accelerate at most")
    rates = keys.optional("speeds known to")
    return JointFacts(
        known_to_rad=_quantity(keys, "known to", ANGLE, JOINTS_KNOWN_TO_RAD),
        speeds_known_to_radps=None if rates is None else rates.quantity(ANGULAR_SPEED, least=0.0),
        move_at_most_radps=most,
        accelerate_at_most_radps2=None if hard is None else hard.quantity(ANGULAR_ACCELERATION, above=0.0),
        longest_gap_s=_quantity(keys, "longest gap", TIME, JOINTS_LONGEST_GAP_S, LATEST_S),
        at_rest=at_rest(keys),
    )


def facts_of_hands(keys: Fields, *, each: bool = False) -> HandFacts:
    """Return the facts about hands from the keys below "hands".

    ``each`` is True if every sample may have its own uncertainty.
    """
    known = keys.required("known to")
    by_sample = each and isinstance(known.node, Mapping)
    return HandFacts(
        known_to_m=np.inf if by_sample else known.quantity(LENGTH, least=0.0),
        moves_at_most_mps=keys.required("moves at most").quantity(SPEED, above=0.0),
        longest_gap_s=keys.required("longest gap").quantity(TIME, above=0.0, most=LATEST_S),
        at_rest=at_rest(keys),
    )


def _quantity(
    keys: Fields, key: str, dimension: Dimension, default: float, most: float | None = None
) -> float:
    field = keys.optional(key)
    return default if field is None else field.quantity(dimension, least=0.0, most=most)
