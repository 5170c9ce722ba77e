"""What a search needs of the world: the claims as goals, and what came of a batch of points."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from safety_harness.properties.base import Property, Unit
from safety_harness.search.cube import Points

# What a margin of each unit is divided by, so that margins of several claims can be compared: a difference
# that matters and is common.  Searching one claim at a time does not depend on it.
SCALES = {
    Unit.LENGTH: 0.1,
    Unit.ANGLE: np.pi / 18.0,
    Unit.SPEED: 0.1,
    Unit.ANGULAR_SPEED: np.pi / 6.0,
    Unit.TIME: 1.0,
    Unit.ACCELERATION: 1.0,
    Unit.ANGULAR_ACCELERATION: np.pi,
    Unit.FRACTION: 0.1,
    Unit.COUNT: 1.0,
}

RUN_FAILED = "the run failed: "  # how the mishap of a world that broke begins


@dataclass(frozen=True)
class Goal:
    """A claim that a search tries to refute; margins are divided by ``scale`` (SI)."""

    sentence: str
    scale: float
    unit: Unit = Unit.COUNT

    @classmethod
    def of(cls, prop: Property) -> Goal:
        """The goal of a property, with the scale of its unit."""
        return cls(prop.sentence, SCALES[prop.unit], prop.unit)

    def margin_text(self, margin: float) -> str:
        """A margin [SI] in the unit that people read."""
        return self.unit.margin_text(margin)


@dataclass(frozen=True, eq=False)
class Outcomes:
    """What came of (n, d) points, row by row.

    ``margins`` (n, k) SI, negative where a claim is violated, NaN where there is none to give;
    ``conclusive`` (n, k) whether there is a verdict: a margin alone leads somewhere and is no evidence.
    ``refused`` says why a point was not tried at all (admission), ``mishaps`` what went wrong in a run
    besides: an avoider that gave no answer, a world that broke; both are empty elsewhere.
    ``kinds`` tells violations apart that have different causes; ``cells`` is for coverage.
    """

    margins: Points
    conclusive: NDArray[np.bool_]
    refused: Sequence[str]
    mishaps: Sequence[str]
    kinds: Sequence[str]
    cells: Sequence[Hashable]

    @classmethod
    def of_margins(cls, margins: Points) -> Outcomes:
        """Every point was tried, and nothing but margins is known."""
        none = ("",) * len(margins)
        return cls(margins, np.isfinite(margins), none, none, none, (None,) * len(margins))


class Evaluate(Protocol):
    """A world: points in, outcomes out."""

    def __call__(self, points: Points, first: int) -> Outcomes:
        """(n, d) points of the cube, numbered from ``first`` over the whole search: seeds come from these."""
        ...
