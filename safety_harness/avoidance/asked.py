"""An avoider whose answer counts later than it was asked: a fault of the scenario."""

from __future__ import annotations

from dataclasses import dataclass

from safety_harness.avoidance.around import AvoiderAround
from safety_harness.avoidance.avoider import Proposal, Vector


@dataclass(frozen=True, eq=False)
class DelayedQuery(AvoiderAround):
    """Answers the question that was asked earlier, whatever it is asked now."""

    hand_position_in_base_m: Vector
    tcp_position_in_base_m: Vector

    def propose(
        self, *, hand_position_in_base_m: Vector, tcp_position_in_base_m: Vector, seed: int
    ) -> Proposal:
        """What the avoider says of the hand and the TCP as they were then.

        ``hand_position_in_base_m`` and ``tcp_position_in_base_m`` (3,).
        """
        return self.avoider.propose(
            hand_position_in_base_m=self.hand_position_in_base_m.copy(),
            tcp_position_in_base_m=self.tcp_position_in_base_m.copy(),
            seed=seed,
        )
