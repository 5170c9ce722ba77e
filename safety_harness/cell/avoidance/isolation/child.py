"""Avoiders in the process of a user's file.

The same functions ask here as at home, so that an answer and a fault are the same in both.
It must start quickly: nothing imported here waits for a compiler.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from safety_harness.base.exceptions import described
from safety_harness.cell.avoidance.asking import Answer, Question, answers_together, ask, takes_many
from safety_harness.cell.avoidance.avoider import Avoider, decision_time_of, shown_to, spread_threshold_of
from safety_harness.cell.avoidance.isolation.messages import (
    MOST_ANSWER_WORDS,
    Answered,
    Ask,
    Made,
    to_the_child,
)
from safety_harness.cell.avoidance.python_file import avoider_in
from safety_harness.seams.isolation.child import ServedKind, serve
from safety_harness.seams.isolation.messages import Make


class _Avoiders(ServedKind):
    what = "an avoider"
    told = to_the_child

    def make(self, told: Make, path: Path, wanted: dict[str, Any]) -> Made:
        avoider = _avoider(path, told.source, wanted)
        self.made[told.number] = avoider, str(path)
        return Made(
            str(avoider.name),
            spread_threshold_of(avoider),
            decision_time_of(avoider),
            takes_many(avoider),
            shown_to(avoider),
        )

    def answers(self, told: Ask) -> Iterator[Answered]:
        """All together if that is asked and it can, else each as soon as it is there."""
        avoider, file = self.made[told.number]
        questions, found = told.asked, []
        if told.together:
            try:
                found = answers_together(avoider, questions)
            except BaseException:  # what raises shows when they are asked in turn
                found = []
        for k, answer in enumerate(found or (_answer(avoider, question, file) for question in questions)):
            words = answer.fault.encode(errors="replace")[:MOST_ANSWER_WORDS].decode(errors="ignore")
            yield Answered(k, replace(answer, fault=words))


def _avoider(path: Path, source: bytes, wanted: dict[str, Any]) -> Avoider:
    """What a program has under a name, or what a model is."""
    if not wanted["onnx"]:
        return avoider_in(path, source, wanted["name"])
    from safety_harness.cell.avoidance.onnx_model import OnnxAvoider  # no program waits for its runtime

    hand, tcp = np.array(wanted["hand"]), np.array(wanted["tcp"])
    return OnnxAvoider.of(path, source, hand=hand, tcp=tcp, layout=wanted["name"])


def _answer(avoider: Avoider, question: Question, file: str) -> Answer:
    try:
        return ask(avoider, question._replace(limit_s=np.inf))  # the other side keeps it
    except BaseException as error:  # SystemExit, or the user's own: no reason to end
        return Answer(fault=described(error, file))


main = partial(serve, _Avoiders())
