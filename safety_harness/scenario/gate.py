"""The key ``gate`` of a scenario file: how sure the gate is to be of where hands are: docs/avoiders.md."""

from __future__ import annotations

from safety_harness.scenario.codec import QuantityValue, declared, key, table_of
from safety_harness.scenario.units import FRACTION


@declared
class GateRule:
    """What the full gate asks for beside its own checks."""

    hands_within: float = key(
        "every hand within",
        QuantityValue(FRACTION, least=0.5, most=0.999999),
        "the way leads away from every place where the hands are, all together, with this probability, as "
        "the hand filter has it",
        "99 %",
        default=0.99,
    )


GATE = table_of(GateRule, "gate", path="gate")
