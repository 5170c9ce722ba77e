"""Avoiders that answer many questions in one call, and asking them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Protocol, TypeGuard

import numpy as np
from numpy.typing import NDArray

from safety_harness.avoidance.asking import Answer, Question, answer_of, interrupted_after
from safety_harness.avoidance.avoider import Avoider, Proposal, Vector, spread_threshold_of

Vectors = NDArray[np.float64]  # (n, 3)
EACH_S = 1.0


class BatchAvoider(Protocol):
    """An avoider that answers many questions in one call, each with the bits that ``propose`` gives."""

    @property
    def name(self) -> str:
        """As an ``Avoider`` has it."""
        ...

    def propose(
        self, *, hand_position_in_base_m: Vector, tcp_position_in_base_m: Vector, seed: int
    ) -> Proposal:
        """As an ``Avoider`` does.  ``hand_position_in_base_m`` and ``tcp_position_in_base_m`` (3,)."""
        ...

    def propose_many(
        self, hands_in_base_m: Vectors, tcps_in_base_m: Vectors, seeds: NDArray[np.uint64]
    ) -> tuple[Vectors, Vectors]:
        """Positions and spreads (n, 3) [m] for hands (n, 3), TCPs (n, 3) and seeds (n,).  ``seeds`` (n,)."""
        ...


def takes_many(avoider: Avoider) -> TypeGuard[BatchAvoider]:
    """Can the avoider be asked many questions at once?"""
    return callable(getattr(avoider, "propose_many", None))


def limit_of(questions: Sequence[Question]) -> float:
    """How long the answers to questions asked together are waited for; then they are asked in turn."""
    return max(question.limit_s for question in questions) + EACH_S * len(questions)


def answers_together(avoider: BatchAvoider, questions: Sequence[Question]) -> list[Answer]:
    """The answers to questions asked together; none where they have to be asked in turn.

    That is where the avoider raises, hangs, or does not return two arrays (n, 3): whose fault it is shows
    then.
    """
    try:
        threshold_m = spread_threshold_of(avoider)
        with interrupted_after(limit_of(questions), avoider.name):
            positions, spreads = avoider.propose_many(
                np.array([question.hand_position_in_base_m for question in questions]),
                np.array([question.tcp_position_in_base_m for question in questions]),
                np.array([question.seed for question in questions], dtype=np.uint64),
            )
        if np.shape(positions) != (len(questions), 3) or np.shape(spreads) != (len(questions), 3):
            return []
        return [
            replace(answer_of(Proposal(position, spread), threshold_m), latency_s=np.nan)
            for position, spread in zip(positions, spreads, strict=True)
        ]
    except Exception:  # a user's code may raise anything
        return []
