"""Avoiders with a fault of the scenario: asked earlier than the answer counts, or answering NaN."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from safety_harness.avoidance.avoider import Avoider, Proposal, Vector, spread_threshold_of
from safety_harness.scenario.fault_table import FaultKind, acting

NAN = int(FaultKind.AVOIDER_NAN)


@dataclass(frozen=True, eq=False)
class Asked:
    """Answers the question that was asked earlier, whatever it is asked now."""

    avoider: Avoider
    hand_position_in_base_m: Vector
    tcp_position_in_base_m: Vector

    @property
    def name(self) -> str:
        """The avoider's own."""
        return self.avoider.name

    @property
    def spread_threshold_m(self) -> float | None:
        """The avoider's own; AvoiderError as there."""
        return spread_threshold_of(self.avoider)

    def propose(
        self, *, hand_position_in_base_m: Vector, tcp_position_in_base_m: Vector, seed: int
    ) -> Proposal:
        """What the avoider says of the hand and the TCP as they were then."""
        return self.avoider.propose(
            hand_position_in_base_m=self.hand_position_in_base_m.copy(),
            tcp_position_in_base_m=self.tcp_position_in_base_m.copy(),
            seed=seed,
        )


@dataclass(frozen=True, eq=False)
class AnswersNaN:
    """Asks the avoider nothing, and answers with NaN."""

    name: str

    def propose(
        self, *, hand_position_in_base_m: Vector, tcp_position_in_base_m: Vector, seed: int
    ) -> Proposal:
        """No number."""
        return Proposal(np.full(3, np.nan))


def faulty(faults: NDArray[np.void], avoider: Avoider, time_s: float) -> Avoider:
    """What ``avoider`` is at ``time_s``, with the faults (n,) FAULT."""
    return AnswersNaN(avoider.name) if acting(faults, NAN, time_s) else avoider
