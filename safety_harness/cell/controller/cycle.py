"""Compute one tick of ``AvoidingServo``, from the observation to the command, except for the decision.

``watch`` returns whether a decision is due now. If a decision is due, the caller decides and fills the
answer. Then ``act`` commands the arm. A single episode and many episodes use the same functions.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import compiled, inlined
from safety_harness.base.geometry.linear import copy_matrix, copy_vector
from safety_harness.cell.controller.records import (
    AnswerRecords,
    CommandRecords,
    FaultRecords,
    FilterRecords,
    ObservationRecords,
    ParameterRecords,
    QuestionRecords,
    StateRecords,
    TrackRecords,
)
from safety_harness.cell.controller.shield import Interventions, ShieldRecords, keep_apart
from safety_harness.cell.controller.stack import begin_tick, finish_tick
from safety_harness.cell.robot.distance import CapsuleRecords
from safety_harness.scenario.fault_table import TIME_EPS_S, acting, delay_s
from safety_harness.scenario.faults import FaultKind
from safety_harness.trace.records import Mode

PROTECTIVE_STOP = int(Mode.PROTECTIVE_STOP)
LATE, SILENT, NAN = FaultKind.AVOIDER_LATE, FaultKind.AVOIDER_SILENT, FaultKind.AVOIDER_NAN

Records = NDArray[np.void]

QUESTION = np.dtype(
    [
        ("tick", np.int64),  # of the run, now
        ("time_s", np.float64),
        ("open", np.bool_),  # there is a question whose answer does not count yet
        ("asked_tick", np.int64),
        ("asked_s", np.float64),
        ("decision_time_s", np.float64),  # the question's cost without any fault; NaN: not known yet
        ("hand_position_in_base_m", np.float64, (3,)),  # the nearest predicted hand of the question
        ("tcp_position_in_base_m", np.float64, (3,)),
        ("trigger", np.int64),
        ("delayed", np.bool_),  # the answer counts at a later tick than its question
        ("counts_from", np.int64),  # tick
        ("late", np.bool_),  # the answer comes too late to count
        ("faults", np.int64),  # bits of the faults that act on the question
        ("acted_faults", np.int64),  # bits, at this tick
        ("made", np.int64),  # decisions so far
        ("made_now", np.bool_),
    ],
    align=True,
)


class ControllerRecords(NamedTuple):
    """The complete state of an episode's controller.

    The order of the records lets each function take consecutive records as its arguments. ``watch`` takes the
    first seven records. ``act`` takes all records from ``parameters`` on. ``report`` takes the records from
    ``state`` to ``command``.
    """

    filter_parameters: FilterRecords  # (1,) FILTER_PARAMETERS
    tracks: TrackRecords  # (tracks,) TRACK
    faults: FaultRecords  # (n,) FAULT
    decision_times_s: NDArray[np.float64]  # (n,) of a question of each tick, as ``decision_times`` has it
    parameters: ParameterRecords  # (1,) PARAMETERS
    state: StateRecords  # (1,) STATE
    question: QuestionRecords  # (1,) QUESTION
    command: CommandRecords  # (1,) COMMAND
    answer: AnswerRecords  # (1,) ANSWER
    shield: ShieldRecords  # (1,) SHIELD, or (0,) without one, as the next two
    interventions: Interventions  # (n,) INTERVENTION
    capsules: CapsuleRecords  # (n,) CAPSULE


@inlined
def watch(
    filter_parameters: FilterRecords,
    tracks: TrackRecords,
    faults: FaultRecords,
    decision_times_s: NDArray[np.float64],  # (n,) of a question of each tick; the last for all later ones
    parameters: ParameterRecords,
    states: StateRecords,
    questions: QuestionRecords,
    observations: ObservationRecords,
) -> bool:
    """Read an observation, and return True if the answer to the open question takes effect now.

    Until then the controller continues as before. After a protective stop, the controller discards an open
    question.
    """
    s, q = states[0], questions[0]
    needs_decision = begin_tick(parameters, filter_parameters, states, tracks, observations)
    q.time_s = observations[0].time_s
    q.acted_faults = 0
    q.made_now = False
    if needs_decision and not q.open:
        ask(parameters, states, questions, faults, decision_times_s, observations)
    if not q.open:
        return False
    q.acted_faults = q.faults
    # The servo goes on while the avoider computes, so no decision is pending in this tick.
    if q.tick < q.counts_from:
        s.decision_pending = False
        return False
    q.open = False
    # The arm has stopped meanwhile, and an answer to the old situation must not end the stop.
    if s.mode == PROTECTIVE_STOP:
        s.decision_pending = False
        return False
    q.made_now = True
    s.decision_pending = True
    s.trigger = q.trigger
    return True


@compiled
def ask(
    parameters: ParameterRecords,
    states: StateRecords,
    questions: QuestionRecords,
    faults: FaultRecords,
    decision_times_s: NDArray[np.float64],  # (n,)
    observations: ObservationRecords,
) -> None:
    """Open a question at this tick.

    Its answer takes effect after the question's decision time.
    """
    s, q, time_s = states[0], questions[0], observations[0].time_s
    q.open = True
    q.asked_tick = q.tick
    q.asked_s = time_s
    for i in range(3):
        q.hand_position_in_base_m[i] = s.predicted_hand_in_base_m[s.nearest_track, i]
        q.tcp_position_in_base_m[i] = s.transform_tcp_to_base[i, 3]
    q.trigger = s.trigger
    q.faults = acting(faults, LATE, time_s) | acting(faults, SILENT, time_s) | acting(faults, NAN, time_s)
    answer_after(parameters, questions, faults, decision_times_s[min(q.tick, decision_times_s.shape[0] - 1)])


@compiled
def answer_after(
    parameters: ParameterRecords, questions: QuestionRecords, faults: FaultRecords, decision_time_s: float
) -> None:
    """Set the tick from which the answer to the open question takes effect.

    A fault may delay the answer. An answer takes ``decision_time_s`` [s] plus the delay, but the controller
    waits at most until the deadline. The answer takes effect at the first tick at or after this time. If the
    answer is later than the deadline, the controller gives up at the deadline and ignores the answer. A
    ``decision_time_s`` of NaN stands for a time that is not yet known.
    """
    p, q = parameters[0], questions[0]
    late_s = decision_time_s + delay_s(faults, LATE, q.asked_s)
    # An answer that never comes is late at the deadline, like any other late answer.
    if np.isnan(late_s) or acting(faults, SILENT, q.asked_s):
        late_s = np.inf
    # 1e-9 makes seven periods seven ticks, although 0.07 / 0.01 is above 7 in float64.
    waits = int(np.ceil(min(late_s, p.decision_deadline_s) / p.control_period_s - 1e-9))
    q.decision_time_s = decision_time_s
    q.delayed = waits > 0
    q.counts_from = q.asked_tick + waits
    # TIME_EPS_S, because an answer exactly at the deadline counts.
    q.late = late_s > p.decision_deadline_s + TIME_EPS_S


@inlined
def act(
    parameters: ParameterRecords,
    states: StateRecords,
    questions: QuestionRecords,
    commands: CommandRecords,
    answers: AnswerRecords,
    shields: ShieldRecords,
    interventions: Interventions,
    capsules: CapsuleRecords,
    observations: ObservationRecords,
) -> None:
    """Act on the answer if there is one, and command the arm.

    The shield may then change the command.
    """
    q = questions[0]
    finish_tick(parameters, states, observations, answers, commands)
    if shields.shape[0] > 0:
        keep_apart(parameters, states, shields, interventions, capsules, observations, commands, q.tick)
    q.made += q.made_now
    q.tick += 1


@inlined
def report(
    states: StateRecords, questions: QuestionRecords, commands: CommandRecords, ticks: Records
) -> None:
    """Write perception and decision into the trace's record of this tick.

    ``ticks`` is the record (1,) from ``as_compiled``.
    """
    s, q, command, tick = states[0], questions[0], commands[0], ticks[0]
    tick.object_visible = s.object_visible
    tick.sse = s.sse
    tick.predicted_distance_m = s.predicted_distance_m
    tick.mode = s.mode
    tick.gain = s.gain
    tick.limits = s.limits
    copy_vector(s.features, tick.features)
    copy_vector(s.feature_error, tick.feature_error)
    copy_vector(s.camera_twist, tick.camera_twist)
    copy_vector(command.joint_velocity_radps, tick.demanded_joint_velocity_radps)
    copy_vector(s.track_valid, tick.track_valid)
    copy_matrix(s.predicted_hand_in_base_m, tick.predicted_hand_in_base_m)
    tick.decision = q.made - 1 if q.made_now else -1
    tick.faults |= q.acted_faults
