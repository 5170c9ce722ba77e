"""Many questions at once: avoiders that can take them together do, the others are asked in turn."""

from __future__ import annotations

from collections.abc import Sequence

from safety_harness.avoidance.asking import Answer, OutOfProcessAvoider, Question, addressed
from safety_harness.avoidance.avoider import Avoider
from safety_harness.avoidance.batches import answers_together, takes_many
from safety_harness.avoidance.gate import Query, answer_to


def ask_many(avoiders: Sequence[Avoider], queries: Sequence[Query]) -> list[Answer]:
    """The answers, in order; those of ``ask`` bit for bit, but for their latency.

    A question of a batch has no time of its own on the clock: its latency is NaN, not timed.  Questions
    that are asked in turn are timed.  An avoider in another process gets all its questions in one
    message, and does either there.  NoAnswerError for one that hangs.
    """
    answers = [Answer()] * len(queries)
    together: dict[int, tuple[Avoider, list[tuple[int, Question]]]] = {}
    for k, (avoider, query) in enumerate(zip(avoiders, queries, strict=True)):
        one, hand, tcp = addressed(avoider, query.hand_position_in_base_m, query.tcp_position_in_base_m)
        if (takes_many(one) or isinstance(one, OutOfProcessAvoider)) and not query.late:
            question = Question(hand, tcp, query.seed, query.limit_s)
            together.setdefault(id(one), (one, []))[1].append((k, question))
        else:
            answers[k] = answer_to(avoider, query)
    for one, numbered in together.values():
        found = _answers(one, [question for _, question in numbered])
        for row, (k, _) in enumerate(numbered):
            answers[k] = found[row] if found else answer_to(avoiders[k], queries[k])
    return answers


def _answers(avoider: Avoider, questions: Sequence[Question]) -> list[Answer]:
    """To all of them; none where they have to be asked in turn."""
    if isinstance(avoider, OutOfProcessAvoider):
        return avoider.answers(questions, together=True)
    return answers_together(avoider, questions) if takes_many(avoider) else []
