"""Define the controller under test, which servoes, watches the hands, retreats and stops.

``Controller`` is the interface for a user's own controller. ``AvoidingServo`` composes the compiled control
stack with an avoider and the gate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.seeds import Branch, seed
from safety_harness.base.settings import HAND_SLOTS, Settings
from safety_harness.cell.avoidance.asking import Answer, late_fault
from safety_harness.cell.avoidance.avoider import Avoider, shown_to
from safety_harness.cell.avoidance.gate import Gate, GateDecision, Query, answer_to
from safety_harness.cell.avoidance.simple import faulty
from safety_harness.cell.controller.cycle import QUESTION, ControllerRecords, act, answer_after, report, watch
from safety_harness.cell.controller.decision_times import NOTHING
from safety_harness.cell.controller.predicting import PredictorCalls
from safety_harness.cell.controller.records import (
    ANSWER,
    AnswerRecords,
    CommandRecords,
    FaultRecords,
    FilterRecords,
    ObservationRecords,
    ParameterRecords,
    QuestionRecords,
    StateRecords,
    TrackRecords,
    command_dtype,
    initial_state,
    parameters,
)
from safety_harness.cell.controller.shield import Guard, no_guard
from safety_harness.cell.controller.sight import Sight
from safety_harness.cell.perception.hand_filter import filter_parameters
from safety_harness.cell.perception.possible_hands import possible_half_widths_m
from safety_harness.cell.perception.tracking import no_tracks
from safety_harness.cell.robot.description import ArmModel
from safety_harness.cell.servoing.control import DesiredView
from safety_harness.scenario.fault_table import fault_table
from safety_harness.seams.contract import Seen
from safety_harness.trace.records import FAULT_CHARACTERS, DecisionOutcome, as_compiled, decision_dtype
from safety_harness.trace.trace import not_predicted


class Controller(Protocol):
    """The controller of an episode, which turns each observation into a command."""

    @property
    def name(self) -> str:
        """The controller's name in traces and reports."""

    def step(self, observation: NDArray[np.void]) -> NDArray[np.void]:
        """Return a record COMMAND (1,) for the record OBSERVATION (1,).

        The next call may reuse the returned array.
        """

    def report(self, tick: NDArray[np.void]) -> None:
        """Write the controller's perception and decision into the trace.

        ``tick`` (1,) is a record TICK of the trace.
        """

    @property
    def decisions(self) -> NDArray[np.void]:
        """All decisions so far, as records DECISION of the shape (m,)."""

    @property
    def decision_latencies_s(self) -> NDArray[np.float64]:
        """The wall-clock time [s] that each decision took, shape (m,)."""


class AvoidingServo:
    """The paper's controller: ``avoider`` proposes, ``gate`` decides, and the compiled stack moves the arm.

    ``decision_times_s`` (n,) contains the simulated time [s] that a question at each tick costs. The array
    comes from the function ``decision_times_s``. The ``faults`` (n,), which are records FAULT, may delay an
    answer further. Until the answer takes effect or the decision deadline passes, the controller continues as
    before. ``recorded_late`` (m,) contains a text for each decision of an old trace. The text is empty unless
    the answer exceeded a limit of wall-clock time. ``hand_slots`` is the scenario's number of hands.
    ``guard`` contains the records of the scenario's shield in this run. A ``predictor`` replaces the Kalman
    filter.
    """

    def __init__(
        self,
        settings: Settings,
        arm: ArmModel,
        view: DesiredView,
        avoider: Avoider,
        gate: Gate,
        root_seed: int,
        recorded_late: Sequence[str] = (),
        faults: NDArray[np.void] | None = None,
        decision_times_s: NDArray[np.float64] = NOTHING,
        hand_slots: int = HAND_SLOTS[0],
        guard: Guard | None = None,
        predictor: PredictorCalls | None = None,
    ) -> None:
        self.name = avoider.name
        self.avoider = avoider
        self.gate = gate
        fixed, joints = _fixed(settings.steady, arm, view), len(arm.joint_names)
        self.records = ControllerRecords(
            FilterRecords(fixed[1].copy()),
            TrackRecords(no_tracks(hand_slots)),
            FaultRecords(fault_table(()) if faults is None else faults),
            decision_times_s.copy(),
            ParameterRecords(fixed[0].copy()),
            StateRecords(initial_state(hand_slots, joints)),
            QuestionRecords(np.zeros(1, QUESTION)),
            CommandRecords(np.zeros(1, command_dtype(joints))),
            AnswerRecords(np.zeros(1, ANSWER)),
            *(guard or no_guard(hand_slots, joints)),
        )
        self.predictor = predictor
        self.records.parameters["predicted_elsewhere"] = predictor is not None
        self._late = late_fault(settings.avoidance.decision_deadline_s)
        self._limit_s = settings.clock.wall_limit_s
        self._held: Answer | None = None  # an answer that has come, but counts later by the wall's clock
        self._root_seed = root_seed
        self._decision = decision_dtype(joints)
        self._sight = Sight.from_words(shown_to(avoider), hand_slots, joints, settings.clock.control_period_s)
        self._seen: Seen | None = None  # the avoider's view at the time of the open question
        self._recorded_late = tuple(recorded_late)
        self._decisions: list[NDArray[np.void]] = []
        self._latencies_s: list[float] = []

    def step(self, observation: NDArray[np.void]) -> NDArray[np.void]:
        """Return a record COMMAND (1,) for ``observation`` (1,), which is a record OBSERVATION.

        The method makes a decision if one is necessary.
        """
        r, o = self.records, ObservationRecords(observation)
        if self.predictor is not None:
            self.predictor.predict(o, r.state, r.tracks)
        decides = watch(*r[:7], o)
        if self._sight is not None and r.question[0]["asked_tick"] == r.question[0]["tick"]:
            self._seen = self._sight.seen(r, o)
        if decides:
            query = self.query(observation)
            due, self._held = self._held, None
            gate = self.gate
            self.decide(query, gate.rule(self.answerer(), query) if due is None else gate.rule_on(due, query))
        elif r.question[0]["open"] and np.isnan(r.question[0]["decision_time_s"]):  # by the wall's clock
            self._ask_now(observation)
        act(*r[4:], o)
        return r.command

    def report(self, tick: NDArray[np.void]) -> None:
        """Copy the stack's state into the trace.

        ``tick`` (1,) is the trace's record TICK for this tick.
        """
        report(*self.records[5:8], as_compiled(tick))

    @property
    def decisions(self) -> NDArray[np.void]:
        """All decisions so far, as records DECISION of the shape (m,)."""
        decisions = np.zeros(len(self._decisions), self._decision)
        for k, decision in enumerate(self._decisions):
            decisions[k] = decision[0]
        return decisions

    @property
    def decision_latencies_s(self) -> NDArray[np.float64]:
        """The wall-clock time [s] that the controller waited for each answer, shape (m,)."""
        return np.array(self._latencies_s, dtype=np.float64)

    @property
    def predicted(self) -> NDArray[np.void]:
        """The predictor's sets in each tick of the run, as records PREDICTED of the shape (n,).

        The array is empty without a predictor.
        """
        return not_predicted() if self.predictor is None else self.predictor.predicted

    @property
    def interventions(self) -> NDArray[np.void]:
        """The shield's action in each tick of the run, as records INTERVENTION of the shape (n,).

        The array is empty without a shield.
        """
        return self.records.interventions

    def _ask_now(self, observation: NDArray[np.void]) -> None:
        """Ask the avoider, and measure the wall-clock time of the answer.

        The simulated time until the answer takes effect equals the wall-clock time of the answer.
        """
        records, held = self.records, answer_to(self.answerer(), replace(self.query(observation), late=""))
        answer_after(records.parameters, records.question, records.faults, held.latency_s)
        late = Answer(fault=self._late, late=True, latency_s=held.latency_s)
        self._held = late if records.question[0]["late"] else held

    def answerer(self) -> Avoider:
        """Return the avoider that answers the open question.

        If a fault replaces the scenario's avoider, the result is the replacement.
        """
        return faulty(self.records.faults, self.avoider, float(self.records.question[0]["asked_s"]))

    def query(self, observation: NDArray[np.void]) -> Query:
        """Return the gate's query for a decision that is due now.

        ``observation`` (1,) is a record OBSERVATION.
        """
        state, question = self.records.state[0], self.records.question[0]
        number, nearest = len(self._decisions), state["nearest_track"]
        asked_hand, asked_tcp = question["hand_position_in_base_m"], question["tcp_position_in_base_m"]
        # If every hand has left since the question, the decision concerns the hand of the question.
        hand = state["predicted_hand_in_base_m"][nearest] if nearest >= 0 else asked_hand
        return Query(
            hand_position_in_base_m=hand.copy(),
            tcp_position_in_base_m=state["transform_tcp_to_base"][:3, 3].copy(),
            transform_tcp_to_base=state["transform_tcp_to_base"].copy(),
            joint_position_rad=observation[0]["joint_position_rad"].copy(),
            hands_in_base_m=state["predicted_hand_in_base_m"][state["track_valid"] != 0],
            seed=seed(self._root_seed, Branch.DECISION, number),
            late=self._late if question["late"] else self._recorded_words,
            limit_s=self._limit_s,
            asked_of=(asked_hand.copy(), asked_tcp.copy()) if question["delayed"] else None,
            seen=self._seen,
            half_widths_m=self._half_widths_m(observation),
        )

    def _half_widths_m(self, observation: NDArray[np.void]) -> NDArray[np.float64] | None:
        """Return the half widths of each predicted hand's box, shape (k, 3).

        Return None if the gate's rule does not need them.
        """
        rule, r = self.gate.more, self.records
        if rule is None or not rule.of_possible_hands:
            return None
        if rule.hands_within is None:
            return None if self.predictor is None else self.predictor.half_widths_m
        at_s = float(observation[0]["time_s"] + r.parameters[0]["prediction_horizon_s"])
        pose = r.state[0]["transform_sensor_to_base"]
        return possible_half_widths_m(r.tracks, at_s, r.filter_parameters, pose, rule.hands_within)

    @property
    def _recorded_words(self) -> str:
        """The recorded text of the fault if the pending decision was late, or an empty text."""
        number = len(self._decisions)
        return self._recorded_late[number] if number < len(self._recorded_late) else ""

    def decide(self, query: Query, ruling: GateDecision) -> None:
        """Store the gate's decision ``ruling`` about ``query``.

        The decision becomes the stack's answer, and is added to the decisions of the run.
        """
        answer = self.records.answer
        answer["stop"] = ruling.outcome is DecisionOutcome.STOP
        answer["position_in_base_m"] = ruling.chosen_position_in_base_m
        self._latencies_s.append(ruling.latency_s)
        self._decisions.append(self._record(query, ruling))

    def _record(self, query: Query, ruling: GateDecision) -> NDArray[np.void]:
        """Return a record DECISION (1,) with the data of ``query`` and of the gate's decision ``ruling``."""
        record = np.zeros(1, self._decision)
        for name in ("tick", "time_s", "asked_tick", "decision_time_s"):
            record[name] = self.records.question[name]
        record["trigger"] = self.records.state["trigger"]
        for name in ("seed", "hand_position_in_base_m", "tcp_position_in_base_m", "joint_position_rad"):
            record[name] = getattr(query, name)
        for name in ("spread_threshold_m", "chosen_position_in_base_m", "outcome"):
            record[name] = getattr(ruling, name)
        record["proposed_position_in_base_m"] = ruling.proposed.position_in_base_m
        record["proposed_spread_m"] = ruling.proposed.spread_m
        record["opposite_position_in_base_m"] = ruling.opposite.position_in_base_m
        record["proposed_failed"] = ruling.proposed_failed
        record["opposite_failed"] = ruling.opposite_failed
        record["fault"] = ruling.fault[:FAULT_CHARACTERS]
        return record


@lru_cache(maxsize=16)  # many episodes differ only in their hands and starts
def _fixed(settings: Settings, arm: ArmModel, view: DesiredView) -> tuple[NDArray[np.void], NDArray[np.void]]:
    """Return PARAMETERS (1,) and FILTER_PARAMETERS (1,), which are the same in every episode."""
    return parameters(settings, arm, view), filter_parameters(settings.hand_filter, settings.hand_sensor)
