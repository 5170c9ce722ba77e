"""The avoider under test: away from the hand, in the plane of the table, and a little upwards."""

from __future__ import annotations

import numpy as np

from safety_harness import Proposal

STEP_M, LIFT_M = 0.090, 0.040


class Sidestep:
    """90 mm away from the hand on the level, 40 mm up."""

    name = "sidestep"

    def propose(
        self, *, hand_position_in_base_m: np.ndarray, tcp_position_in_base_m: np.ndarray, seed: int
    ) -> Proposal:
        """A hand straight above or below is given way to along x."""
        away = (tcp_position_in_base_m - hand_position_in_base_m) * [1.0, 1.0, 0.0]
        length_m = np.linalg.norm(away)
        direction = away / length_m if length_m > 1e-6 else np.array([1.0, 0.0, 0.0])
        return Proposal(tcp_position_in_base_m + STEP_M * direction + [0.0, 0.0, LIFT_M])
