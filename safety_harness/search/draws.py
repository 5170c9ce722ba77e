"""Other draws of an avoider's own randomness."""

from __future__ import annotations

from dataclasses import dataclass

from safety_harness.avoidance.avoider import Avoider, Proposal, Vector, spread_threshold_of
from safety_harness.seeds import Branch
from safety_harness.seeds import seed as leaf


@dataclass(frozen=True, eq=False)
class OtherDraws:
    """An avoider with other seeds: the k-th stream of its own randomness."""

    avoider: Avoider
    stream: int

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
        """What the avoider says with another seed."""
        return self.avoider.propose(
            hand_position_in_base_m=hand_position_in_base_m,
            tcp_position_in_base_m=tcp_position_in_base_m,
            seed=leaf(seed, Branch.SEARCH, 5, self.stream),
        )
