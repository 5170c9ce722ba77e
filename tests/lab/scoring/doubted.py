"""Avoiders for the tests of scoring: the closed form, changed by a function of the questions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.settings import DEFAULTS
from safety_harness.cell.avoidance.avoider import Proposal
from safety_harness.cell.avoidance.measures import optimum_in_base_m
from safety_harness.extensions.lab.scoring.questions import Questions
from safety_harness.extensions.lab.scoring.repeats import Subject

Array = NDArray[np.float64]
Change = Callable[[Array, Array, Array], tuple[Array, Array]]  # optimum, hands, TCPs -> positions, spreads


def unchanged(optimum: Array, hands: Array, tcps: Array) -> tuple[Array, Array]:
    return optimum, np.zeros_like(optimum)


@dataclass(eq=False)
class Changed:
    """The closed form with a change; ``asked`` has the sizes of its batches."""

    change: Change = unchanged
    name: str = "changed"
    spread_threshold_m: float | None = None
    asked: list[int] = field(default_factory=list)

    def propose_many(self, hands: Array, tcps: Array, seeds: NDArray[np.uint64]) -> tuple[Array, Array]:
        self.asked.append(len(hands))
        return self.change(optimum_in_base_m(DEFAULTS, hands, tcps), hands, tcps)

    def propose(
        self, *, hand_position_in_base_m: Array, tcp_position_in_base_m: Array, seed: int
    ) -> Proposal:
        positions, spreads = self.propose_many(
            hand_position_in_base_m[None], tcp_position_in_base_m[None], np.array([seed], np.uint64)
        )
        return Proposal(positions[0], spreads[0])


def subject(change: Change = unchanged) -> Subject:
    return Subject.made_by(lambda: Changed(change), "changed")


def near_questions(count: int, seed: int = 3) -> Questions:
    """Hands within 400 mm of TCPs about the desired one."""
    rng = np.random.default_rng(seed)
    tcps = np.array(DEFAULTS.cell.desired_tcp_position_in_base_m) + rng.uniform(-0.06, 0.06, (count, 3))
    return Questions(
        tcps + rng.uniform(-0.2, 0.2, (count, 3)), tcps, rng.integers(0, 2**63, count, dtype=np.uint64)
    )
