"""Serve a user's controllers in the process of their file, one controller for each lane of episodes.

This module must start quickly, so it imports only modules that need no compiler.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from safety_harness.base.exceptions import Place, printable
from safety_harness.cell.controller.answers import LaneAnswers, answers_many, ask_together
from safety_harness.cell.controller.out_of_process.messages import (
    PROTOCOL,
    ActOnRows,
    MadeController,
    Ready,
    Reset,
    SaidPrediction,
    SaidRow,
    SaidRows,
    prediction_at,
    to_the_process,
)
from safety_harness.cell.controller.python_file import controller_in
from safety_harness.seams.contract import (
    DECISIONS,
    IMAGE,
    Answer,
    Image,
    Predicted,
    UserController,
    acts_per_answer_of,
    reports_of,
    sees_of,
)
from safety_harness.seams.isolation.child import ServedKind, serve
from safety_harness.seams.isolation.messages import MOST_WORDS, Make
from safety_harness.seams.rows import layout_of, unpacked

Another = Callable[[], UserController]


class _Controllers(ServedKind):
    """The controllers that this process serves."""

    what = "a controller"
    told = to_the_process
    made: dict[int, UserController]  # by lane
    another: Another | None
    image: Image | None = None

    def make(self, message: Make, path: Path, wanted: dict[str, Any]) -> MadeController:
        """Load the first controller of the file, and return its description."""
        controller, self.another = _controller(path, message.source, wanted["name"], wanted["onnx"])
        self.made, self.file = {0: controller}, str(path)
        sees, reports = sees_of(controller), reports_of(controller)
        self.reports = reports
        many = self.another is not None and IMAGE not in sees and DECISIONS not in reports
        together, acts = answers_many(controller), acts_per_answer_of(controller)
        return MadeController(PROTOCOL, controller.name, sees, reports, many, together, acts)

    def answers(self, message: Reset | ActOnRows) -> Iterator[Ready | SaidRow | SaidRows | SaidPrediction]:
        """Yield the single answer to ``message``."""
        yield self._reset(message) if isinstance(message, Reset) else self._act(message)

    def _reset(self, message: Reset) -> Ready:
        """Begin an episode in a lane.

        If the lane is new, the method creates a new controller.
        """
        self.image = None
        while len(self.made) <= message.lane:
            assert self.another is not None
            self.made[len(self.made)] = self.another()
        controller, seed = self.made[message.lane], int(message.seed)
        controller.reset(settings=message.settings, arm=message.arm, start=message.start, seed=seed)
        self._answers = LaneAnswers(len(self.made), len(message.arm.joint_names), self.reports)
        return Ready()

    def _act(self, message: ActOnRows) -> SaidRow | SaidRows | SaidPrediction:
        """Return the answers of the lanes in ``message``."""
        own, answers = message.lanes, self._answers
        controllers = [self.made[lane] for lane in own]
        if not message.together:
            answer, (lane,) = self._alone(controllers[0], message), own
            if isinstance(answer, Predicted):
                return prediction_at(message.tick, answer)
            action = answers.take(lane, answer)
            by_joints, stop = bool(answers.by_joints[lane]), bool(answers.stop[lane])
            wanted = (answers.joints if by_joints else answers.twists)[lane].tobytes()
            decision = getattr(action.report, "decision", None) if DECISIONS in self.reports else None
            return SaidRow(message.tick, wanted, by_joints, stop, int(answers.modes[lane]), decision)
        period_s, *layout, sent = message.seen
        rows = np.frombuffer(sent).reshape(len(own), -1)
        why = ask_together(controllers, own, rows, period_s, layout_of(*layout), answers, self.file)
        reasons = {lane: printable(why[lane])[:MOST_WORDS] for lane in why}
        return SaidRows(message.tick, [column[own].tobytes() for column in answers.columns], reasons)

    def _alone(self, controller: UserController, message: ActOnRows) -> Answer:
        """Return the answer of a single controller.

        Only a single controller may see an image.
        """
        seen = unpacked(message.seen)
        if message.image is not None:
            time_s, new, width, sent = message.image
            pixels = np.frombuffer(sent, np.uint8).reshape(-1, max(width, 1), 3)
            pixels = pixels if new or self.image is None else self.image.pixels
            seen.__dict__["image"] = self.image = Image(time_s=time_s, new=new, pixels=pixels)
        return controller.act(seen)


def _controller(path: Path, source: bytes, name: str, onnx: bool) -> tuple[UserController, Another | None]:
    """Return a file's controller, and a function that makes another one.

    The function is None if the file cannot make another controller.
    """
    if not onnx:
        controller = controller_in(path, source, name, Place(field="controller"))
        kind = type(controller)
        named = getattr(sys.modules.get(kind.__module__), name, None)
        return controller, kind if named is kind else None
    from safety_harness.cell.controller.out_of_process.onnx_policy import (
        OnnxPolicy,  # a Python file does not need it
    )

    policy = OnnxPolicy(path, source, name)
    return policy, policy.another


main = partial(serve, _Controllers())
