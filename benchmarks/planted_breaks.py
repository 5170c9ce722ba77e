"""For every claim of the catalogue a family of broken runs, from sound to broken by one magnitude.

Almost all are runs in the kinematic world: of a hand, an avoider, a gate, a controller or a sensor that errs
by that much.  ``excess`` says by how much the run is beyond what the claim allows (``own_oracles``).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import own_oracles as own
from broken import gate_of
from examples import VISIT, ConstantSpeed, hand, scenario, ungated, ur10_gate
from harmless import setting
from numpy.typing import NDArray
from planted_controllers import alone

from safety_harness.admission.admit import admit
from safety_harness.admission.trial import run_kinematic
from safety_harness.base.settings import DEFAULTS
from safety_harness.cell.avoidance.avoider import Proposal
from safety_harness.cell.avoidance.gate import Gate
from safety_harness.cell.avoidance.measures import optimum_in_base_m
from safety_harness.cell.controller.around import ControllerWrapper
from safety_harness.extensions.selftest.gate_faults import FaultyGate
from safety_harness.scenario.gate import AskedRegion, GateRule, PositionBox
from safety_harness.scenario.model import Scenario
from safety_harness.scenario.moves import MoveTo, Wait
from safety_harness.scenario.obstacles import Obstacle
from safety_harness.seams.contract import UserController
from safety_harness.trace.records import Mode
from safety_harness.trace.trace import Trace

Vector = NDArray[np.float64]
TCP_M = np.array(DEFAULTS.cell.desired_tcp_position_in_base_m) + (0.04, -0.12, 0.06)
TO_HAND = np.array([1.0, -1.0, -0.5]) / 1.5  # where hands rest, from the TCP
ACROSS = np.array([1.0, 1.0, 0.0]) / np.sqrt(2.0)
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Break:
    """A family of runs: ``plant`` makes the one with a magnitude, sound at ``sound``, broken at ``broken``.

    ``excess`` is above zero for a run that breaks the claim, in ``unit``.  Shown is the excess of the
    smallest that is caught, or its magnitude times ``shown``.  ``step`` is how closely the magnitude is
    bisected; ``whole`` magnitudes are counts.  ``known`` is how far claim and oracle may be apart.
    """

    sentence: str
    what: str
    unit: str
    plant: Callable[[float], Trace]
    excess: Callable[[Trace], float]
    sound: float
    broken: float
    step: float = 1e-6
    shown: float | None = None
    whole: bool = False
    known: float = 1e-3


def driven(what: Scenario, joint: int, radps: float) -> Trace:
    """An arm that turns one joint at a constant speed, whatever it sees."""
    speeds = tuple(radps if k == joint else 0.0 for k in range(6))
    return run_kinematic(admit(what), controller=ConstantSpeed(speeds))


def tried(what: Scenario, avoider: Any = None, gate: Gate | None = None) -> Trace:
    """A run with this avoider and this gate."""
    admitted = admit(what, avoider=avoider)
    controller = admitted.controller() if gate is None else ungated(admitted, gate)
    return run_kinematic(admitted, controller=controller)


def set_up(what: Scenario, **parts: dict[str, Any]) -> Trace:
    """A run whose controller was set up for other settings than the cell's."""
    return run_kinematic(admit(what), controller=admit(setting(**parts)(what)).controller())


def resting(away_m: float, duration_s: float = 0.6, **changed: Any) -> Scenario:
    """A hand that rests so far from the TCP's start."""
    at = TCP_M + away_m * TO_HAND
    there = replace(hand(at=tuple(at)), elbow_towards_in_base_m=tuple(at + 5.0 * TO_HAND))
    return replace(scenario(there, duration_s=duration_s), **changed)


def passing_by(away_m: float) -> Trace:
    """A hand that passes at 1 m/s, so far from where the TCP was, an arm that turns slowly."""
    at = TCP_M + away_m * TO_HAND
    way = replace(
        hand(MoveTo(position_in_base_m=tuple(at + 0.3 * ACROSS), speed_mps=1.0), at=tuple(at - 0.3 * ACROSS)),
        elbow_towards_in_base_m=tuple(at + 5.0 * TO_HAND),
    )
    return driven(scenario(way, duration_s=0.6), 0, 0.05)


@dataclass(frozen=True)
class Proposes:
    """An avoider that answers ``where`` (hand, TCP), and how sure it is."""

    where: Callable[[Vector, Vector], Vector]
    spread_m: float = 0.0
    spread_threshold_m: float | None = None
    name: str = "proposes"

    def propose(
        self, *, hand_position_in_base_m: Vector, tcp_position_in_base_m: Vector, seed: int
    ) -> Proposal:
        """The same for all seeds."""
        return Proposal(
            self.where(hand_position_in_base_m, tcp_position_in_base_m), np.full(3, self.spread_m)
        )


def nearer(by_m: float) -> Callable[[Vector, Vector], Vector]:
    """100 mm aside of the hand, and so far towards it."""

    def where(hand_m: Vector, tcp_m: Vector) -> Vector:
        unit = (hand_m - tcp_m) / np.linalg.norm(hand_m - tcp_m)
        aside = np.cross(unit, UP)
        return tcp_m + by_m * unit + 0.1 * aside / np.linalg.norm(aside)

    return where


def off_optimum(by_m: float) -> Callable[[Vector, Vector], Vector]:
    """So far above the optimum."""
    return lambda hand_m, tcp_m: (
        optimum_in_base_m(DEFAULTS, hand_m[None], tcp_m[None])[0] + by_m * np.array([0.0, 0.0, 1.0])
    )


@dataclass
class NowAndThen:
    """An avoider that is in doubt of its first answers, or gives none to some questions."""

    doubts: int = 0
    silent: int = 0
    name: str = "now and then"
    spread_threshold_m: float = 0.02
    asked: int = field(default=0)

    def propose(
        self, *, hand_position_in_base_m: Vector, tcp_position_in_base_m: Vector, seed: int
    ) -> Proposal:
        """The same for all seeds."""
        self.asked += 1
        if self.asked <= self.silent:
            raise ValueError("no idea")
        spread_m = 0.03 if self.asked <= self.doubts else 0.01
        away = tcp_position_in_base_m - hand_position_in_base_m
        return Proposal(tcp_position_in_base_m + 0.03 * away / np.linalg.norm(away), np.full(3, spread_m))


class Idle(ControllerWrapper):
    """The visual servo, which does not move for its first cycles, though it says that it servoes."""

    def __init__(self, pilot: Any, cycles: int) -> None:
        super().__init__(pilot)
        self._left = cycles

    def step(self, observation: NDArray[np.void]) -> NDArray[np.void]:
        """As the servo, but for that."""
        command = super().step(observation).copy()
        self._left -= 1
        if self._left >= 0:
            command["joint_velocity_radps"] = 0.0
        return command


class GoesOn(ControllerWrapper):
    """The visual servo, which goes on as before for some cycles after it has called a stop."""

    def __init__(self, pilot: Any, cycles: int) -> None:
        super().__init__(pilot)
        self._left, self._before = cycles, np.zeros(6)

    def step(self, observation: NDArray[np.void]) -> NDArray[np.void]:
        """As the servo, but for that."""
        command = super().step(observation).copy()
        if command[0]["protective_stop"] and self._left > 0:
            self._left -= 1
            command["protective_stop"] = False
            command["joint_velocity_radps"] = self._before
        self._before = command[0]["joint_velocity_radps"].copy()
        return command


class Numberless(ConstantSpeed):
    """A controller that reports errors which are no number, in its first cycles."""

    name = "numberless"

    def __init__(self, cycles: int) -> None:
        super().__init__((0.1,) * 6)
        self._left = cycles

    def report(self, tick: NDArray[np.void]) -> None:
        """As the controller, but for that."""
        super().report(tick)
        self._left -= 1
        tick["object_visible"], tick["sse"] = True, np.nan if self._left >= 0 else 0.02


def around(what: Scenario, wrapper: type[ControllerWrapper], cycles: float) -> Trace:
    """A run with a wrapper around the visual servo."""
    admitted = admit(what)
    return run_kinematic(admitted, controller=wrapper(admitted.controller(), int(cycles)))


def of_user(what: Scenario, controller: UserController) -> Trace:
    """A run of a user's controller."""
    return run_kinematic(admit(alone(what), controller=controller))


def handed_over(avoider: Any, by_m: float) -> Trace:
    """A gate that hands over a position so far above the one that it has checked."""

    def rules(rule: Any, proposed: Any, query: Any) -> Any:
        ruling = rule(proposed, query)
        return replace(ruling, chosen_position_in_base_m=ruling.chosen_position_in_base_m + by_m * UP)

    return tried(scenario(VISIT), avoider, gate_of(FaultyGate, rules=rules))


def unheeded(beyond_m: float) -> Trace:
    """A gate that does not look at its region, whose hands begin so far beyond the hand that comes."""
    asked = TCP_M + 0.35 * TO_HAND
    hands = PositionBox(low_m=(asked[0] + beyond_m, -2.0, -2.0), high_m=(3.0, 2.0, 2.0))
    anywhere = PositionBox(low_m=(-2.0, -2.0, -2.0), high_m=(2.0, 2.0, 2.0))
    rule = GateRule(questions_within=AskedRegion(hand=hands, tcp=anywhere))
    return tried(resting(0.35, gate=rule), gate=ur10_gate(DEFAULTS))


def beside_box(away_m: float) -> Trace:
    """An arm that turns towards a box, so far from the TCP's start."""
    at = (TCP_M[0], TCP_M[1] + away_m, TCP_M[2] + 0.02)
    box = Obstacle(size_m=(0.05, 0.05, 0.05), position_in_base_m=at)
    return driven(replace(scenario(duration_s=0.6), obstacles=(box,)), 0, 0.3)


def returning(times: float) -> Trace:
    """A hand that comes so many times."""
    near, far = (0.84, -0.35, 0.25), (1.1, -0.75, 0.2)
    moves: list[Any] = []
    for _ in range(int(times)):
        moves += [MoveTo(position_in_base_m=near, speed_mps=1.0), Wait(duration_s=0.2)]
        moves += [MoveTo(position_in_base_m=far, speed_mps=1.0), Wait(duration_s=2.5)]
    return tried(scenario(hand(*moves), duration_s=25.0))


STAYS = hand(MoveTo(position_in_base_m=(0.84, -0.35, 0.25), speed_mps=1.0), Wait(duration_s=9.0))


def faulty(fault: Any, *hands: Any, duration_s: float = 2.5) -> Trace:
    """A run with a fault of the scenario."""
    return tried(replace(scenario(*hands, duration_s=duration_s), faults=(fault,)))


def opposite_m(trace: Trace, number: int) -> Vector:
    """(3,) the radius from the TCP away from the nearest predicted hand of a decision."""
    tick = trace.ticks[trace.decisions["tick"][number]]
    tcp, hands = tick["transform_tcp_to_base"][:3, 3], tick["predicted_hand_in_base_m"][tick["track_valid"]]
    way = tcp - hands[np.linalg.norm(hands - tcp, axis=1).argmin()]
    return np.asarray(tcp + trace.scenario.settings.avoidance.radius_m * way / np.linalg.norm(way))


def stretches(trace: Trace) -> list[tuple[int, Vector, Vector]]:
    """Of each decision its number, its opposite pose (3,), and (n, 3) the TCP until its repulsion is over."""
    found, ticks = [], list(trace.decisions["tick"])
    for number, first in enumerate(ticks):
        end = min([*ticks[number + 1 :], len(trace.ticks) - 1])
        others = np.flatnonzero(trace.ticks["mode"][first : end + 1] != Mode.REPULSING)
        end = first + int(others[0]) if len(others) else end
        found.append((number, opposite_m(trace, number), own.tcp_m(trace)[first : end + 1]))
    return found


def off_direction(trace: Trace) -> float:
    """By how much [deg] a way from 40 mm on, at full speed, is more than one degree off the pose."""
    worst = -np.inf
    for _, pose, tcp in stretches(trace):
        gone = np.flatnonzero(np.linalg.norm(tcp - tcp[0], axis=1) > 0.040)
        if not len(gone):
            continue
        chord, bearing = tcp[gone[0] :] - tcp[gone[0]], pose - tcp[gone[0]]
        chord = chord[np.linalg.norm(chord, axis=1) >= 0.010]
        cosine = chord @ bearing / np.linalg.norm(chord, axis=1) / np.linalg.norm(bearing)
        worst = max(worst, float(own.DEG * np.arccos(np.clip(cosine, -1.0, 1.0)).max(initial=0.0)) - 1.0)
    return worst


def late_cycles(trace: Trace) -> float:
    """How many cycles after the two that are allowed the TCP's velocity first changes by 2 mm/s."""
    velocity = np.diff(own.tcp_m(trace), axis=0) / own.period_s(trace)
    changed = np.linalg.norm(np.diff(velocity, axis=0), axis=1) > 0.002
    return max(float(np.argmax(changed[first - 1 :])) - 2.0 for first in trace.decisions["tick"][:1].tolist())


def behind(trace: Trace, speed: float, acceleration: float) -> float:
    """By how much [mm] more than 4 mm a TCP is behind a point with shares of the settings."""
    avoidance, dt, worst = trace.scenario.settings.avoidance, own.period_s(trace), -np.inf
    for number, pose, tcp in stretches(trace):
        first = int(trace.decisions["tick"][number])
        left = float(np.linalg.norm(pose - tcp[0]))
        v = float((tcp[0] - own.tcp_m(trace)[first - 1]) @ (pose - tcp[0])) / left / dt
        for here in tcp[1:]:
            most = min(
                speed * avoidance.repulsion_speed_mps,
                (2.0 * 0.7 * avoidance.repulsion_acceleration_mps2 * left) ** 0.5,
                left / dt,
            )
            v = min(most, v + acceleration * avoidance.repulsion_acceleration_mps2 * dt)
            left -= v * dt
            worst = max(worst, float(np.linalg.norm(pose - here)) - left)
    return 1e3 * (worst - 0.004)


def missed(trace: Trace) -> float:
    """By how much [mm] more than 2 mm the TCP is off the opposite pose where the next decision begins."""
    ended = [np.linalg.norm(tcp[-1] - pose) for _, pose, tcp in stretches(trace)[:-1]]
    return 1e3 * (float(max(ended)) - 0.002)


def astray(trace: Trace) -> float:
    """Above zero if the end was missed, or the direction (mm or degrees)."""
    return max(missed(trace), off_direction(trace))


def misled(trace: Trace, name: str = "") -> float:
    """By how much [mm] more than 1 mm a position that was handed over is off what it should be."""
    return 1e3 * max(
        float(
            np.linalg.norm(one["chosen_position_in_base_m"] - (one[name] if name else opposite_m(trace, k)))
        )
        - 0.001
        for k, one in enumerate(trace.decisions)
    )
