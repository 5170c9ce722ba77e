"""Define the avoiders that need no network.

These avoiders answer the questions of a batch one after another.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.elementary import length
from safety_harness.base.exceptions import AvoiderError
from safety_harness.base.settings import Settings
from safety_harness.cell.avoidance.avoider import Avoider, Proposal, Vector, Vectors
from safety_harness.cell.avoidance.candidates import CandidateCap
from safety_harness.scenario.fault_table import acting
from safety_harness.scenario.faults import FaultKind

NAN = np.int64(FaultKind.AVOIDER_NAN)


class _QuickAvoider:
    """An avoider that is quick enough to answer the questions of a batch one after another."""

    def propose_many(
        self: Avoider, hands_in_base_m: Vectors, tcps_in_base_m: Vectors, seeds: NDArray[np.uint64]
    ) -> tuple[Vectors, Vectors]:
        """Return the positions and the spreads for n questions, both (n, 3) [m].

        Hands and TCPs have the shape (n, 3), and ``seeds`` has the shape (n,).
        """
        proposals = [
            self.propose(hand_position_in_base_m=hand, tcp_position_in_base_m=tcp, seed=int(seed))
            for hand, tcp, seed in zip(hands_in_base_m, tcps_in_base_m, seeds, strict=True)
        ]
        return (
            np.array([proposal.position_in_base_m for proposal in proposals]).reshape(-1, 3),
            np.array([proposal.spread_m for proposal in proposals]).reshape(-1, 3),
        )


@dataclass(frozen=True)
class OppositePose(_QuickAvoider):
    """The avoider that moves the TCP away from the hand by R = ``radius_m``.

    Its position is t_tcp + R (t_tcp - t_h) / |t_tcp - t_h|.
    """

    radius_m: float
    name: str = "opposite pose"

    def propose(
        self, *, hand_position_in_base_m: Vector, tcp_position_in_base_m: Vector, seed: int
    ) -> Proposal:
        """Return the opposite pose.

        Raise ``AvoiderError`` if hand and TCP coincide, because the direction is then undefined.
        ``hand_position_in_base_m`` and ``tcp_position_in_base_m`` have the shape (3,).
        """
        away = tcp_position_in_base_m - hand_position_in_base_m
        distance = length(away)
        if not distance > 0.0:
            raise AvoiderError("the hand is at the TCP: there is no opposite direction")
        return Proposal(tcp_position_in_base_m + self.radius_m / distance * away)


@dataclass(frozen=True, eq=False)
class NearestCandidate(_QuickAvoider):
    """The oracle that the networks learn from.

    Its answer is t_opt + ``hand_pull`` (t_tcp - t_h), which is eq. 13. Here t_opt is the candidate with the
    least image error. In the desired orientation, the image-moment error of a candidate equals its
    displacement from the desired position. So "least image error" means "nearest to the desired TCP". The
    seed of the decision determines the candidates.
    """

    cap: CandidateCap
    desired_tcp_position_in_base_m: Vector
    hand_pull: float
    name: str = "nearest candidate"

    @classmethod
    def for_cell(cls, settings: Settings) -> NearestCandidate:
        """Return the oracle for the cell that the settings describe."""
        return cls(
            CandidateCap.from_settings(settings),
            np.array(settings.cell.desired_tcp_position_in_base_m),
            settings.avoidance.hand_pull,
        )

    def propose(
        self, *, hand_position_in_base_m: Vector, tcp_position_in_base_m: Vector, seed: int
    ) -> Proposal:
        """Return the answer of eq. 13 with new candidates.

        ``seed`` determines the candidates. ``hand_position_in_base_m`` and ``tcp_position_in_base_m`` have
        the shape (3,).
        """
        candidates = tcp_position_in_base_m + self.cap.draw(np.random.default_rng(seed))  # (count, 3)
        errors = np.linalg.norm(candidates - self.desired_tcp_position_in_base_m, axis=1)
        selected = candidates[int(np.argmin(errors))]
        return Proposal(selected + self.hand_pull * (tcp_position_in_base_m - hand_position_in_base_m))


@dataclass(frozen=True, eq=False)
class AnswersNaN:
    """The avoider that replaces the avoider ``name`` during a fault of the scenario.

    Its answer is NaN.
    """

    name: str

    def propose(
        self, *, hand_position_in_base_m: Vector, tcp_position_in_base_m: Vector, seed: int
    ) -> Proposal:
        """Return a proposal of NaN.

        ``hand_position_in_base_m`` and ``tcp_position_in_base_m`` have the shape (3,).
        """
        return Proposal(np.full(3, np.nan))


def faulty(faults: NDArray[np.void], avoider: Avoider, time_s: float) -> Avoider:
    """Return ``avoider``, or an avoider that answers NaN if such a fault acts at ``time_s``.

    ``faults`` (n,) contains records FAULT.
    """
    return AnswersNaN(avoider.name) if acting(faults, NAN, time_s) else avoider
