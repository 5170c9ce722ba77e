"""Run users' controllers in the kinematic world, for one episode or for many episodes in parallel lanes.

The loop is the same as in ``simulate``, but numba does not look up the types of arguments at each call. A
lane is an episode's row in stacked records. At each tick, the loop gets the answers of all controllers. If
the controllers are in a common process, the loop makes one exchange with this process. If the controllers
have the function ``act_many``, the loop calls this function once. Otherwise the controllers answer one after
another.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.exceptions import ControllerError
from safety_harness.cell.controller.answers import LaneAnswers, answers_many, ask_together, lanes_of
from safety_harness.cell.controller.cycle import QUESTION
from safety_harness.cell.controller.driven import DrivenController, entry_of
from safety_harness.cell.controller.records import ObservationRecords, QuestionRecords
from safety_harness.cell.controller.seeing import DrivenRecords
from safety_harness.cell.simulation.kinematic_world import KinematicWorld
from safety_harness.cell.simulation.lanes import look_lanes, obey_lanes, placed, stacked, step_lanes
from safety_harness.cell.simulation.records import WorldRecords
from safety_harness.trace.records import as_compiled

_PADDED = {"moves", "samples", "normals", "uniforms"}  # of these, a lane never reads more than its own rows


@dataclass(eq=False)
class Lane:
    """An episode in a lane.

    ``ticks`` (n,) contains records TICK, ``done`` is the number of filled ticks, and ``failed`` is an error
    or None.
    """

    world: KinematicWorld
    controller: DrivenController
    ticks: NDArray[np.void]
    done: int = field(default=0, init=False)
    failed: ControllerError | None = field(default=None, init=False)

    @property
    def kind(self) -> object:
        """A key that is equal for lanes that may run together.

        Such lanes differ only in hands, noise and values.
        """
        records = self.world.records._asdict().items()
        shapes = tuple((record.dtype, record.shape) for name, record in records if name not in _PADDED)
        return shapes, self.controller.sees, self.controller.reports, self.controller.period_s


def drive(lanes: Sequence[Lane], on_tick: Callable[[int], None] | None = None) -> None:
    """Run all lanes of a kind.

    Each lane gives the same trace as ``simulate``, bit for bit. The function stores the error of a lane in
    ``Lane.failed``. If there is only one lane, the function raises the error of this lane instead. The
    function also raises an error that stops many lanes simultaneously. The results of these lanes are then
    invalid.
    """
    first, n = lanes[0].controller, len(lanes)
    worlds, controllers, questions = _together(lanes)
    most = max(len(lane.ticks) for lane in lanes)
    own = lanes[0].ticks
    records = own[None] if n == 1 else np.zeros((n, most), own.dtype)
    ticks, lasts = as_compiled(records), np.array([len(lane.ticks) - 1 for lane in lanes])
    answers = first.answers if n == 1 else LaneAnswers(n, first.answers.joints.shape[1], first.reports)
    finite, modes = np.zeros(n, np.bool_), answers.modes
    rows = records.view(np.uint8).reshape(n, most, own.dtype.itemsize)
    of_truth = worlds.truth.view(np.uint8).reshape(n, own.dtype.itemsize)
    looks = worlds, controllers, lasts
    obeys = worlds.observation, controllers, lasts
    steps = worlds, controllers, questions, ticks, lasts
    acts = answers.twists, answers.joints, answers.by_joints, answers.stop, finite
    entry_look = entry_of(look_lanes, *looks, 0, *first.wants)
    obey = entry_of(obey_lanes, *obeys, 0, *acts)
    step = entry_of(step_lanes, *steps, 0, modes)
    ask = _Asking(lanes, controllers, answers) if n > 1 else None
    shielded = any(len(lane.controller.guard.shield) for lane in lanes)
    for k in range(most):
        rows[:, k] = of_truth  # as bytes, since the padding between fields would otherwise be arbitrary
        entry_look(*looks, k, *first.wants)
        if ask is None:
            first.ask()
        else:
            ask(k, lasts)
        obey(*obeys, k, *acts)
        if not finite.all():
            _refuse(lanes, finite, answers, lasts, k)
        if shielded:
            for lane in lanes_of(lasts >= k):
                lanes[lane].controller.shielded(ObservationRecords(worlds.observation[lane]), k)
        step(*steps, k, modes)
        if n == 1:
            lanes[0].done = k + 1
        if on_tick is not None:
            on_tick(k + 1)
        if ask is not None and not (lasts > k).any():
            break
    for lane, episode in enumerate(lanes):
        if ask is not None and episode.failed is None:
            episode.ticks = records[lane, : len(episode.ticks)]
            episode.controller.answers_took_s = ask.took_s[: len(episode.ticks)]
            episode.done = len(episode.ticks)


def _refuse(
    lanes: Sequence[Lane], finite: NDArray[np.bool_], answers: LaneAnswers, lasts: NDArray[np.int64], k: int
) -> None:
    """Store an error for each lane whose action is not finite.

    ``finite`` and ``lasts`` have the shape (lanes,). If there is only one lane, the function raises the error
    of this lane instead.
    """
    for lane in lanes_of(~finite & (lasts >= k)):
        by_joints = answers.by_joints[lane]
        wanted = answers.joints[lane] if by_joints else answers.twists[lane]
        error = lanes[lane].controller.not_finite(wanted)
        if len(lanes) == 1:
            raise error
        # A last tick of -1 makes all later steps skip this lane.
        lanes[lane].failed, lasts[lane] = error, -1
    finite[:] = True


class _Asking:
    """A function object that calls the controllers of many lanes together.

    ``took_s`` is the mean time [s] of an answer at each tick. The list is empty if a single call answers for
    all lanes.
    """

    def __init__(self, lanes: Sequence[Lane], controllers: DrivenRecords, answers: LaneAnswers) -> None:
        self._lanes, self._answers = lanes, answers
        self._users = [lane.controller.user for lane in lanes]
        self.took_s: list[float] = []
        user, first = self._users[0], lanes[0].controller
        from safety_harness.cell.controller.out_of_process.remote import RemoteController

        self._remote = isinstance(user, RemoteController)
        self._timed = not (user.together if isinstance(user, RemoteController) else answers_many(user))
        self._layout, self._period_s = first.layout, first.period_s
        self._numbers = (
            controllers.seen[:, 0].view(np.float64).reshape(len(lanes), -1)[:, : first.layout.wanted]
        )

    def __call__(self, tick: int, lasts: NDArray[np.int64]) -> None:
        """Call the controllers of the lanes that are still running at ``tick``."""
        own = lanes_of(lasts >= tick)
        rows = self._numbers[own]
        rows.flags.writeable = False
        users: Any = [self._users[lane] for lane in own]
        begun_s = time.perf_counter()
        if self._remote:
            why = users[0].act_together(users, own, tick, self._layout.hand_slots, rows, self._answers)
        else:
            why = ask_together(users, own, rows, self._period_s, self._layout, self._answers)
        self.took_s += [(time.perf_counter() - begun_s) / len(own)] * self._timed
        for lane, reason in why.items():
            self._lanes[lane].failed, lasts[lane] = self._lanes[lane].controller.failed(reason), -1


def _together(lanes: Sequence[Lane]) -> tuple[WorldRecords, DrivenRecords, NDArray[np.void]]:
    """Return the stacked records of all lanes.

    The controllers use their rows of these records from now on.
    """
    first = lanes[0]
    worlds = stacked(first.world.records, len(lanes))
    controllers = stacked(first.controller.records, len(lanes))
    questions = np.zeros((len(lanes), 1), QUESTION)
    for number, lane in enumerate(lanes):
        worlds = placed(worlds, number, lane.world.records)
        controllers = placed(controllers, number, lane.controller.records)
        questions[number] = lane.controller.question
    for number, lane in enumerate(lanes):
        own = DrivenRecords(*(records[number] for records in controllers))
        lane.controller.lie_in(own, QuestionRecords(questions[number]))
    return worlds, controllers, questions
