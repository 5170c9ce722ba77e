"""What runs in the process of a user's file: it makes its avoiders and answers questions.

The same functions ask here as at home, so that an answer and a fault are the same in both.
It must start quickly: nothing imported here waits for a compiler.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from safety_harness.base.exceptions import InputError, described, printable
from safety_harness.cell.avoidance.asking import Answer, Question, answers_together, ask, takes_many
from safety_harness.cell.avoidance.avoider import Avoider, decision_time_of, shown_to, spread_threshold_of
from safety_harness.cell.avoidance.isolation.frames import (
    MOST_ANSWER_WORDS,
    MOST_QUESTION_BYTES,
    Answered,
    Ask,
    Drop,
    Made,
    Make,
    Refused,
    packed,
    to_the_child,
)
from safety_harness.cell.avoidance.python_file import avoider_in
from safety_harness.seams.isolation.child import Ends


def main(question_fd: int, answer_fd: int) -> None:
    """Answer until the other side is gone."""
    _Child(Ends(question_fd, answer_fd)).serve()


class _Child:
    """The avoiders made so far, by number."""

    def __init__(self, ends: Ends) -> None:
        self._ends = ends
        self._avoiders: dict[int, tuple[Avoider, str]] = {}  # and their file

    def serve(self) -> None:
        """One message after another."""
        while True:
            told = to_the_child.decode(self._ends.read(MOST_QUESTION_BYTES))
            if isinstance(told, Make):
                self._ends.write(packed(self._make(told)))
            elif isinstance(told, Drop):
                self._avoiders.pop(told.number, None)
            else:
                for k, answer in enumerate(self._answers(told)):
                    words = answer.fault.encode(errors="replace")[:MOST_ANSWER_WORDS].decode(errors="ignore")
                    self._ends.write(packed(Answered(k, replace(answer, fault=words))))

    def _make(self, told: Make) -> Made | Refused:
        """An avoider under the number that is told."""
        asked = json.loads(told.wanted)
        path = Path(asked["path"])
        sys.path[:] = asked["sys_path"]
        try:
            os.chdir(asked["folder"])
            avoider = _avoider(path, told.source, asked)
            self._avoiders[told.number] = avoider, str(path)
            return Made(
                str(avoider.name),
                spread_threshold_of(avoider),
                decision_time_of(avoider),
                takes_many(avoider),
                shown_to(avoider),
            )
        except InputError as error:
            words = error.expected, error.got, error.hint, error.place.field or ""
        except BaseException as error:  # a user's code may raise anything
            what = asked.get("attribute", path.name)
            words = f"{what} to be an avoider", described(error, str(path)), "", ""
        return Refused(*map(printable, words))

    def _answers(self, told: Ask) -> Iterator[Answer]:
        """All together if that is asked and it can, else each as soon as it is there."""
        avoider, file = self._avoiders[told.number]
        questions, found = told.asked, []
        if told.together:
            try:
                found = answers_together(avoider, questions)
            except BaseException:  # what raises shows when they are asked in turn
                found = []
        yield from found or (_answer(avoider, question, file) for question in questions)


def _avoider(path: Path, source: bytes, asked: dict[str, Any]) -> Avoider:
    """What a program has under a name, or what a model is."""
    if "attribute" in asked:
        return avoider_in(path, source, asked["attribute"])
    from safety_harness.cell.avoidance.onnx_model import OnnxAvoider  # no program waits for its runtime

    hand, tcp = np.array(asked["hand"]), np.array(asked["tcp"])
    return OnnxAvoider.of(path, source, hand=hand, tcp=tcp, layout=asked["layout"])


def _answer(avoider: Avoider, question: Question, file: str) -> Answer:
    try:
        return ask(avoider, question._replace(limit_s=np.inf))  # the other side keeps it
    except BaseException as error:  # SystemExit, or the user's own: no reason to end
        return Answer(fault=described(error, file))
