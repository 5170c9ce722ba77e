"""The key ``gate`` of a scenario file: demands beyond the gate's own (docs/reference/controller.md)."""

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
    """A box of positions in the base frame; points on its surface are inside."""

    low_m: Vector3 = key("from", POINT, "its lowest corner in the base frame", "[600 mm, -500 mm, -200 mm]")
    high_m: Vector3 = key("to", POINT, "its highest corner", "[700 mm, -400 mm, -100 mm]")

    def depth_m(self, position_in_base_m: NDArray[np.float64]) -> float:
        """Return the distance [m] from ``position_in_base_m`` (3,) inside the box to the nearest side.

        The distance is negative for a position outside, and NaN for NaN.
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
    """The region of questions that an avoider may be asked, such as the region of a proof."""

    hand: PositionBox = key("hand", _OF_HAND, "where the hand is that the avoider is asked about", _BOX)
    tcp: PositionBox = key("tcp", _OF_TCP, "where the TCP is then", _BOX)

    def depth_m(self, hand_in_base_m: NDArray[np.float64], tcp_in_base_m: NDArray[np.float64]) -> float:
        """Return the smaller depth [m] of ``hand_in_base_m`` and ``tcp_in_base_m``, each (3,), in its box.

        A depth is the distance to the nearest side of the box, negative outside.
        """
        return float(np.min([self.hand.depth_m(hand_in_base_m), self.tcp.depth_m(tcp_in_base_m)]))

    @property
    def summary(self) -> str:
        """The boxes for the hand and the TCP, in words."""
        return f"hands {self.hand.summary}, TCPs {self.tcp.summary}"


@declared
class GateRule:
    """The demands of the full gate beyond its own checks."""

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
        """Whether a demand concerns all places where a hand may be."""
        return self.hands_within is not None or self.hands_in_sets is YesNo.YES

    @property
    def demands(self) -> Iterator[str]:
        """The demands, each in a few words."""
        if self.hands_within is not None:
            yield f"every hand within {100.0 * self.hands_within:g} %"
        if self.hands_in_sets is YesNo.YES:
            yield "every hand in its set"
        if self.questions_within is not None:
            yield f"questions within {self.questions_within.summary}"


GATE = table_of(GateRule, "gate", path="gate")
