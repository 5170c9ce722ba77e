"""Controllers in the process of a user's file, one for each lane, episode after episode.

It must start quickly: nothing imported here waits for a compiler.
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
    SaidRow,
    SaidRows,
    to_the_process,
)
from safety_harness.cell.controller.python_file import controller_in
from safety_harness.seams.contract import DECISIONS, IMAGE, Action, Image, UserController, reports_of, sees_of
from safety_harness.seams.isolation.child import ServedKind, serve
from safety_harness.seams.isolation.messages import MOST_WORDS, Make
from safety_harness.seams.rows import layout_of, unpacked

Another = Callable[[], UserController]


class _Controllers(ServedKind):
    what = "a controller"
    told = to_the_process
    made: dict[int, UserController]  # by lane
    another: Another | None
    image: Image | None = None

    def make(self, told: Make, path: Path, wanted: dict[str, Any]) -> MadeController:
        controller, self.another = _controller(path, told.source, wanted["name"], wanted["onnx"])
        self.made, self.file = {0: controller}, str(path)
        sees, reports = sees_of(controller), reports_of(controller)
        self.reports = reports
        many = self.another is not None and IMAGE not in sees and DECISIONS not in reports
        return MadeController(PROTOCOL, controller.name, sees, reports, many, answers_many(controller))

    def answers(self, told: Reset | ActOnRows) -> Iterator[Ready | SaidRow | SaidRows]:
        yield self._reset(told) if isinstance(told, Reset) else self._act(told)

    def _reset(self, told: Reset) -> Ready:
        self.image = None
        while len(self.made) <= told.lane:
            assert self.another is not None
            self.made[len(self.made)] = self.another()
        controller, seed = self.made[told.lane], int(told.seed)
        controller.reset(settings=told.settings, arm=told.arm, start=told.start, seed=seed)
        self._answers = LaneAnswers(len(self.made), len(told.arm.joint_names), self.reports)
        return Ready()

    def _act(self, told: ActOnRows) -> SaidRow | SaidRows:
        own, answers = told.lanes, self._answers
        controllers = [self.made[lane] for lane in own]
        if not told.together:
            action, (lane,) = self._alone(controllers[0], told), own
            answers.take(lane, action)
            by_joints, stop = bool(answers.by_joints[lane]), bool(answers.stop[lane])
            wanted = (answers.joints if by_joints else answers.twists)[lane].tobytes()
            decision = getattr(action.report, "decision", None) if DECISIONS in self.reports else None
            return SaidRow(told.tick, wanted, by_joints, stop, int(answers.modes[lane]), decision)
        period_s, *layout, sent = told.seen
        rows = np.frombuffer(sent).reshape(len(own), -1)
        why = ask_together(controllers, own, rows, period_s, layout_of(*layout), answers, self.file)
        words = {lane: printable(why[lane])[:MOST_WORDS] for lane in why}
        return SaidRows(told.tick, [one[own].tobytes() for one in answers.columns], words)

    def _alone(self, controller: UserController, told: ActOnRows) -> Action:
        seen = unpacked(told.seen)
        if told.image is not None:
            time_s, new, width, sent = told.image
            pixels = np.frombuffer(sent, np.uint8).reshape(-1, max(width, 1), 3)
            pixels = pixels if new or self.image is None else self.image.pixels
            seen.__dict__["image"] = self.image = Image(time_s=time_s, new=new, pixels=pixels)
        return controller.act(seen)


def _controller(path: Path, source: bytes, name: str, onnx: bool) -> tuple[UserController, Another | None]:
    """What a program has under a name, or what a policy is; and what makes another, if anything."""
    if not onnx:
        found = controller_in(path, source, name, Place(field="controller"))
        kind = type(found)
        named = getattr(sys.modules.get(kind.__module__), name, None)
        return found, kind if named is kind else None
    from safety_harness.cell.controller.out_of_process.onnx_policy import (
        OnnxPolicy,  # no program waits for it
    )

    policy = OnnxPolicy(path, source, name)
    return policy, policy.another


main = partial(serve, _Controllers())
