"""Run a user's controller: turn each observation into its view, and its actions into commands.

The user's controller does its own perception, except for the quantities that its ``sees`` requests. Limits,
drives and brakes are the same as for any other controller. The trace contains only the quantities that the
user's controller reports.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from copy import deepcopy
from functools import lru_cache
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from safety_harness.base.exceptions import ControllerError, described
from safety_harness.base.settings import Settings
from safety_harness.cell.controller.answers import LaneAnswers, in_act, numbers
from safety_harness.cell.controller.cycle import QUESTION, report
from safety_harness.cell.controller.decision_times import NOTHING
from safety_harness.cell.controller.records import (
    ObservationRecords,
    QuestionRecords,
    command_dtype,
    initial_state,
    observation_dtype,
    parameters_dtype,
)
from safety_harness.cell.controller.seeing import DrivenRecords, SeenRecords, driven_records, obey, see
from safety_harness.cell.controller.shield import Guard, keep_apart, no_guard
from safety_harness.cell.perception.hand_filter import FILTER_PARAMETERS
from safety_harness.cell.perception.tracking import no_tracks
from safety_harness.cell.robot.description import ArmModel
from safety_harness.cell.robot.drive import delay_ticks
from safety_harness.cell.robot.kinematics import links_in_base
from safety_harness.cell.servoing.control import DesiredView
from safety_harness.seams.contract import (
    DECISIONS,
    DOUBT,
    IMAGE,
    MODE,
    OBJECT,
    PREDICTED_HANDS,
    Action,
    Decision,
    DrivenArm,
    Report,
    Seen,
    Start,
    Stop,
    UserController,
    acts_per_answer_of,
    reports_of,
    sees_of,
)
from safety_harness.seams.rows import SeenLayout, seen_dtype
from safety_harness.trace.known import NOT_REPORTED, OF_DECISIONS, Measurement
from safety_harness.trace.records import DECISION, as_compiled, decision_dtype, tick_dtype

Floats = NDArray[np.float64]

# Columns that only the visual servo fills, or a controller that reports them.
_OF_SERVO = ("gain", "camera_twist")
_OF_OBJECT = ("object_visible", "features", "feature_error", "sse")
_OF_TRACKS = ("track_valid", "predicted_hand_in_base_m", "predicted_distance_m")
_OF_GATE = (
    "asked_tick",
    "decision_time_s",
    "seed",
    "opposite_position_in_base_m",
    "proposed_failed",
    "opposite_failed",
)
_OF_DOUBT = ("proposed_spread_m", "spread_threshold_m")


class DrivenController:
    """One episode of a user's controller.

    The harness calls the controller at each tick. An exception or an invalid action of the controller raises
    ``ControllerError``. ``joint_position_rad`` (n,) is the arm's position at the start. The desired ``view``
    is necessary only if the controller sees the object. ``guard`` contains the records of the scenario's
    shield in this run. ``answer_times_s`` (n,) contains the simulated time [s] that an answer to the view of
    each tick costs. The array comes from the function ``decision_times_s``.
    """

    def __init__(
        self,
        user: UserController,
        settings: Settings,
        arm: ArmModel,
        view: DesiredView | None,
        joint_position_rad: Floats,
        seed: int,
        hand_slots: int,
        guard: Guard | None = None,
        answer_times_s: Floats = NOTHING,
    ) -> None:
        self.user = user
        self.name = user.name
        self.sees, self.reports = sees_of(user), reports_of(user)
        joints = len(arm.joint_names)
        records = driven_records(settings, arm, view, hand_slots)
        self._decision = decision_dtype(joints)
        self._decisions: list[NDArray[np.void]] = []
        self.answers_took_s: list[float] = []  # on the wall's clock; without joint answers of lanes
        self.answers = LaneAnswers(1, joints, self.reports)
        self._computing = (
            _Computing(user, answer_times_s, joints, self.reports) if answer_times_s.any() else None
        )
        self.period_s = settings.clock.control_period_s
        self.layout = SeenLayout(hand_slots, joints, self.sees)
        self.lie_in(records, QuestionRecords(np.zeros(1, QUESTION)))
        self.wants = OBJECT in self.sees, PREDICTED_HANDS in self.sees
        self._see, self._obey, self._tell = _entries(hand_slots, joints)
        self.guard = guard or no_guard(hand_slots, joints)
        self._image: Callable[[], Any] | None = None
        pose = links_in_base(arm, joint_position_rad)[-1]
        start = Start(joint_position_rad=_frozen(joint_position_rad), transform_tcp_to_base=_frozen(pose))
        try:
            user.reset(settings=settings, arm=arm_of(arm), start=start, seed=seed)
        except ControllerError:
            raise
        except (Exception, SystemExit) as error:  # a user's code may raise anything
            raise self.failed(f"reset raised: {described(error)}") from error

    def lie_in(self, records: DrivenRecords, question: QuestionRecords) -> None:
        """Use the given records for the controller's state from now on.

        ``question`` (1,) is a record QUESTION.
        """
        self.records, self.question = records, question
        self._floats = records.seen.view(np.float64)[: self.layout.wanted]

    def sees_images_of(self, image: Callable[[], Any]) -> None:
        """Let the controller see the current ``image()`` at each tick, if its ``sees`` includes "image"."""
        self._image = image

    def step(self, observation: NDArray[np.void]) -> NDArray[np.void]:
        """Call the controller and return its COMMAND (1,).

        ``observation`` (1,) is a record OBSERVATION.
        """
        self.perceive(observation)
        self.ask()
        by_joints = bool(self.answers.by_joints[0])
        wanted = self.answers.joints[0] if by_joints else self.answers.twists[0]
        return self.carry_out(wanted, by_joints, bool(self.answers.stop[0]), observation)

    def perceive(self, observation: NDArray[np.void]) -> SeenRecords:
        """Return the view SEEN (1,) of an observation.

        The method ``step`` calls this method first, and then asks the controller. ``observation`` (1,) is a
        record OBSERVATION.
        """
        o = ObservationRecords(observation)
        r = self.records
        self._see(r.parameters, r.filter_parameters, r.state, r.tracks, o, r.seen, *self.wants)
        return r.seen

    def carry_out(
        self, wanted: Floats, by_joints: bool, stop: bool, observation: NDArray[np.void]
    ) -> NDArray[np.void]:
        """Return the COMMAND (1,) that ``obey`` computes from an action.

        The method ``step`` calls this method after the controller has answered.

        Args:
            wanted: The velocities of the TCP (6,) or of the joints (n,).
            by_joints: True if ``wanted`` contains joint velocities.
            stop: True if the action is a stop.
            observation: The record OBSERVATION (1,) to which the action belongs.

        Raises:
            ControllerError: A velocity is not finite.

        """
        o, r = ObservationRecords(observation), self.records
        if not self._obey(r.parameters, r.state, o, wanted, by_joints, stop, r.command):
            raise self.not_finite(wanted)
        self.shielded(o, int(self.question[0]["tick"]))
        self.question["tick"] += 1
        return r.command

    def shielded(self, observation: ObservationRecords, tick: int) -> None:
        """Let the shield change the command of ``tick``, if there is a shield.

        ``observation`` (1,) is a record OBSERVATION.
        """
        if len(self.guard.shield):
            r = self.records
            keep_apart(r.parameters, r.state, *self.guard, observation, r.command, tick)

    def report(self, tick: NDArray[np.void]) -> None:
        """Write the controller's view and reports into the trace.

        ``tick`` (1,) is a record TICK of the trace.
        """
        self.report_compiled(as_compiled(tick))

    def report_compiled(self, tick: NDArray[np.void]) -> None:
        """Write the controller's view and reports into a record of a tick, as ``report`` does.

        ``tick`` (1,) comes from ``as_compiled``.
        """
        self._tell(self.records.state, self.question, self.records.command, tick)
        if self.answers.modes[0] >= 0:
            tick["mode"] = self.answers.modes[0]

    @property
    def decisions(self) -> NDArray[np.void]:
        """All decisions that the controller has reported, as records DECISION of the shape (m,)."""
        decisions = np.zeros(len(self._decisions), self._decision)
        for k, decision in enumerate(self._decisions):
            decisions[k] = decision[0]
        return decisions

    @property
    def decision_latencies_s(self) -> Floats:
        """The latencies of the decisions, shape (m,).

        All latencies are NaN, because the harness did not ask for these decisions.
        """
        return np.full(len(self._decisions), np.nan)

    @property
    def interventions(self) -> NDArray[np.void]:
        """The shield's action in each tick of the run, as records INTERVENTION of the shape (n,).

        The array is empty without a shield.
        """
        return self.guard.interventions

    @property
    def known(self) -> dict[str, Measurement]:
        """The columns of a trace that the controller does not report, each with the value NOT_REPORTED."""
        lacking = [*_OF_SERVO]
        lacking += [] if OBJECT in self.sees else _OF_OBJECT
        lacking += [] if PREDICTED_HANDS in self.sees else _OF_TRACKS
        lacking += [] if MODE in self.reports else ["mode"]
        if DECISIONS in self.reports:
            of_decisions = [*_OF_GATE, *([] if DOUBT in self.reports else _OF_DOUBT)]
        else:
            of_decisions, lacking = [*(DECISION.names or ())], [*lacking, "decision"]
        return dict.fromkeys([*lacking, *(OF_DECISIONS + name for name in of_decisions)], NOT_REPORTED)

    def ask(self) -> None:
        """Call the controller, and store in ``answers`` the action that lasts until the next tick.

        If answers cost simulated time, the previous action continues until the new answer takes effect. The
        method does not call the controller before this time.
        """
        try:
            if self._computing is None:
                self._note(self._called(self.answers, self._seen_now()))
            else:
                self._ask_if_idle(self._computing)
        except ControllerError as error:
            raise self.failed(in_act(error)) from error
        except (Exception, SystemExit) as error:  # a user's code may raise anything
            raise self.failed(f"act raised: {described(error)}") from error

    def _ask_if_idle(self, computing: _Computing) -> None:
        """Let an answer take effect if it is due.

        Then call the controller if it is not computing an answer.
        """
        tick = int(self.question[0]["tick"])
        self.question["made_now"] = False
        if computing.is_due(tick):
            self._note(computing.put_into(self.answers))
            if computing.goes_on:
                return
        if computing.counts_from is None:
            if not computing.goes_on or computing.seen is None:
                computing.seen = self._seen_now()
            action = self._called(computing.answers, computing.seen)
            computing.began(tick, action, self.period_s)
            # An answer that costs no time takes effect in the same tick.
            if computing.is_due(tick):
                self._note(computing.put_into(self.answers))

    def _called(self, answers: LaneAnswers, seen: Seen) -> Action:
        """Return the controller's action for the view ``seen``.

        The method also stores the action in ``answers``.
        """
        begun_s = time.perf_counter()
        answer = self.user.act(seen)
        took_s = time.perf_counter() - begun_s
        if self._computing is not None and self._computing.goes_on:
            self.answers_took_s[-1] += took_s  # a part of the last answer
        else:
            self.answers_took_s.append(took_s)
        return answers.take(0, answer)

    def _seen_now(self) -> Seen:
        """Return the controller's view at this tick."""
        row = self._floats.copy()
        row.flags.writeable = False
        seen = Seen.of_row(float(row[0]), self.period_s, self.layout, row)
        if self._image is not None and IMAGE in self.sees:
            seen.__dict__["image"] = self._image()
        return seen

    def not_finite(self, wanted: Floats) -> ControllerError:
        """Return the error for velocities that are not finite.

        ``wanted`` has the shape (6,) or (n,).
        """
        return self.failed(f"act returned velocities that are not finite: {wanted.tolist()}")

    def failed(self, why: str) -> ControllerError:
        """Return the error that ends the run at this tick.

        ``why`` is the reason of the error.
        """
        when = f" at {float(self.records.seen[0]['time_s']):.3f} s"
        return ControllerError(f"the controller {self.name!r}: {why}{when}")

    def _note(self, action: Action) -> None:
        """Record the decision that the controller reports with ``action``, if any."""
        if DECISIONS not in self.reports:
            return
        reported = action.report
        decision = reported.decision if isinstance(reported, Report) else None
        self.question["made_now"] = decision is not None
        if decision is not None:
            self._decisions.append(self._record(decision))
            self.question["made"] += 1

    def _record(self, decision: Decision) -> NDArray[np.void]:
        """Return a reported ``decision`` as a record DECISION (1,)."""
        record = np.zeros(1, self._decision)
        record["tick"] = record["asked_tick"] = self.question["tick"]
        for name in ("time_s", "joint_position_rad"):
            record[name] = self.records.seen[name]
        record["tcp_position_in_base_m"] = self.records.state["transform_tcp_to_base"][0, :3, 3]
        record["opposite_position_in_base_m"] = np.nan
        record["outcome"], record["trigger"] = int(decision.outcome), int(decision.trigger)
        pairs = {"proposed_spread_m": decision.spread_m, "spread_threshold_m": decision.spread_threshold_m}
        for name in ("hand", "proposed", "chosen"):
            pairs[f"{name}_position_in_base_m"] = getattr(decision, f"{name}_position_in_base_m")
        for name, value in pairs.items():
            record[name] = numbers(name, value, record[name][0].shape)
        return record


class _Computing:
    """A controller's answer that costs simulated time and has not yet taken effect.

    ``times_s`` (n,) contains the cost [s] of an answer that begins at each tick. If an answer of ``user``
    lasts for several calls of ``act``, only the first of these calls costs time. The user's
    ``acts_per_answer`` is the number of calls. The later calls get the same view ``seen``, because the answer
    was computed from this view.
    """

    def __init__(self, user: UserController, times_s: Floats, joints: int, reports: tuple[str, ...]) -> None:
        self.answers = LaneAnswers(1, joints, reports)
        self.counts_from: int | None = None  # tick; None: the controller computes nothing
        self._times_s, self._acts = times_s, 0
        self._per_answer = acts_per_answer_of(user)
        self._action: Action = Stop()
        self.seen: Seen | None = None

    @property
    def goes_on(self) -> bool:
        """Whether the next call of ``act`` returns the next action of the last answer."""
        return self._acts % self._per_answer != 0

    def is_due(self, tick: int) -> bool:
        """Return whether there is an answer that takes effect at ``tick`` or earlier."""
        return self.counts_from is not None and self.counts_from <= tick

    def began(self, tick: int, action: Action, period_s: float) -> None:
        """Store an ``action`` whose computation begins at ``tick``."""
        cost_s = 0.0 if self.goes_on else float(self._times_s[min(tick, len(self._times_s) - 1)])
        self.counts_from = tick + delay_ticks(cost_s, period_s)
        self._action = deepcopy(action)  # the controller may use its arrays again
        self._acts += 1

    def put_into(self, answers: LaneAnswers) -> Action:
        """Copy the answer into ``answers`` and return its action."""
        for column, next_column in zip(answers.columns, self.answers.columns, strict=True):
            column[:] = next_column
        self.counts_from = None
        return self._action


@lru_cache
def _entries(hand_slots: int, joints: int) -> tuple[Callable[..., Any], ...]:
    """Return the machine code of ``see``, ``obey`` and ``report``.

    The function is cached, so that numba does not look up the machine code in each episode.
    """
    state, command = initial_state(hand_slots, joints), np.zeros(1, command_dtype(joints))
    p, question = np.zeros(1, parameters_dtype(joints)), np.zeros(1, QUESTION)
    observation = np.zeros(1, observation_dtype(hand_slots, joints))
    seen, tracks = np.zeros(1, seen_dtype(hand_slots, joints)), no_tracks(hand_slots)
    tick = as_compiled(np.zeros(1, tick_dtype(hand_slots, joints)))
    f = np.zeros(1, FILTER_PARAMETERS)
    return (
        entry_of(see, p, f, state, tracks, observation, seen, False, False),
        entry_of(obey, p, state, observation, np.zeros(6), False, False, command),
        entry_of(report, state, question, command, tick),
    )


def entry_of(function: Any, *arguments: Any) -> Callable[..., Any]:
    """Return the machine code of ``function`` for arguments of these types.

    The machine code does not check the types of its arguments. For small functions, numba's check of record
    types takes ten times as long as the work itself.
    """
    key = function, tuple(map(_kind, arguments))
    if key not in _ENTRIES:
        _ENTRIES[key] = function.compile(tuple(map(numba.typeof, arguments)))
    return _ENTRIES[key]


_ENTRIES: dict[tuple[Any, tuple[Any, ...]], Callable[..., Any]] = {}


def _kind(argument: Any) -> Any:
    """Return a key for all properties of an argument that determine its type in numba.

    To look up the type in numba itself would take milliseconds in each episode.
    """
    if isinstance(argument, tuple):
        return type(argument), tuple(map(_kind, argument))
    if not isinstance(argument, np.ndarray):
        return type(argument)
    is_ = argument.flags
    flags = is_.c_contiguous, is_.f_contiguous, is_.writeable, is_.aligned
    return argument.dtype, argument.ndim, flags


def _frozen(array: Floats) -> Floats:
    """Return a read-only copy of an array."""
    array = array.copy()
    array.flags.writeable = False
    return array


def arm_of(model: ArmModel) -> DrivenArm:
    """Return the description of the arm ``model`` for controllers."""
    return DrivenArm(
        name=model.name,
        joint_names=model.joint_names,
        position_lower_rad=model.position_lower_rad,
        position_upper_rad=model.position_upper_rad,
        velocity_limit_radps=model.velocity_limit_radps,
        joint_origins=model.joint_origins,
        joint_axes=model.joint_axes,
        flange=model.flange,
    )
