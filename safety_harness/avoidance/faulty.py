"""Avoiders with a fault of the scenario: answering NaN."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from safety_harness.avoidance.avoider import Avoider, Proposal, Vector
from safety_harness.scenario.fault_table import acting
from safety_harness.scenario.faults import FaultKind

NAN = np.int64(FaultKind.AVOIDER_NAN)


@dataclass(frozen=True, eq=False)
class AnswersNaN:
    """Asks the avoider nothing, and answers with NaN."""

    name: str

    def propose(
        self, *, hand_position_in_base_m: Vector, tcp_position_in_base_m: Vector, seed: int
    ) -> Proposal:
        """No number.  ``hand_position_in_base_m`` and ``tcp_position_in_base_m`` (3,)."""
        return Proposal(np.full(3, np.nan))


def faulty(faults: NDArray[np.void], avoider: Avoider, time_s: float) -> Avoider:
    """What ``avoider`` is at ``time_s``, with the faults (n,) FAULT.  ``faults`` (n,) FAULT."""
    return AnswersNaN(avoider.name) if acting(faults, NAN, time_s) else avoider
