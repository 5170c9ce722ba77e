"""Serve a user's avoiders in the process of their file.

This process and the harness call an avoider by the same functions, so that answers and faults are the same in
both. This module must start quickly, so it imports only modules that need no compiler.
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
    """The avoiders that this process serves."""

    what = "an avoider"
    told = to_the_child

    def make(self, message: Make, path: Path, wanted: dict[str, Any]) -> Made:
        """Load the avoider and return its properties."""
        avoider = _avoider(path, message.source, wanted)
        self.made[message.number] = avoider, str(path)
        return Made(
            str(avoider.name),
            spread_threshold_of(avoider),
            decision_time_of(avoider),
            takes_many(avoider),
            shown_to(avoider),
        )

    def answers(self, message: Ask) -> Iterator[Answered]:
        """Yield an answer to each question of a message.

        If the message asks for one batched call, the method tries this call first. If the call fails, the
        method asks one question after another.
        """
        avoider, file = self.made[message.number]
        questions, joint = message.unpacked_questions, []
        if message.together:
            try:
                joint = answers_together(avoider, questions)
            except BaseException:  # separate calls show which question raises
                joint = []
        for k, answer in enumerate(joint or (_answer(avoider, question, file) for question in questions)):
            fault = answer.fault.encode(errors="replace")[:MOST_ANSWER_WORDS].decode(errors="ignore")
            yield Answered(k, replace(answer, fault=fault))


def _avoider(path: Path, source: bytes, wanted: dict[str, Any]) -> Avoider:
    """Return the avoider in an ONNX file, or the avoider with the wanted name in a Python file."""
    if not wanted["onnx"]:
        return avoider_in(path, source, wanted["name"])
    from safety_harness.cell.avoidance.onnx_model import OnnxAvoider  # a Python file does not need it

    hand, tcp = np.array(wanted["hand"]), np.array(wanted["tcp"])
    return OnnxAvoider.load(path, source, hand=hand, tcp=tcp, layout=wanted["name"])


def _answer(avoider: Avoider, question: Question, file: str) -> Answer:
    """Return the avoider's answer.

    Any exception of the avoider becomes a fault.
    """
    try:
        return ask(avoider, question._replace(limit_s=np.inf))  # the other process applies the limit
    except BaseException as error:  # SystemExit, or the user's own, must not end this process
        return Answer(fault=described(error, file))


main = partial(serve, _Avoiders())
