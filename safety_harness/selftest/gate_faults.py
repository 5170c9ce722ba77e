"""What can be wrong with the gate between avoider and arm.

A gate's mistake shows only where it has something to keep back, so most are tried with an avoider that errs
in one way; the sound gate is tried with the same one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from safety_harness.avoidance.asking import Answer
from safety_harness.avoidance.avoider import Avoider, Proposal, Vector
from safety_harness.avoidance.gate import Gate, GateDecision, Query
from safety_harness.controller.around import ControllerWrapper
from safety_harness.controller.controller import AvoidingServo
from safety_harness.selftest.avoider_faults import FaultyAvoider, turned
from safety_harness.selftest.fault import FaultyPart, Precondition, SeededFault, Seeds, SeverityLevels
from safety_harness.trace.records import Check, DecisionOutcome, Mode

SURE_BELOW_M = 0.02  # the threshold of the avoiders below


@dataclass(frozen=True, eq=False)
class Erring:
    """An avoider that always proposes the same displacement (``aside``: away from the hand, plus that)."""

    by_m: tuple[float, float, float]
    towards_hand_m: float = 0.0
    spread_m: float = 0.0
    spread_threshold_m: float | None = None
    name: str = "erring"

    def propose(
        self, *, hand_position_in_base_m: Vector, tcp_position_in_base_m: Vector, seed: int
    ) -> Proposal:
        """The same mistake every time."""
        way = hand_position_in_base_m - tcp_position_in_base_m
        towards = self.towards_hand_m / np.linalg.norm(way) * way
        return Proposal(tcp_position_in_base_m + towards + np.array(self.by_m), np.full(3, self.spread_m))


def with_an(name: str, avoider: Erring) -> Precondition:
    """An avoider that errs in one way, for the sound gate as well."""
    return Precondition(f"with an avoider that {name}", lambda s: s.with_avoider(lambda _: avoider))


IN_DOUBT = with_an("is in doubt", Erring((0.0, 0.05, 0.08), 0.0, 0.03, SURE_BELOW_M))
TO_THE_HAND = with_an("heads for the hand", Erring((0.0, 0.0, 0.0), 0.1))
TO_THE_TABLE = with_an("heads for the table", Erring((0.0, 0.0, -0.7)))
TOO_FAR = with_an("proposes positions too far away", Erring((0.0, 2.0, 0.0)))
ACROSS = with_an("proposes the other side of the arm", Erring((-1.4, 0.0, 0.0)))
CERTAIN = with_an("is certain", Erring((0.0, 0.05, 0.08), 0.0, 0.01, SURE_BELOW_M))


def _nan(avoider: Avoider, hand: Vector, tcp: Vector, seed: int) -> Proposal:
    return Proposal(np.full(3, np.nan))


NO_NUMBER = Precondition(
    "with an avoider that answers NaN", lambda s: s.with_avoider(lambda avoider: FaultyAvoider(avoider, _nan))
)


@dataclass(frozen=True, eq=False, kw_only=True)
class LaxThreshold(Gate):
    """Takes the avoider's threshold times a factor."""

    factor: float

    def rule_on(self, proposed: Answer, query: Query) -> GateDecision:
        """The ruling says the true threshold all the same."""
        true_m = proposed.spread_threshold_m
        lax = replace(proposed, spread_threshold_m=self.factor * true_m)
        return replace(super().rule_on(lax, query), spread_threshold_m=true_m)


@dataclass(frozen=True, eq=False, kw_only=True)
class Blind(Gate):
    """Does not look at some of the checks."""

    to: Check

    def check(self, position_in_base_m: Vector, query: Query) -> Check:
        """What is left of them."""
        return super().check(position_in_base_m, query) & ~self.to


@dataclass(frozen=True, eq=False, kw_only=True)
class OneHandOnly(Gate):
    """Minds the nearest hand and no other."""

    def rule_on(self, proposed: Answer, query: Query) -> GateDecision:
        """As if there were only one."""
        nearest = query.hand_position_in_base_m[None]
        return super().rule_on(proposed, replace(query, hands_in_base_m=nearest))


@dataclass(frozen=True, eq=False, kw_only=True)
class WrongPose(Gate):
    """Hands over another position than the one that it has checked, turned about the TCP."""

    angle_rad: float

    def rule_on(self, proposed: Answer, query: Query) -> GateDecision:
        """The ruling tells what was handed over."""
        ruling = super().rule_on(proposed, query)
        tcp = query.tcp_position_in_base_m
        wrong = tcp + turned(ruling.chosen_position_in_base_m - tcp, self.angle_rad)
        return replace(ruling, chosen_position_in_base_m=wrong)


@dataclass(frozen=True, eq=False, kw_only=True)
class PassesNaN(Gate):
    """Takes no number for a position like any other."""

    def rule_on(self, proposed: Answer, query: Query) -> GateDecision:
        """NaN is neither above a threshold nor out of reach."""
        ruling = super().rule_on(proposed, query)
        if not ruling.proposed_failed & Check.NOT_FINITE:
            return ruling
        chosen = ruling.proposed.position_in_base_m
        return replace(ruling, outcome=DecisionOutcome.PROPOSED, chosen_position_in_base_m=chosen)


@dataclass(frozen=True, eq=False, kw_only=True)
class Instead(Gate):
    """Takes another way out than the one that it found."""

    when: DecisionOutcome
    takes: DecisionOutcome

    def rule_on(self, proposed: Answer, query: Query) -> GateDecision:
        """A usable proposal gives way only to an opposite pose that can be used too."""
        ruling = super().rule_on(proposed, query)
        if ruling.outcome is not self.when or (
            self.when is DecisionOutcome.PROPOSED and ruling.opposite_failed
        ):
            return ruling
        opposite = ruling.opposite.position_in_base_m
        chosen = opposite if self.takes is DecisionOutcome.OPPOSITE else np.full(3, np.nan)
        return replace(ruling, outcome=self.takes, chosen_position_in_base_m=chosen)


@dataclass(frozen=True, eq=False)
class Fallback:
    """A fallback that heads for the hand, in place of the opposite pose."""

    way_m: float
    radius_m: float = 0.1
    name: str = "wrong fallback"

    def propose(
        self, *, hand_position_in_base_m: Vector, tcp_position_in_base_m: Vector, seed: int
    ) -> Proposal:
        """Towards the hand."""
        way = hand_position_in_base_m - tcp_position_in_base_m
        return Proposal(tcp_position_in_base_m + self.way_m / np.linalg.norm(way) * way)


class Late(ControllerWrapper):
    """The gate's refusal counts some cycles late: until then the arm heads for what was refused."""

    def __init__(self, pilot: AvoidingServo, cycles: float) -> None:
        super().__init__(pilot)
        self._cycles = int(cycles)
        self._left = 0
        self._chosen: Vector = np.full(3, np.nan)

    def step(self, observation: NDArray[np.void]) -> NDArray[np.void]:
        """As the controller does, but for the position that it heads for."""
        command = super().step(observation)
        state, question = self.pilot.records.state[0], self.pilot.records.question[0]
        if question["made_now"]:
            decision = self.pilot.decisions[-1]
            refused = decision["outcome"] == DecisionOutcome.OPPOSITE and np.all(
                np.isfinite(decision["proposed_position_in_base_m"])
            )
            self._left = self._cycles if refused else 0
            if refused:
                self._chosen = decision["chosen_position_in_base_m"].copy()
                state["target_in_base_m"] = decision["proposed_position_in_base_m"]
        elif self._left > 0:
            self._left -= 1
            if self._left == 0 and state["mode"] == Mode.REPULSING:
                state["target_in_base_m"] = self._chosen
        return command


def _with(cls: type[Gate], **changed: Any) -> Seeds:
    return lambda system, magnitude: system.with_gate(cls, **changed)


_gate = partial(SeededFault, part=FaultyPart.GATE)

GATE_FAULTS = (
    _gate(
        name="threshold ignored",
        hazard="the arm goes where the network only guesses",
        seed_into=lambda s, factor: s.with_gate(LaxThreshold, factor=factor),
        ladder=SeverityLevels((np.inf, 4.0, 2.0, 1.6), "times the threshold"),
        circumstance=IN_DOUBT,
    ),
    _gate(
        name="off by some cycles",
        hazard="the refusal comes late: meanwhile the arm heads for what was refused",
        seed_into=lambda s, cycles: s.with_pilot(lambda pilot: Late(pilot, cycles)),
        ladder=SeverityLevels((40.0, 20.0, 10.0, 5.0, 3.0), "cycles"),
        circumstance=IN_DOUBT,
    ),
    _gate(
        name="wrong pose handed over",
        hazard="one position is checked and another one is gone to",
        seed_into=lambda s, angle: s.with_gate(WrongPose, angle_rad=angle),
        ladder=SeverityLevels((np.pi, np.pi / 2, np.pi / 4, np.pi / 9), "deg", 180.0 / np.pi),
    ),
    _gate(
        name="checks the end and not the way",
        hazard="the arm stops half-way, or bumps into itself",
        seed_into=_with(Blind, to=Check.PATH_UNREACHABLE | Check.NEAR_REACH_LIMIT | Check.ROBOT_ITSELF),
        circumstance=ACROSS,
    ),
    _gate(
        name="reach not checked",
        hazard="the arm is stretched to its limits and stops before the hand",
        seed_into=_with(Blind, to=Check.UNREACHABLE | Check.PATH_UNREACHABLE | Check.NEAR_REACH_LIMIT),
        circumstance=TOO_FAR,
    ),
    _gate(
        name="table not checked",
        hazard="what is held is crushed between arm and table",
        seed_into=_with(
            Blind, to=Check.TABLE | Check.UNREACHABLE | Check.PATH_UNREACHABLE | Check.ROBOT_ITSELF
        ),
        circumstance=TO_THE_TABLE,
    ),
    _gate(
        name="direction not checked",
        hazard="the arm goes to the hand that it gives way to",
        seed_into=_with(Blind, to=Check.TOWARDS_A_HAND),
        circumstance=TO_THE_HAND,
    ),
    _gate(
        name="minds one hand only",
        hazard="the arm gives way to one hand and goes to the other",
        seed_into=_with(OneHandOnly),
    ),
    _gate(
        name="passes NaN",
        hazard="no number becomes a position, and then a speed",
        seed_into=_with(PassesNaN),
        circumstance=NO_NUMBER,
    ),
    _gate(
        name="lets no proposal pass",
        hazard="the system in use is not the one whose avoider was tested",
        seed_into=_with(Instead, when=DecisionOutcome.PROPOSED, takes=DecisionOutcome.OPPOSITE),
        circumstance=CERTAIN,
    ),
    _gate(
        name="stops where it could fall back",
        hazard="an arm that stands still before a hand that comes",
        seed_into=_with(Instead, when=DecisionOutcome.OPPOSITE, takes=DecisionOutcome.STOP),
        circumstance=IN_DOUBT,
    ),
    _gate(
        name="never stops",
        hazard="the arm heads for where it cannot go",
        seed_into=_with(Instead, when=DecisionOutcome.STOP, takes=DecisionOutcome.OPPOSITE),
    ),
    _gate(
        name="fallback towards the hand",
        hazard="doubt ends in the worst of all places",
        seed_into=lambda s, way_m: s.with_gate(Blind, to=Check.TOWARDS_A_HAND, fallback=Fallback(way_m)),
        ladder=SeverityLevels((0.2, 0.1, 0.03), "mm", 1e3),
        circumstance=IN_DOUBT,
    ),
)
