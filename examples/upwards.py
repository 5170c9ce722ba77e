"""An avoider of one's own: straight up, whatever the hand does.

safety-harness run shipped:hand-visits-and-leaves --avoider shipped:upwards.py:Upwards
"""

import numpy as np

from safety_harness import Proposal


class Upwards:
    """100 mm up."""

    name = "straight up"

    def propose(
        self, *, hand_position_in_base_m: np.ndarray, tcp_position_in_base_m: np.ndarray, seed: int
    ) -> Proposal:
        """Positions are (3,) in the base frame, in metres."""
        return Proposal(tcp_position_in_base_m + [0.0, 0.0, 0.1])
