"""An avoider that sees every hand and its velocity: away from where they will be, weighed by nearness.

safety-harness run scenarios/second-hand.yaml --avoider examples/two_hands.py:AwayFromAll
"""

from __future__ import annotations

import numpy as np

from safety_harness import Proposal
from safety_harness.seams.contract import Seen

AHEAD_S, FAR_M = 0.3, 0.1


class AwayFromAll:
    """100 mm away from all hands as they will be in 0.3 s; its spread is the nearest hand's own."""

    name = "away from all hands"
    sees = ("joints", "predicted hands")

    def propose(
        self,
        *,
        hand_position_in_base_m: np.ndarray,
        tcp_position_in_base_m: np.ndarray,
        seed: int,
        seen: Seen,
    ) -> Proposal:
        """Of ``seen.predicted_hands`` each has a position, a velocity, and the covariance (6, 6) of both."""
        tcp, away = seen.tcp_position_in_base_m, np.zeros(3)
        for hand in seen.predicted_hands:
            way = tcp - hand.position_in_base_m - AHEAD_S * hand.velocity_in_base_mps
            away += way / max(float(way @ way), 1e-4)
        nearest = min(seen.predicted_hands, key=lambda hand: np.linalg.norm(hand.position_in_base_m - tcp))
        spread = np.sqrt(np.diag(nearest.covariance)[:3])
        return Proposal(tcp + FAR_M * away / max(float(np.linalg.norm(away)), 1e-9), spread)
