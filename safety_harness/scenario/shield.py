"""The key ``shield`` of a scenario file: an optional protection between the controller and the drives.

docs/explanation/shield.md describes the shield and proves its effect.  Each value here is an assumption of
the proof.
"""

from __future__ import annotations

from enum import Enum

from safety_harness.scenario.codec import Below, Key, QuantityValue, Word, declared, key, keyed, table_of
from safety_harness.scenario.fields import Field
from safety_harness.scenario.nodes import Scalar
from safety_harness.scenario.units import ACCELERATION, LENGTH, SPEED, TIME


class ShieldKind(Enum):
    """The kinds of shield."""

    SPEED_AND_SEPARATION = "speed and separation"


@declared
class Shield:
    """The assumptions of the shield.

    The user is responsible for these assumptions, because the harness does not check them.
    """

    kind: ShieldKind = keyed(
        Key("kind", Word(ShieldKind), "what stands behind the controller ([shield](explanation/shield.md))"),
        default=ShieldKind.SPEED_AND_SEPARATION,
    )
    hand_speed_mps: float = key(
        "hand speed",
        QuantityValue(SPEED, least=0.1, most=10.0),
        "no hand is faster; 2 m/s is what ISO 13855 takes for a hand that reaches",
        default=2.0,
    )
    hand_acceleration_mps2: float | None = key(
        "hand acceleration",
        QuantityValue(ACCELERATION, least=0.1, most=100.0),
        "no hand changes its velocity faster: a hand that was seen to rest is then known to need time",
        "10 m/s2",
        "any",
        default=None,
    )
    body_m: float = key(
        "body within",
        QuantityValue(LENGTH, least=0.01, most=2.0),
        "no part of a hand or its forearm is farther from the hand's centre; the default is a forearm of "
        "300 mm and its radius of 45 mm, whichever way it points",
        default=0.345,
    )
    uncertainty_m: float = key(
        "position uncertainty",
        QuantityValue(LENGTH, least=0.0, most=1.0),
        "no measured place of a hand's centre, less that of the arm, is farther from the true one",
        default=0.01,
    )
    reaction_time_s: float = key(
        "reaction time",
        QuantityValue(TIME, least=0.0, most=5.0),
        "from a command until the arm moves by it, beside one control period",
        default=0.0,
    )
    deceleration_mps2: float = key(
        "deceleration",
        QuantityValue(ACCELERATION, least=0.1, most=100.0),
        "at which the drives can bring the arm's fastest point to rest; the shield brakes with it",
        default=1.0,
    )


SHIELD = table_of(Shield, "shield", path="shield")


class _ShieldValue(Below):
    """The value of the key ``shield``.

    It is the name of a kind of shield, which has default assumptions, or a mapping that states the
    assumptions.
    """

    def read(self, field: Field) -> Shield:
        """Return the shield that the field describes."""
        if isinstance(field.node, Scalar):
            return Shield(kind=field.choice(ShieldKind))
        shield: Shield = SHIELD.read(field)
        return shield


SHIELD_VALUE = _ShieldValue(
    kind="speed and separation, or a mapping", tables=(SHIELD,), or_text=r"^speed and separation$"
)
