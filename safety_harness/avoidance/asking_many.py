"""Many questions at once: avoiders that can take them together do, the others are asked in turn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Protocol, TypeGuard

import numpy as np
from numpy.typing import NDArray

from safety_harness.avoidance.asking import Answer, answer_of, ask
from safety_harness.avoidance.avoider import Avoider, Proposal, Vector, spread_threshold_of
from safety_harness.avoidance.faulty import Asked
from safety_harness.avoidance.gate import Query
from safety_harness.exceptions import AvoiderError

Vectors = NDArray[np.float64]  # (n, 3)
Questions = Sequence[tuple[int, Vector, Vector, int]]  # (where, hand, TCP, seed)


class BatchAvoider(Protocol):
    """An avoider that answers many questions in one call, each with the bits that ``propose`` gives."""

    @property
    def name(self) -> str:
        """As an ``Avoider`` has it."""
        ...

    def propose(
        self, *, hand_position_in_base_m: Vector, tcp_position_in_base_m: Vector, seed: int
    ) -> Proposal:
        """As an ``Avoider`` does."""
        ...

    def propose_many(
        self, hands_in_base_m: Vectors, tcps_in_base_m: Vectors, seeds: NDArray[np.uint64]
    ) -> tuple[Vectors, Vectors]:
        """Positions and spreads (n, 3) [m] for hands (n, 3), TCPs (n, 3) and seeds (n,)."""
        ...


def takes_many(avoider: Avoider) -> TypeGuard[BatchAvoider]:
    """Can the avoider be asked many questions at once?"""
    return callable(getattr(avoider, "propose_many", None))


def ask_many(
    avoiders: Sequence[Avoider], queries: Sequence[Query], deadlines_s: Sequence[float]
) -> list[Answer]:
    """The answers, in order; those of ``ask`` bit for bit, but for their latency.

    A question of a batch has no time of its own on the clock: its latency is NaN, not timed, and it is
    never late, but where the query says so.  Questions that are asked in turn are timed.
    """
    answers = [Answer()] * len(queries)
    together: dict[int, tuple[BatchAvoider, list[tuple[int, Vector, Vector, int]]]] = {}
    for k, (avoider, query, deadline_s) in enumerate(zip(avoiders, queries, deadlines_s, strict=True)):
        hand, tcp = query.hand_position_in_base_m, query.tcp_position_in_base_m
        one = avoider
        if isinstance(avoider, Asked):
            one, hand, tcp = avoider.avoider, avoider.hand_position_in_base_m, avoider.tcp_position_in_base_m
        if takes_many(one) and not query.late:
            together.setdefault(id(one), (one, []))[1].append((k, hand, tcp, query.seed))
        else:
            answers[k] = ask_one(avoider, query, deadline_s)
    for batch_avoider, questions in together.values():
        found = _batch(batch_avoider, questions)
        for row, (k, *_) in enumerate(questions):
            answers[k] = found[row] if found else ask_one(avoiders[k], queries[k], deadlines_s[k])
    return answers


def ask_one(avoider: Avoider, query: Query, deadline_s: float) -> Answer:
    """One answer, by the clock."""
    return ask(
        avoider,
        hand_position_in_base_m=query.hand_position_in_base_m,
        tcp_position_in_base_m=query.tcp_position_in_base_m,
        seed=query.seed,
        deadline_s=deadline_s,
        late=query.late,
    )


def _batch(avoider: BatchAvoider, questions: Questions) -> list[Answer]:
    """The answers to questions asked together; none where they have to be asked in turn.

    That is where the avoider raises, or does not return two arrays (n, 3): whose fault it is shows then.
    """
    _, hands, tcps, seeds = zip(*questions, strict=True)
    try:
        threshold_m = spread_threshold_of(avoider)
        positions, spreads = avoider.propose_many(
            np.array(hands), np.array(tcps), np.array(seeds, dtype=np.uint64)
        )
    except AvoiderError:
        return []
    except Exception:  # a user's code may raise anything
        return []
    if np.shape(positions) != (len(questions), 3) or np.shape(spreads) != (len(questions), 3):
        return []
    return [
        replace(answer_of(Proposal(position, spread), threshold_m), latency_s=np.nan)
        for position, spread in zip(positions, spreads, strict=True)
    ]
