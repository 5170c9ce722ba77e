"""The plain opposite pose: straight away from the hand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from safety_harness.avoidance.avoider import Proposal, Vector, proposed_in_turn
from safety_harness.exceptions import AvoiderError

Vectors = NDArray[np.float64]  # (n, 3)


@dataclass(frozen=True)
class OppositePose:
    """t_tcp + R (t_tcp - t_h) / |t_tcp - t_h|: the point ``radius_m`` away, opposite to the hand."""

    radius_m: float
    name: str = "opposite pose"

    def propose(
        self, *, hand_position_in_base_m: Vector, tcp_position_in_base_m: Vector, seed: int
    ) -> Proposal:
        """The opposite pose; AvoiderError when hand and TCP coincide, for then there is none.

        ``hand_position_in_base_m`` and ``tcp_position_in_base_m`` (3,).
        """
        away = tcp_position_in_base_m - hand_position_in_base_m
        distance = float(np.linalg.norm(away))
        if not distance > 0.0:
            raise AvoiderError("the hand is at the TCP: there is no opposite direction")
        return Proposal(tcp_position_in_base_m + self.radius_m / distance * away)

    def propose_many(
        self, hands_in_base_m: Vectors, tcps_in_base_m: Vectors, seeds: NDArray[np.uint64]
    ) -> tuple[Vectors, Vectors]:
        """Positions and spreads (n, 3) [m] for hands (n, 3), TCPs (n, 3) and seeds (n,).  ``seeds`` (n,)."""
        return proposed_in_turn(self, hands_in_base_m, tcps_in_base_m, seeds)
