"""The oracle that the networks learn from: the candidate with the least image error, eq. 13."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from safety_harness.avoidance.avoider import Proposal, Vector, proposed_in_turn
from safety_harness.avoidance.candidates import CandidateCap
from safety_harness.settings import Settings

Vectors = NDArray[np.float64]  # (n, 3)


@dataclass(frozen=True, eq=False)
class NearestCandidate:
    """gt = 0.05 (t_tcp - t_h) + t_opt (eq. 13), t_opt the candidate with the least image error.

    With the desired orientation kept, the image-moment error of a candidate is exactly its
    displacement from the desired position, so "least image error" is "nearest to the desired
    TCP"; the candidates of a decision are drawn from the decision's seed.
    """

    cap: CandidateCap
    desired_tcp_position_in_base_m: Vector
    hand_pull: float
    name: str = "nearest candidate"

    @classmethod
    def of(cls, settings: Settings) -> NearestCandidate:
        """The oracle for the settings' cell."""
        return cls(
            CandidateCap.of(settings),
            np.array(settings.cell.desired_tcp_position_in_base_m),
            settings.avoidance.hand_pull,
        )

    def propose(
        self, *, hand_position_in_base_m: Vector, tcp_position_in_base_m: Vector, seed: int
    ) -> Proposal:
        """Eq. 13 with fresh candidates.  ``hand_position_in_base_m`` and ``tcp_position_in_base_m`` (3,)."""
        candidates = tcp_position_in_base_m + self.cap.draw(np.random.default_rng(seed))  # (count, 3)
        errors = np.linalg.norm(candidates - self.desired_tcp_position_in_base_m, axis=1)
        selected = candidates[int(np.argmin(errors))]
        return Proposal(selected + self.hand_pull * (tcp_position_in_base_m - hand_position_in_base_m))

    def propose_many(
        self, hands_in_base_m: Vectors, tcps_in_base_m: Vectors, seeds: NDArray[np.uint64]
    ) -> tuple[Vectors, Vectors]:
        """Positions and spreads (n, 3) [m] for hands (n, 3), TCPs (n, 3) and seeds (n,).  ``seeds`` (n,)."""
        return proposed_in_turn(self, hands_in_base_m, tcps_in_base_m, seeds)
