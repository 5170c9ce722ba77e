"""Ask an avoider many questions.

If the avoider supports batches, it receives many questions in one call.  Otherwise, or if a batch fails, it
receives one question at a time.
"""

from __future__ import annotations

import numpy as np

from safety_harness.cell.avoidance.asking import (
    Answer,
    BatchAvoider,
    OutOfProcessAvoider,
    ask,
    interrupted_after,
    limit_of,
    takes_many,
)
from safety_harness.cell.avoidance.avoider import Avoider, spread_threshold_of
from safety_harness.extensions.lab.scoring.questions import Answers, Questions

CHUNK = 2_048  # questions in a call; a choice
FEW = 16  # a failed chunk is halved down to this size; then its questions are asked one by one


def asked_together(avoider: Avoider, questions: Questions) -> Answers:
    """Return the answers to many questions, in the order of the questions.

    An avoider that supports batches receives chunks of ``CHUNK`` questions.  If a chunk fails, the function
    divides it into smaller chunks, and finally asks one question at a time.

    Args:
        avoider: The avoider.
        questions: The questions.

    Raises:
        NoAnswerError: The avoider does not return from a call.

    """
    starts = range(0, len(questions), CHUNK)
    return Answers.joined([_of_chunk(avoider, questions[start : start + CHUNK]) for start in starts])


def asked_alone(avoider: Avoider, questions: Questions) -> tuple[Answers, list[float]]:
    """Ask one question at a time, and return the answers and the time of each answer [s].

    Args:
        avoider: The avoider.
        questions: The questions.

    """
    answers = [ask(avoider, questions.single(row)) for row in range(len(questions))]
    return _arrays(answers), [answer.latency_s for answer in answers]


def _of_chunk(avoider: Avoider, questions: Questions) -> Answers:
    """Return the answers to the questions of one chunk."""
    if isinstance(avoider, OutOfProcessAvoider):
        every = [questions.single(row) for row in range(len(questions))]
        return _arrays(avoider.answers(every, together=True))
    if takes_many(avoider):
        answers = _at_once(avoider, questions)
        if answers is not None:
            return answers
        if len(questions) > FEW:
            half = len(questions) // 2
            return Answers.joined(
                [_of_chunk(avoider, questions[:half]), _of_chunk(avoider, questions[half:])]
            )
    return asked_alone(avoider, questions)[0]


def _at_once(avoider: BatchAvoider, questions: Questions) -> Answers | None:
    """Return the answers to a chunk from a single call.

    The result is None if the call fails or if at least one answer is invalid.
    """
    try:
        threshold_m = spread_threshold_of(avoider)
        every = [questions.single(0)] * len(questions)
        with interrupted_after(limit_of(every), avoider.name):
            # Copies, because a user's code may change its arguments.
            positions, spreads = avoider.propose_many(
                questions.hands_in_base_m.copy(), questions.tcps_in_base_m.copy(), questions.seeds.copy()
            )
        shapes = np.shape(positions), np.shape(spreads)
        if shapes != (questions.hands_in_base_m.shape,) * 2:
            return None
        sound = np.isfinite(positions).all() and np.isfinite(spreads).all() and np.min(spreads) >= 0.0
        thresholds_m = np.full(len(questions), np.nan if threshold_m is None else threshold_m)
        answers = Answers(np.array(positions, float), np.array(spreads, float), thresholds_m, {})
    except Exception:  # a user's code may raise anything
        return None
    return answers if sound else None


def _arrays(answers: list[Answer]) -> Answers:
    """Convert a list of answers to arrays."""
    return Answers(
        np.array([answer.proposal.position_in_base_m for answer in answers]).reshape(-1, 3),
        np.array([answer.proposal.spread_m for answer in answers]).reshape(-1, 3),
        np.array([answer.spread_threshold_m for answer in answers]),
        {row: answer.fault for row, answer in enumerate(answers) if answer.fault},
    )
