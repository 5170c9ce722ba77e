"""What runs in the process of a user's controller: it makes it, and passes on what is said.

It must start quickly: nothing imported here waits for a compiler.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np

from safety_harness.base.exceptions import ControllerError, InputError, Place, described, printable
from safety_harness.cell.controller.answers import LaneAnswers, answers_many, ask_together
from safety_harness.cell.controller.out_of_process.messages import (
    MOST_WORDS,
    PROTOCOL,
    ActOnRow,
    ActOnRows,
    Failed,
    MadeController,
    MakeController,
    NoController,
    Ready,
    Reset,
    Said,
    SaidRows,
    Told,
    action_said,
    arm_from,
    as_binary,
    as_sent,
    start_from,
    to_the_process,
)
from safety_harness.cell.controller.python_file import controller_in
from safety_harness.scenario.references import ONNX_SUFFIX
from safety_harness.seams.contract import (
    DECISIONS,
    IMAGE,
    Action,
    Image,
    Move,
    Seen,
    Stop,
    UserController,
    reports_of,
    sees_of,
)
from safety_harness.seams.isolation.child import Ends
from safety_harness.seams.rows import SeenLayout

Another = Callable[[], UserController]
MOST_TOLD = 1 << 30  # bytes of a message to it


def main(question_fd: int, answer_fd: int) -> None:
    """Answer until the other side is gone."""
    ends = Ends(question_fd, answer_fd)
    made = to_the_process.decode(ends.read(MOST_TOLD))
    assert isinstance(made, MakeController)
    asked = json.loads(made.wanted)
    sys.path[:] = asked["sys_path"]
    path = Path(asked["path"])
    try:
        os.chdir(asked["folder"])
        controller, another = _controller(path, made.source, asked["attribute"])
        sees, reports = sees_of(controller), reports_of(controller)
        many = another is not None and IMAGE not in sees and DECISIONS not in reports
        said = MadeController(PROTOCOL, controller.name, sees, reports, many, answers_many(controller))
    except InputError as error:
        ends.write(as_binary(NoController(*map(printable, (error.expected, error.got, error.hint)))))
        return
    except BaseException as error:  # a user's code may raise anything
        what = f"{asked['attribute'] or path.name} to be a controller"
        ends.write(as_binary(NoController(what, described(error, str(path)), "")))
        return
    ends.write(as_binary(said))
    answering = _Answering(controller, another, said, str(path))
    while True:
        ends.write(answering.answer(to_the_process.decode(ends.read(MOST_TOLD))))


def _controller(path: Path, source: bytes, attribute: str) -> tuple[UserController, Another | None]:
    """What a program has under a name, or what a policy is; and what makes another, if anything."""
    if path.suffix != ONNX_SUFFIX:
        found = controller_in(path, source, attribute, Place(field="controller"))
        kind = type(found)
        named = getattr(sys.modules.get(kind.__module__), attribute, None)
        return found, kind if named is kind else None
    from safety_harness.cell.controller.out_of_process.onnx_policy import (
        OnnxPolicy,  # no program waits for it
    )

    policy = OnnxPolicy(path, source, attribute)
    return policy, policy.another


class _Answering:
    """A controller for each lane, episode after episode."""

    def __init__(
        self, controller: UserController, another: Another | None, made: MadeController, file: str
    ) -> None:
        self._lanes, self._another, self._made, self._file = [controller], another, made, file
        self._period_s, self._joints = np.nan, 0
        self._layout = SeenLayout(1, 1, ())
        self._answers = LaneAnswers(1, 1, ())
        self._image: Image | None = None

    def answer(self, told: Told) -> bytes:
        """What to say to that, encoded."""
        what = "act raised"
        try:
            if isinstance(told, Reset):
                what = "reset raised"
                return as_binary(self._reset(told))
            if isinstance(told, ActOnRows):
                return self._act_together(told)
            assert isinstance(told, ActOnRow)
            return self._act(told)
        except ControllerError as error:
            return _failed(what, str(error))
        except BaseException as error:  # SystemExit, or the user's own: no reason to end
            return _failed(what, described(error, self._file))

    def _reset(self, told: Reset) -> Said:
        arm = arm_from(told.arm)
        self._period_s, self._joints = told.settings.clock.control_period_s, len(arm.joint_names)
        self._layout.hand_slots = 0
        self._image = None
        start, seed = start_from(told.start), int(told.seed)
        while len(self._lanes) <= told.lane:
            assert self._another is not None
            self._lanes.append(self._another())
        self._lanes[told.lane].reset(settings=told.settings, arm=arm, start=start, seed=seed)
        return Ready()

    def _seen_by(self, hand_slots: int) -> SeenLayout:
        if self._layout.hand_slots != hand_slots:
            self._layout = SeenLayout(hand_slots, self._joints, self._made.sees)
        return self._layout

    def _act_together(self, told: ActOnRows) -> bytes:
        layout, own, n = self._seen_by(told.hand_slots), told.lanes, len(told.lanes)
        answers = self._answers
        if len(answers.joints) != len(self._lanes) or answers.joints.shape[1] != self._joints:
            answers = self._answers = LaneAnswers(len(self._lanes), self._joints, self._made.reports)
        rows = np.frombuffer(told.rows).reshape(n, layout.wanted)
        controllers = [self._lanes[lane] for lane in own]
        why = ask_together(controllers, own, rows, self._period_s, layout, answers, _sendable, self._file)
        columns = [column[own].tobytes() for column in answers.columns]
        return as_binary(
            SaidRows(told.tick, columns, {lane: printable(why[lane])[:MOST_WORDS] for lane in why})
        )

    def _act(self, told: ActOnRow) -> bytes:
        layout = self._seen_by(told.hand_slots)
        row = np.frombuffer(told.row)
        seen = Seen.of_row(row.item(0), self._period_s, layout, row)
        if told.image is not None:
            seen.__dict__["image"] = self._image = _image(told.image, self._image)
        action = self._lanes[told.lane].act(seen)
        if not isinstance(action, Move | Stop):
            return _failed("act returned no Move and no Stop", repr(action))
        try:
            return as_binary(action_said(action, told.tick))
        except (TypeError, ValueError, AttributeError, RecursionError) as error:
            return _failed(f"act returned a {type(action).__name__} that cannot be sent", described(error))


def _sendable(action: Action) -> Action:
    if not isinstance(action, Move | Stop):
        return action  # to be refused
    try:
        return as_sent(action)
    except msgspec.MsgspecError as error:
        raise ControllerError(f"act: what it said is no message: {printable(str(error))}") from error
    except (TypeError, ValueError, AttributeError, RecursionError) as error:
        words = f"act returned a {type(action).__name__} that cannot be sent: {described(error)}"
        raise ControllerError(words) from error


def _image(told: tuple[float, bool, int, bytes], last: Image | None) -> Image:
    time_s, new, width, pixels = told
    if not new and last is not None:
        return Image(time_s=time_s, new=False, pixels=last.pixels)
    return Image(time_s=time_s, new=new, pixels=np.frombuffer(pixels, np.uint8).reshape(-1, max(width, 1), 3))


def _failed(what: str, got: str) -> bytes:
    return as_binary(Failed(printable(f"{what}: {got}")[:MOST_WORDS]))
