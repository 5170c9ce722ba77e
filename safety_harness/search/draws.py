"""Other draws of an avoider's own randomness."""

from __future__ import annotations

from dataclasses import dataclass

from safety_harness.avoidance.around import AvoiderAround
from safety_harness.avoidance.avoider import Proposal, Vector
from safety_harness.seeds import Branch
from safety_harness.seeds import seed as leaf


@dataclass(frozen=True, eq=False)
class OtherDraws(AvoiderAround):
    """An avoider with other seeds: the k-th stream of its own randomness."""

    stream: int

    def propose(
        self, *, hand_position_in_base_m: Vector, tcp_position_in_base_m: Vector, seed: int
    ) -> Proposal:
        """What the avoider says with another seed."""
        return self.avoider.propose(
            hand_position_in_base_m=hand_position_in_base_m,
            tcp_position_in_base_m=tcp_position_in_base_m,
            seed=leaf(seed, Branch.SEARCH, 5, self.stream),
        )
