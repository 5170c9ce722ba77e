"""Define faults of the gate between avoider and arm.

A faulty gate can be noticed only if the gate has a proposal to refuse. Most of these faults therefore run
with an avoider that makes errors of a single kind. The sound gate, for comparison, runs with the same
avoider.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.elementary import length
from safety_harness.cell.avoidance.asking import NAN_PROPOSAL, Answer
from safety_harness.cell.avoidance.avoider import Proposal, Vector
from safety_harness.cell.avoidance.gate import Gate, GateDecision, Query
from safety_harness.cell.controller.around import ControllerWrapper
from safety_harness.cell.controller.controller import AvoidingServo
from safety_harness.extensions.selftest.avoider_faults import FaultyAvoider, turned
from safety_harness.extensions.selftest.fault import Precondition, Seeds, anywhere, faults_in, of_gate, seeded
from safety_harness.extensions.selftest.system import ChangedSystem
from safety_harness.trace.records import Check, DecisionOutcome, Mode

SURE_BELOW_M = 0.02  # spread threshold of the avoiders below
Rule = Callable[[Answer, Query], GateDecision]  # the sound gate's rule


@dataclass(frozen=True, eq=False)
class Erring:
    """An avoider that always makes the same error.

    It proposes the sum of two displacements: ``by_m``, and a displacement of length ``towards_hand_m``
    towards the hand.
    """

    by_m: tuple[float, float, float]
    towards_hand_m: float = 0.0
    spread_m: float = 0.0
    spread_threshold_m: float | None = None
    name: str = "erring"

    def propose(
        self, *, hand_position_in_base_m: Vector, tcp_position_in_base_m: Vector, seed: int
    ) -> Proposal:
        """Propose the same wrong displacement each time."""
        to_hand_m = hand_position_in_base_m - tcp_position_in_base_m
        towards = self.towards_hand_m / length(to_hand_m) * to_hand_m
        return Proposal(tcp_position_in_base_m + towards + np.array(self.by_m), np.full(3, self.spread_m))


def with_an(name: str, avoider: Erring) -> Precondition:
    """Return a precondition: both the faulty gate and the correct gate run with ``avoider``."""
    return Precondition(f"with an avoider that {name}", lambda s: s.with_avoider(lambda _: avoider))


# The displacements are choices. Where a name describes a direction or a place, the displacement fails the
# check of it. The spreads are above the threshold (in doubt) or below it (certain).
IN_DOUBT = with_an("is in doubt", Erring((0.0, 0.05, 0.08), 0.0, 0.03, SURE_BELOW_M))
TO_THE_HAND = with_an("heads for the hand", Erring((0.0, 0.0, 0.0), 0.1))
TO_THE_TABLE = with_an("heads for the table", Erring((0.0, 0.0, -0.7)))
TOO_FAR = with_an("proposes positions too far away", Erring((0.0, 2.0, 0.0)))
ACROSS = with_an("proposes the other side of the arm", Erring((-1.4, 0.0, 0.0)))
CERTAIN = with_an("is certain", Erring((0.0, 0.05, 0.08), 0.0, 0.01, SURE_BELOW_M))


NO_NUMBER = Precondition(
    "with an avoider that answers NaN",
    lambda s: s.with_avoider(lambda avoider: FaultyAvoider(avoider, lambda *_: Proposal(np.full(3, np.nan)))),
)


@dataclass(frozen=True, eq=False, kw_only=True)
class FaultyGate(Gate):
    """A gate whose rulings come from the function ``rules``, which may call the sound rule."""

    rules: Callable[[Rule, Answer, Query], GateDecision]

    def rule_on(self, proposed: Answer, query: Query) -> GateDecision:
        """Return the faulty ruling on ``proposed``."""
        return self.rules(super().rule_on, proposed, query)


@dataclass(frozen=True, eq=False, kw_only=True)
class BlindGate(Gate):
    """A gate that ignores the checks in ``to``."""

    to: Check

    def check(self, position_in_base_m: Vector, query: Query) -> Check:
        """Return the failed checks, without the checks that the gate ignores."""
        return super().check(position_in_base_m, query) & ~self.to


class LateRefusal(ControllerWrapper):
    """A controller that reacts to a refusal with a delay of some cycles.

    During the delay, it moves towards the refused pose.
    """

    def __init__(self, pilot: AvoidingServo, cycles: float) -> None:
        super().__init__(pilot)
        self._cycles = int(cycles)
        self._left = 0
        self._chosen: Vector = np.full(3, np.nan)

    def step(self, observation: NDArray[np.void]) -> NDArray[np.void]:
        """Return the controller's command, but delay the change of target that follows a refusal."""
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
            # The arm may have stopped meanwhile, and then the late target must not start it again.
            if self._left == 0 and state["mode"] == Mode.REPULSING:
                state["target_in_base_m"] = self._chosen
        return command


def ruled(rules: Callable[[float, Rule, Answer, Query], GateDecision]) -> Seeds:
    """Seed a fault that changes each ruling of the gate."""
    return lambda system, magnitude: system.with_gate(FaultyGate, rules=partial(rules, magnitude))


def _taking(ruling: GateDecision, outcome: DecisionOutcome) -> GateDecision:
    """Return a copy of ``ruling`` with the given ``outcome`` and with the position that belongs to it."""
    answers = {DecisionOutcome.PROPOSED: ruling.proposed, DecisionOutcome.OPPOSITE: ruling.opposite}
    chosen = answers.get(outcome, NAN_PROPOSAL).position_in_base_m
    return replace(ruling, outcome=outcome, chosen_position_in_base_m=chosen)


@of_gate("threshold ignored", "the arm goes where the network only guesses", IN_DOUBT)
@seeded(ruled, (np.inf, 4.0, 2.0, 1.6), "times the threshold")
def _lax(factor: float, rule: Rule, proposed: Answer, query: Query) -> GateDecision:
    """Multiply the gate's threshold of the spread by ``factor``, but report the true threshold."""
    true_m = proposed.spread_threshold_m
    lax = replace(proposed, spread_threshold_m=factor * true_m)
    return replace(rule(lax, query), spread_threshold_m=true_m)


@of_gate(
    "off by some cycles", "the refusal comes late: meanwhile the arm heads for the refused position", IN_DOUBT
)
@seeded(anywhere, (40.0, 20.0, 10.0, 5.0, 3.0), "cycles")
def _late(system: ChangedSystem, cycles: float) -> ChangedSystem:
    return system.with_pilot(lambda pilot: LateRefusal(pilot, cycles))


@of_gate("wrong pose handed over", "the gate checks one position, and the arm goes to another")
@seeded(ruled, (np.pi, np.pi / 2, np.pi / 4, np.pi / 9), "deg", 180.0 / np.pi)
def _wrong_pose(angle_rad: float, rule: Rule, proposed: Answer, query: Query) -> GateDecision:
    """Rotate the chosen position about the TCP, and report the rotated position in the ruling."""
    ruling = rule(proposed, query)
    tcp = query.tcp_position_in_base_m
    turned_m = tcp + turned(ruling.chosen_position_in_base_m - tcp, angle_rad)
    return replace(ruling, chosen_position_in_base_m=turned_m)


@of_gate("checks the end and not the way", "the arm stops half-way, or bumps into itself", ACROSS)
@seeded(anywhere)
def _blind_to_the_way(system: ChangedSystem, _: float) -> ChangedSystem:
    checks = Check.PATH_UNREACHABLE | Check.NEAR_REACH_LIMIT | Check.ROBOT_ITSELF
    return system.with_gate(BlindGate, to=checks)


@of_gate("reach not checked", "the arm is stretched to its limits and stops before the hand", TOO_FAR)
@seeded(anywhere)
def _blind_to_reach(system: ChangedSystem, _: float) -> ChangedSystem:
    reach = Check.UNREACHABLE | Check.PATH_UNREACHABLE | Check.NEAR_REACH_LIMIT
    return system.with_gate(BlindGate, to=reach)


@of_gate("table not checked", "the arm crushes the held part against the table", TO_THE_TABLE)
@seeded(anywhere)
def _blind_to_the_table(system: ChangedSystem, _: float) -> ChangedSystem:
    table = Check.TABLE | Check.UNREACHABLE | Check.PATH_UNREACHABLE | Check.ROBOT_ITSELF
    return system.with_gate(BlindGate, to=table)


@of_gate("direction not checked", "the arm goes to the hand that it gives way to", TO_THE_HAND)
@seeded(anywhere)
def _blind_to_direction(system: ChangedSystem, _: float) -> ChangedSystem:
    return system.with_gate(BlindGate, to=Check.TOWARDS_A_HAND)


@of_gate("region not checked", "the arm goes to answers outside the proven region")
@seeded(anywhere)
def _blind_to_its_region(system: ChangedSystem, _: float) -> ChangedSystem:
    return system.with_gate(more=None)


@of_gate("minds one hand only", "the arm gives way to one hand and goes to a second hand")
@seeded(ruled)
def _one_hand_only(_: float, rule: Rule, proposed: Answer, query: Query) -> GateDecision:
    """Make the ruling as if the nearest hand were the only hand."""
    return rule(proposed, replace(query, hands_in_base_m=query.hand_position_in_base_m[None]))


@of_gate("passes NaN", "no number becomes a position, and then a speed", NO_NUMBER)
@seeded(ruled)
def _passes_nan(_: float, rule: Rule, proposed: Answer, query: Query) -> GateDecision:
    """Accept a proposal of NaN, as if all checks were comparisons, which are false for NaN."""
    ruling = rule(proposed, query)
    return _taking(ruling, DecisionOutcome.PROPOSED) if ruling.proposed_failed & Check.NOT_FINITE else ruling


@of_gate("lets no proposal pass", "the system in use does not use the tested avoider", CERTAIN)
@seeded(ruled)
def _lets_none_pass(_: float, rule: Rule, proposed: Answer, query: Query) -> GateDecision:
    """Replace each usable proposal by the opposite pose, provided that this pose is usable too."""
    ruling = rule(proposed, query)
    usable = ruling.outcome is DecisionOutcome.PROPOSED and not ruling.opposite_failed
    return _taking(ruling, DecisionOutcome.OPPOSITE) if usable else ruling


@of_gate("stops where it could fall back", "an arm that stands still before a hand that comes", IN_DOUBT)
@seeded(ruled)
def _stops(_: float, rule: Rule, proposed: Answer, query: Query) -> GateDecision:
    ruling = rule(proposed, query)
    return _taking(ruling, DecisionOutcome.STOP) if ruling.outcome is DecisionOutcome.OPPOSITE else ruling


@of_gate("never stops", "the arm heads for where it cannot go")
@seeded(ruled)
def _never_stops(_: float, rule: Rule, proposed: Answer, query: Query) -> GateDecision:
    ruling = rule(proposed, query)
    return _taking(ruling, DecisionOutcome.OPPOSITE) if ruling.outcome is DecisionOutcome.STOP else ruling


@of_gate("fallback towards the hand", "doubt ends in the worst of all places", IN_DOUBT)
@seeded(anywhere, (0.2, 0.1, 0.03), "mm", 1e3)
def _to_the_hand(system: ChangedSystem, way_m: float) -> ChangedSystem:
    fallback = Erring((0.0, 0.0, 0.0), way_m)
    return system.with_gate(BlindGate, to=Check.TOWARDS_A_HAND, fallback=fallback)


GATE_FAULTS = faults_in(globals())
