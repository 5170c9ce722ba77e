"""Answer with a trained network: in one pass, in Monte Carlo dropout passes, or with an ensemble."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from safety_harness.cell.avoidance.avoider import Proposal, Vector, Vectors
from safety_harness.cell.avoidance.model_file import PERCEPTRON, Dropout, Model
from safety_harness.cell.avoidance.perceptron_kernel import Perceptron, decide_perceptron, fold_perceptron
from safety_harness.cell.avoidance.resnet_kernel import FoldedNetwork, decide, fold


@dataclass(frozen=True, eq=False)
class LearnedAvoider:
    """The avoider of eqs. 9 and 10 of the paper.

    Its position is the mean of the passes or members, and its spread is their standard deviation. A decision
    depends only on its hand, TCP and seed. So a decision has the same bits in a batch of any size. Networks
    without dropout ignore the seed.
    """

    model: Model
    name: str
    _network: FoldedNetwork | Perceptron

    @classmethod
    def from_model(cls, model: Model) -> LearnedAvoider:
        """Return the avoider that ``model`` describes."""
        if model.kind == PERCEPTRON:
            name = f"ensemble of {model.members} ReLU students" if model.members > 1 else "ReLU student"
            return cls(model, name, fold_perceptron(model))
        if model.dropout is not Dropout.NONE:
            name = f"MC dropout ({model.dropout.value}, {model.passes} passes)"
        elif model.members > 1:
            name = f"deep ensemble of {model.members}"
        else:
            name = "deterministic network"
        return cls(model, name, fold(model))

    @property
    def spread_threshold_m(self) -> float | None:
        """The largest spread [m] of a usable proposal, or None without a calibration."""
        return self.model.spread_threshold_m

    @property
    def decision_time_s(self) -> float:
        """The simulated time [s] that the card declares for a decision, or 0 if it declares no time."""
        return self.model.decision_time_s

    def propose(
        self, *, hand_position_in_base_m: Vector, tcp_position_in_base_m: Vector, seed: int
    ) -> Proposal:
        """Return the network's proposal.

        ``seed`` is any integer from 0 to 2^64 - 1.
        """
        positions, spreads = self.propose_many(
            np.asarray(hand_position_in_base_m)[None],
            np.asarray(tcp_position_in_base_m)[None],
            np.array([seed], dtype=np.uint64),
        )
        return Proposal(positions[0], spreads[0])

    def propose_many(
        self, hands_in_base_m: Vectors, tcps_in_base_m: Vectors, seeds: NDArray[np.uint64]
    ) -> tuple[Vectors, Vectors]:
        """Return the positions and the spreads for n questions, both (n, 3) [m].

        If a hand or a TCP is not finite, the proposed position is not finite either.

        Args:
            hands_in_base_m: The positions of the hands (n, 3).
            tcps_in_base_m: The positions of the TCP (n, 3).
            seeds: The seeds (n,).

        Raises:
            ValueError: An array has the wrong shape.

        """
        # Copies, since numba would compile everything once more for read-only arrays.
        hands = np.array(hands_in_base_m, dtype=np.float64, order="C")
        tcps = np.array(tcps_in_base_m, dtype=np.float64, order="C")
        keys = np.array(seeds, dtype=np.uint64, order="C")
        if keys.ndim != 1 or hands.shape != (len(keys), 3) or tcps.shape != hands.shape:
            raise ValueError(
                f"expected hands (n, 3), TCPs (n, 3) and seeds (n,); "
                f"got {hands.shape}, {tcps.shape} and {keys.shape}"
            )
        positions, spreads = np.empty(hands.shape), np.empty(hands.shape)
        if isinstance(self._network, Perceptron):
            decide_perceptron(self._network, hands, tcps, positions, spreads)
        else:
            decide(self._network, hands, tcps, keys, positions, spreads)
        return positions, spreads
