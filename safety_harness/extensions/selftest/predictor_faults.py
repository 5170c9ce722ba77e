"""Define faults of the user's predictor or of our predictor: its sets are too small, late or misplaced.

The faults change no code of the predictor, and are tried where the gate uses the predictor's sets. A scenario
without a predictor gets the Kalman filter as its predictor.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from safety_harness.admission.admit import Admitted
from safety_harness.admission.driving import kalman_filter
from safety_harness.base.settings import GateKind
from safety_harness.cell.controller.controller import AvoidingServo
from safety_harness.cell.controller.predicting import KALMAN_FILTER
from safety_harness.extensions.selftest.fault import (
    Precondition,
    Seeds,
    faults_in,
    of_perception,
    of_timing,
    seeded,
)
from safety_harness.extensions.selftest.system import ChangedSystem
from safety_harness.scenario.gate import GateRule
from safety_harness.scenario.robots import YesNo
from safety_harness.seams.contract import HandSet, Predicted, Seen, UserController

Hands = tuple[HandSet, ...]


class PredictorWrapper:
    """A wrapper of a predictor that applies ``change`` to its hands and leaves everything else unchanged."""

    def __init__(self, user: UserController, change: Callable[[Hands], Hands]) -> None:
        self._user, self._change = user, change

    def __getattr__(self, name: str) -> Any:
        return getattr(self._user, name)

    def act(self, seen: Seen) -> Any:
        """Return the predictor's answer to ``seen``, after the change."""
        answer: Any = self._user.act(seen)
        return Predicted(hands=self._change(tuple(answer.hands)))


def _in_sets(system: ChangedSystem) -> ChangedSystem:
    """Return the system with a predictor whose sets the gate uses.

    A gate that checks only reach uses no sets. A system that has a user's controller is returned unchanged.
    """
    admitted, scenario = system.admitted, system.admitted.scenario
    if admitted.driver is not None:
        return system
    rule = scenario.gate
    if scenario.settings.avoidance.gate is GateKind.FULL:
        rule = replace(rule or GateRule(), hands_within=None, hands_in_sets=YesNo.YES)
    changed = replace(scenario, predictor=scenario.predictor or KALMAN_FILTER, gate=rule)
    predictor = admitted.predictor or kalman_filter()
    return replace(system, admitted=replace(admitted, scenario=changed, predictor=predictor))


IN_SETS = Precondition("where the gate takes the predictor's sets", _in_sets)


def predicted(make: Callable[[float, Admitted], Callable[[Hands], Hands]]) -> Seeds:
    """Seed a fault that changes the predictor's hands at each tick.

    ``make`` creates a new change for each run; the change may remember earlier hands.
    """

    def seed(system: ChangedSystem, magnitude: float) -> ChangedSystem:
        def edit(pilot: AvoidingServo) -> None:
            calls = pilot.predictor
            assert calls is not None
            calls.user = PredictorWrapper(calls.user, make(magnitude, system.admitted))

        return replace(system, edits=(*system.edits, edit))

    return seed


@of_perception("predicted sets too small", "a hand is where the gate does not expect it", IN_SETS)
@seeded(predicted, (0.01, 0.1, 0.2, 0.5), "times")
def _too_small(factor: float, admitted: Admitted) -> Callable[[Hands], Hands]:
    factors = {"radius_m": factor, "half_widths_m": factor, "ellipsoid_m2": factor * factor}

    def change(hand: HandSet) -> HandSet:
        given = {name: getattr(hand, name) for name in factors}
        smaller = {name: np.multiply(factors[name], x) for name, x in given.items() if x is not None}
        return replace(hand, **smaller)

    return lambda hands: tuple(map(change, hands))


@of_perception("predicted sets elsewhere", "the gate leads the arm to where the hand will be", IN_SETS)
@seeded(predicted, (1.0, 0.3, 0.1, 0.05), "mm", 1e3)
def _elsewhere(by_m: float, admitted: Admitted) -> Callable[[Hands], Hands]:
    """Move each set and its centre to the right, along the base's y axis."""
    off_m = np.array([0.0, -by_m, 0.0])

    def change(hand: HandSet) -> HandSet:
        return replace(hand, position_in_base_m=np.add(hand.position_in_base_m, off_m))

    return lambda hands: tuple(map(change, hands))


@of_timing("predicted sets late", "they hold the hand's earlier places", IN_SETS)
@seeded(predicted, (63.0, 25.0, 13.0, 5.0), "ticks")
def _late(ticks: float, admitted: Admitted) -> Callable[[Hands], Hands]:
    waiting: deque[Hands] = deque(maxlen=int(ticks) + 1)

    def change(hands: Hands) -> Hands:
        waiting.append(hands)
        return waiting[0]

    return change


PREDICTOR_FAULTS = faults_in(globals())
