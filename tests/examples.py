"""Scenarios, runs and broken parts that several tests use."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from safety_harness.admission.admit import Admitted, admit
from safety_harness.base.settings import DEFAULTS, Settings
from safety_harness.cell.avoidance.asking import Answer
from safety_harness.cell.avoidance.avoider import Avoider, Proposal
from safety_harness.cell.avoidance.gate import Gate, Query
from safety_harness.cell.controller.controller import AvoidingServo, Controller
from safety_harness.cell.controller.records import COMMAND
from safety_harness.cell.robot.robots import arm_capsules, inverse_kinematics
from safety_harness.cell.simulation.simulate import simulate
from safety_harness.cell.simulation.worlds import PYBULLET
from safety_harness.scenario.expand import read_all_scenarios
from safety_harness.scenario.model import MovingHand, OffsetStart, Scenario
from safety_harness.scenario.moves import HandMove, MoveTo, Wait, Withdraw
from safety_harness.scenario.robots import Robot
from safety_harness.trace.records import DECISION, Check
from safety_harness.trace.trace import Trace


@cache
def shipped() -> dict[str, Scenario]:
    """Every shipped scenario, by its name."""
    return {one.name: one for one in read_all_scenarios(Path(__file__).parents[1] / "scenarios")}


def hand(
    *moves: HandMove, at: tuple[float, float, float] = (1.1, -0.75, 0.2), name: str = "right"
) -> MovingHand:
    return MovingHand(
        name=name, starts_at_in_base_m=at, elbow_towards_in_base_m=(1.6, -1.2, 0.3), moves=tuple(moves)
    )


VISIT = hand(
    MoveTo(position_in_base_m=(0.84, -0.35, 0.25), speed_mps=1.0),
    Wait(duration_s=0.4),
    Withdraw(speed_mps=1.0),
)


def scenario(
    *hands: MovingHand,
    duration_s: float = 2.5,
    offset: tuple[float, float, float] = (0.04, -0.12, 0.06),
    tilt: tuple[float, float, float] = (0.0, 0.0, 0.0),
    avoider: str = "opposite pose",
    settings: Settings = DEFAULTS,
    seed: int = 1,
) -> Scenario:
    return Scenario(
        name="example",
        title="an example",
        about="",
        duration_s=duration_s,
        seed=seed,
        start=OffsetStart(offset_in_base_m=offset, tilt_in_tcp_rad=tilt),
        hands=hands,
        avoider=avoider,
        claims=(),
        settings=settings,
    )


def run(
    what: Scenario,
    *,
    avoider: Avoider | None = None,
    controller: Controller | None = None,
    gate: Gate | None = None,
) -> Trace:
    admitted = admit(what, avoider=avoider)
    if controller is None:
        controller = admitted.controller() if gate is None else ungated(admitted, gate)
    with PYBULLET.open(what, admitted.arm, admitted.joint_position_rad) as world:
        return simulate(world, controller, what)


def ur10_gate(settings: Settings) -> Gate:
    """The gate of the UR10."""
    return Gate.from_settings(settings, inverse_kinematics(Robot.UR10), arm_capsules(Robot.UR10))


def ungated(admitted: Admitted, gate: Gate) -> AvoidingServo:
    return AvoidingServo(
        admitted.scenario.settings,
        admitted.arm,
        admitted.view,
        admitted.avoider,
        gate,
        admitted.scenario.seed,
    )


class PassingGate(Gate):
    """A broken gate: it passes whatever is proposed."""

    def check(self, position_in_base_m: NDArray[np.float64], query: Query) -> Check:
        return Check.NONE


@dataclass(frozen=True)
class TowardsTheHand:
    """A broken avoider: it moves to where the hand is."""

    name: str = "towards the hand"

    def propose(
        self,
        *,
        hand_position_in_base_m: NDArray[np.float64],
        tcp_position_in_base_m: NDArray[np.float64],
        seed: int,
    ) -> Proposal:
        return Proposal(hand_position_in_base_m)


class RefusingGate(Gate):
    """A broken gate: whatever an avoider with a threshold proposes, it falls back."""

    def _failed(self, answer: Answer, query: Query) -> Check:
        return super()._failed(answer, query) if np.isnan(answer.spread_threshold_m) else Check.UNREACHABLE


class StoppingGate(Gate):
    """A broken gate: it lets nothing pass."""

    def check(self, position_in_base_m: NDArray[np.float64], query: Query) -> Check:
        return Check.UNREACHABLE


@dataclass(frozen=True)
class Displaced:
    """An avoider that always proposes the same displacement, and says how sure it is."""

    by_m: tuple[float, float, float]
    name: str = "displaced"
    spread_m: float = 0.0
    spread_threshold_m: float | None = None

    def propose(
        self,
        *,
        hand_position_in_base_m: NDArray[np.float64],
        tcp_position_in_base_m: NDArray[np.float64],
        seed: int,
    ) -> Proposal:
        return Proposal(tcp_position_in_base_m + np.array(self.by_m), np.full(3, self.spread_m))


@dataclass(frozen=True)
class Raising:
    """An avoider that has an answer to nothing."""

    name: str = "raising"

    def propose(
        self,
        *,
        hand_position_in_base_m: NDArray[np.float64],
        tcp_position_in_base_m: NDArray[np.float64],
        seed: int,
    ) -> Proposal:
        raise ZeroDivisionError(f"at {hand_position_in_base_m[0]}")


@dataclass(frozen=True)
class Slow:
    """An avoider that says how long it takes."""

    decision_time_s: float
    name: str = "slow"

    def propose(
        self,
        *,
        hand_position_in_base_m: NDArray[np.float64],
        tcp_position_in_base_m: NDArray[np.float64],
        seed: int,
    ) -> Proposal:
        return Proposal(2.0 * tcp_position_in_base_m - hand_position_in_base_m)


class ConstantSpeed:
    """A broken controller: it turns the joints at a constant speed, whatever it sees."""

    name = "constant speed"

    def __init__(self, joint_velocity_radps: tuple[float, ...]) -> None:
        self._command = np.zeros(1, COMMAND)
        self._command["joint_velocity_radps"] = joint_velocity_radps

    def step(self, observation: NDArray[np.void]) -> NDArray[np.void]:
        return self._command

    def report(self, tick: NDArray[np.void]) -> None:
        tick["decision"] = -1
        tick["sse"] = np.nan
        tick["predicted_distance_m"] = np.inf

    @property
    def decisions(self) -> NDArray[np.void]:
        return np.zeros(0, DECISION)

    @property
    def decision_latencies_s(self) -> NDArray[np.float64]:
        return np.zeros(0)


@dataclass(frozen=True)
class AnswersNothing:
    """A broken avoider with a threshold: it raises whatever it is asked."""

    name: str = "answers nothing"
    spread_threshold_m: float = 0.02

    def propose(
        self,
        *,
        hand_position_in_base_m: NDArray[np.float64],
        tcp_position_in_base_m: NDArray[np.float64],
        seed: int,
    ) -> Proposal:
        raise ValueError("no idea")


class Nonsense(ConstantSpeed):
    """A broken controller: from 40 ms on its features, and what it makes of them, are no numbers."""

    name = "nonsense"

    def report(self, tick: NDArray[np.void]) -> None:
        super().report(tick)
        tick["object_visible"] = True
        tick["sse"] = 0.02
        if tick["time_s"] > 0.04:
            tick["sse"] = np.nan
            tick["camera_twist"] = np.nan
