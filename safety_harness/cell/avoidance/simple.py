"""The avoiders that need no network, and how they answer many questions: one after another."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.exceptions import AvoiderError
from safety_harness.base.settings import Settings
from safety_harness.cell.avoidance.avoider import Avoider, Proposal, Vector, Vectors
from safety_harness.cell.avoidance.candidates import CandidateCap
from safety_harness.scenario.fault_table import acting
from safety_harness.scenario.faults import FaultKind

NAN = np.int64(FaultKind.AVOIDER_NAN)


class _QuickAvoider:
    """One that is quick enough to be asked one question of many after another."""

    def propose_many(
        self: Avoider, hands_in_base_m: Vectors, tcps_in_base_m: Vectors, seeds: NDArray[np.uint64]
    ) -> tuple[Vectors, Vectors]:
        """Positions and spreads (n, 3) [m] for hands (n, 3), TCPs (n, 3) and seeds (n,).  ``seeds`` (n,)."""
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


@dataclass(frozen=True, eq=False)
class NearestCandidate(_QuickAvoider):
    """The oracle that the networks learn from: gt = 0.05 (t_tcp - t_h) + t_opt (eq. 13).

    t_opt is the candidate with the least image error.  With the desired orientation kept, the image-moment
    error of a candidate is exactly its displacement from the desired position, so "least image error" is
    "nearest to the desired TCP"; the candidates of a decision are drawn from the decision's seed.
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


@dataclass(frozen=True, eq=False)
class AnswersNaN:
    """A fault of the scenario: asks the avoider nothing, and answers with NaN."""

    name: str

    def propose(
        self, *, hand_position_in_base_m: Vector, tcp_position_in_base_m: Vector, seed: int
    ) -> Proposal:
        """No number.  ``hand_position_in_base_m`` and ``tcp_position_in_base_m`` (3,)."""
        return Proposal(np.full(3, np.nan))


def faulty(faults: NDArray[np.void], avoider: Avoider, time_s: float) -> Avoider:
    """What ``avoider`` is at ``time_s``, with the faults (n,) FAULT.  ``faults`` (n,) FAULT."""
    return AnswersNaN(avoider.name) if acting(faults, NAN, time_s) else avoider
