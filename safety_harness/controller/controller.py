"""The controller under test: servo, watch the hands, give way, stop.

``Controller`` is the seam for a user's own; ``AvoidingServo`` composes the compiled control
stack with an avoider and the gate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from safety_harness.avoidance.avoider import Avoider
from safety_harness.avoidance.faulty import Asked, answer_delay_s, avoider_faults, faulty
from safety_harness.avoidance.gate import Gate, Query, Ruling
from safety_harness.controller.records import ANSWER, COMMAND, initial_state, parameters
from safety_harness.controller.stack import begin_tick, finish_tick
from safety_harness.perception.hand_filter import filter_parameters
from safety_harness.perception.tracking import no_tracks
from safety_harness.robot.description import ArmModel
from safety_harness.scenario.fault_table import fault_table
from safety_harness.seeds import Branch, seed
from safety_harness.servoing.control import DesiredView
from safety_harness.settings import Settings
from safety_harness.trace.records import DECISION, FAULT_CHARACTERS, Mode, Outcome

FROM_STATE = (
    "object_visible",
    "features",
    "feature_error",
    "sse",
    "track_valid",
    "predicted_hand_in_base_m",
    "predicted_distance_m",
    "mode",
    "gain",
    "camera_twist",
    "limits",
)


class Controller(Protocol):
    """One episode's controller: an observation in, a command out."""

    @property
    def name(self) -> str:
        """How traces and reports call it."""
        ...

    def step(self, observation: NDArray[np.void]) -> NDArray[np.void]:
        """(1,) OBSERVATION to (1,) COMMAND; the returned array may be reused by the next call."""
        ...

    def report(self, tick: NDArray[np.void]) -> None:
        """Write what was perceived and decided into ``tick`` (1,) TICK, for the trace."""
        ...

    @property
    def decisions(self) -> NDArray[np.void]:
        """(m,) DECISION: every decision so far."""
        ...

    @property
    def decision_latencies_s(self) -> NDArray[np.float64]:
        """(m,) how long each of them took on the wall's clock."""
        ...


@dataclass(frozen=True, eq=False)
class Question:
    """What the avoider was asked, and from which tick on its answer counts; ``late``: that there is none."""

    avoider: Avoider
    hand_position_in_base_m: NDArray[np.float64]  # (3,)
    trigger: int
    counts_from: int
    late: bool
    faults: int  # bits


class AvoidingServo:
    """The paper's controller; ``avoider`` proposes, ``gate`` rules, the stack acts.

    ``recorded_late`` (m,) repeats which decisions of an earlier run came too late; those after them,
    or all without it, are timed by the clock.  ``faults`` (n,) FAULT may make the avoider late: until
    its answer counts, or the decision deadline is over, the controller goes on with what it was doing.
    """

    def __init__(
        self,
        settings: Settings,
        arm: ArmModel,
        view: DesiredView,
        avoider: Avoider,
        gate: Gate,
        root_seed: int,
        recorded_late: Sequence[bool] = (),
        faults: NDArray[np.void] | None = None,
    ) -> None:
        self.name = avoider.name
        self._avoider = avoider
        self._gate = gate
        self._root_seed = root_seed
        self._faults = fault_table(()) if faults is None else faults
        self._period_s = settings.clock.control_period_s
        self._deadline_s = settings.avoidance.decision_deadline_s
        self._question: Question | None = None
        self._acted_faults = 0
        self._parameters = parameters(settings, arm, view)
        self._filter_parameters = filter_parameters(settings.hand_filter, settings.hand_sensor)
        self._state = initial_state()
        self._tracks = no_tracks()
        self._answer = np.zeros(1, ANSWER)
        self._command = np.zeros(1, COMMAND)
        self._recorded_late = tuple(recorded_late)
        self._decisions: list[NDArray[np.void]] = []
        self._latencies_s: list[float] = []
        self._decided_now = False
        self._ticks = 0

    def step(self, observation: NDArray[np.void]) -> NDArray[np.void]:
        """Look, decide if asked to, act."""
        asked = begin_tick(self._parameters, self._filter_parameters, self._state, self._tracks, observation)
        self._acted_faults, self._decided_now = 0, False
        if asked and self._question is None:
            self._question = self._ask(float(observation[0]["time_s"]))
        if self._question is not None:
            self._wait_or_decide(self._question, observation)
        finish_tick(self._parameters, self._state, observation, self._answer, self._command)
        self._ticks += 1
        return self._command

    def report(self, tick: NDArray[np.void]) -> None:
        """Copy what the stack knows into the trace's record of this tick."""
        for name in FROM_STATE:  # arrays of one record: their fields are quicker than a record's
            tick[name] = self._state[name]
        tick["demanded_joint_velocity_radps"] = self._command["joint_velocity_radps"]
        tick["decision"] = len(self._decisions) - 1 if self._decided_now else -1
        tick["faults"] |= self._acted_faults

    @property
    def decisions(self) -> NDArray[np.void]:
        """(m,) DECISION."""
        return np.concatenate([np.zeros(0, DECISION), *self._decisions])

    @property
    def decision_latencies_s(self) -> NDArray[np.float64]:
        """(m,) wall-clock time from the question to the avoider's answer, or to giving up on it."""
        return np.array(self._latencies_s, dtype=np.float64)

    def _ask(self, time_s: float) -> Question:
        """The question of now; a healthy avoider's answer counts at once."""
        state = self._state[0]
        hand_in_base_m = state["predicted_hand_in_base_m"][state["nearest_track"]].copy()
        avoider = faulty(self._faults, self._avoider, time_s)
        delay_s = answer_delay_s(self._faults, time_s)
        ticks = ceil(min(delay_s, self._deadline_s) / self._period_s - 1e-9)
        if ticks > 0:
            avoider = Asked(avoider, hand_in_base_m, state["transform_tcp_to_base"][:3, 3].copy())
        return Question(
            avoider,
            hand_in_base_m,
            int(state["trigger"]),
            self._ticks + ticks,
            delay_s > self._deadline_s,
            avoider_faults(self._faults, time_s),
        )

    def _wait_or_decide(self, question: Question, observation: NDArray[np.void]) -> None:
        """Go on as before until the answer counts; one that comes after a protective stop is of no use."""
        state = self._state[0]
        self._acted_faults = question.faults
        if self._ticks < question.counts_from:
            state["decision_pending"] = False
            return
        self._question = None
        if state["mode"] == Mode.PROTECTIVE_STOP:
            state["decision_pending"] = False
            return
        self._decided_now = True
        state["decision_pending"], state["trigger"] = True, question.trigger
        self._decide(question, observation)

    def _decide(self, question: Question, observation: NDArray[np.void]) -> None:
        """Let the gate hear the avoider and rule, note everything down."""
        state, o = self._state[0], observation[0]
        number = len(self._decisions)
        nearest = state["nearest_track"]
        hand = (
            state["predicted_hand_in_base_m"][nearest] if nearest >= 0 else question.hand_position_in_base_m
        )
        recorded = self._recorded_late[number] if number < len(self._recorded_late) else None
        query = Query(
            hand_position_in_base_m=hand.copy(),
            tcp_position_in_base_m=state["transform_tcp_to_base"][:3, 3].copy(),
            transform_tcp_to_base=state["transform_tcp_to_base"].copy(),
            joint_position_rad=o["joint_position_rad"].copy(),
            hands_in_base_m=state["predicted_hand_in_base_m"][state["track_valid"] != 0],
            seed=seed(self._root_seed, Branch.DECISION, number),
            late=True if question.late else recorded,
        )
        ruling = self._gate.rule(question.avoider, query)
        self._answer["stop"] = ruling.outcome is Outcome.STOP
        self._answer["position_in_base_m"] = ruling.chosen_position_in_base_m
        self._latencies_s.append(ruling.latency_s)
        self._decisions.append(self._record(query, ruling, float(o["time_s"])))

    def _record(self, query: Query, ruling: Ruling, time_s: float) -> NDArray[np.void]:
        """(1,) DECISION."""
        record = np.zeros(1, DECISION)
        record["tick"], record["time_s"] = self._ticks, time_s
        record["trigger"] = self._state["trigger"]
        record["seed"] = query.seed
        record["hand_position_in_base_m"] = query.hand_position_in_base_m
        record["tcp_position_in_base_m"] = query.tcp_position_in_base_m
        record["joint_position_rad"] = query.joint_position_rad
        record["proposed_position_in_base_m"] = ruling.proposed.position_in_base_m
        record["proposed_spread_m"] = ruling.proposed.spread_m
        record["spread_threshold_m"] = ruling.spread_threshold_m
        record["opposite_position_in_base_m"] = ruling.opposite.position_in_base_m
        record["chosen_position_in_base_m"] = ruling.chosen_position_in_base_m
        record["outcome"] = ruling.outcome
        record["proposed_failed"] = ruling.proposed_failed
        record["opposite_failed"] = ruling.opposite_failed
        record["fault"] = ruling.fault[:FAULT_CHARACTERS]
        return record
