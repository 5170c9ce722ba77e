"""The key ``gate`` of a scenario file, which adds requirements to the gate's own checks.

The page docs/reference/controller.md describes these checks.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.settings import Vector3
from safety_harness.scenario.codec import POINT, Below, QuantityValue, Word, declared, key, table_of
from safety_harness.scenario.robots import YesNo
from safety_harness.scenario.units import FRACTION

_BOX = "{from: [600 mm, -500 mm, -200 mm], to: [700 mm, -400 mm, -100 mm]}"
_REGION = f"{{hand: {_BOX}, tcp: {_BOX}}}"


@declared
class PositionBox:
    """A box of positions in the base frame.

    Points on its surface count as inside.
    """

    low_m: Vector3 = key("from", POINT, "its lowest corner in the base frame", "[600 mm, -500 mm, -200 mm]")
    high_m: Vector3 = key("to", POINT, "its highest corner", "[700 mm, -400 mm, -100 mm]")

    def depth_m(self, position_in_base_m: NDArray[np.float64]) -> float:
        """Return the distance [m] from the point ``position_in_base_m`` (3,) in the box to the nearest side.

        The distance is negative for a point outside the box, and NaN for a point with NaN.
        """
        sides = position_in_base_m - self.low_m, self.high_m - position_in_base_m
        return float(np.min(sides))

    @property
    def summary(self) -> str:
        """The corners of the box, in words."""
        low, high = (", ".join(f"{1e3 * x:g}" for x in corner) for corner in (self.low_m, self.high_m))
        return f"({low}) to ({high}) mm"


_OF_HAND, _OF_TCP = (
    Below(tables=(table_of(PositionBox, f"a box of {who}", path=f"gate.questions within.{key}"),))
    for who, key in (("hands", "hand"), ("TCPs", "tcp"))
)


@declared
class AskedRegion:
    """The set of inputs with which an avoider may be queried, for example the inputs that a proof covers."""

    hand: PositionBox = key("hand", _OF_HAND, "where the hand is that the avoider is asked about", _BOX)
    tcp: PositionBox = key("tcp", _OF_TCP, "where the TCP is then", _BOX)

    def depth_m(self, hand_in_base_m: NDArray[np.float64], tcp_in_base_m: NDArray[np.float64]) -> float:
        """Return the smaller of two depths [m].

        They are the depth of the hand in its box and the depth of the TCP in its box. The positions are
        ``hand_in_base_m`` (3,) and ``tcp_in_base_m`` (3,). A depth is the distance to the nearest side of the
        box, with a negative sign outside the box.
        """
        return float(np.min([self.hand.depth_m(hand_in_base_m), self.tcp.depth_m(tcp_in_base_m)]))

    @property
    def summary(self) -> str:
        """The boxes for the hand and the TCP, in words."""
        return f"hands {self.hand.summary}, TCPs {self.tcp.summary}"


@declared
class GateRule:
    """The requirements of the full gate beyond its own checks."""

    hands_within: float | None = key(
        "every hand within",
        QuantityValue(FRACTION, least=0.5, most=0.999999),
        "the way leads away from every place where the hands are, all together, with this probability, as "
        "the hand filter has it",
        "99 %",
        default=None,
    )
    hands_in_sets: YesNo | None = key(
        "every hand in its set",
        Word(YesNo),
        "the way leads away from every place in the sets of the scenario's [predictor](how-to/predictor.md)",
        "yes",
        default=None,
    )
    questions_within: AskedRegion | None = key(
        "questions within",
        Below(tables=(table_of(AskedRegion, "a region of questions", path="gate.questions within"),)),
        "answers to other questions are not used: the region of a [proof](how-to/prove.md#in-the-loop)",
        _REGION,
        default=None,
    )

    @property
    def of_possible_hands(self) -> bool:
        """Whether at least one requirement concerns all possible positions of a hand."""
        return self.hands_within is not None or self.hands_in_sets is YesNo.YES

    @property
    def demands(self) -> Iterator[str]:
        """The requirements, each in a few words."""
        if self.hands_within is not None:
            yield f"every hand within {100.0 * self.hands_within:g} %"
        if self.hands_in_sets is YesNo.YES:
            yield "every hand in its set"
        if self.questions_within is not None:
            yield f"questions within {self.questions_within.summary}"


GATE = table_of(GateRule, "gate", path="gate")
