"""Find the parts of scenarios that no run exercised: moves that never began, and inactive faults.

For a space, also find the varied values that affect only parts that no run exercised. A verdict does not
cover these parts and values. A fault of a hand sensor is exercised if it is active while a hand is within
twice NEAR_M of the TCP.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import islice
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from safety_harness.base.compiled import compiled
from safety_harness.base.exceptions import InputError
from safety_harness.cell.simulation.hand_motion import HandRecords, MoveRecords, advance_hands
from safety_harness.cell.simulation.hand_programs import hands_at_start
from safety_harness.claims.signals.occasions import NEAR_M
from safety_harness.claims.signals.true_motion import nearest_hand_m
from safety_harness.scenario.faults import OWN_KEYS, AvoiderFault, FalseHand, HandSensorFault
from safety_harness.scenario.model import MovingHand, Scenario
from safety_harness.scenario.moves import MOVES
from safety_harness.scenario.write import write_scenario
from safety_harness.trace.trace import Trace

if TYPE_CHECKING:
    from safety_harness.space.space import ScenarioSpace

# A choice for a hypothetical run: a hand at 2 m/s moves by 100 mm in a step.
STEP_S = 0.05
UNTRIED = "untried in"
LOOKED_AT = 60  # draws of a space, for those that use a value
_NAMES = {table.kind: table.name for table in MOVES}


@dataclass(eq=False)
class TriedParts:
    """A record of the moves and faults of each scenario.

    It states which of them at least one run exercised. Its keys are the titles of the scenarios.
    """

    runs: dict[str, int] = field(default_factory=dict)
    parts: dict[str, dict[str, bool]] = field(default_factory=dict)

    @classmethod
    def from_traces(cls, *traces: Trace) -> TriedParts:
        """Return the record of which parts the runs ``traces`` exercised."""
        tried = cls()
        for trace in traces:
            tried.add(trace)
        return tried

    def add(self, trace: Trace) -> None:
        """Add a run, unless it was cut short."""
        scenario, parts = trace.scenario, dict(_parts(trace.scenario))
        if not (parts and trace.complete):
            return
        is_near, tcp_m = nearest_hand_m(trace) < 2.0 * NEAR_M, trace.ticks["transform_tcp_to_base"][:, :3, 3]
        acted = [trace.ticks["faults"] >> k & 1 != 0 for k in range(len(scenario.faults))]
        of_hands = [isinstance(f, HandSensorFault) and not isinstance(f, FalseHand) for f in scenario.faults]
        faults = [
            bool((is_near & at if of_hand else at).any()) for of_hand, at in zip(of_hands, acted, strict=True)
        ]
        begun, _ = moves_begun(scenario, tcp_m, scenario.settings.clock.control_period_s)
        self.join(scenario.title, dict(zip(parts, [*begun, *faults], strict=True)))

    def suppose(self, scenario: Scenario, tcp_in_base_m: NDArray[np.float64]) -> None:
        """Add a hypothetical run of ``scenario``, in which the TCP stays at ``tcp_in_base_m`` (3,)."""
        times_s = np.arange(0.0, scenario.duration_s + STEP_S, STEP_S)
        begun, nearest_m = moves_begun(scenario, np.tile(tcp_in_base_m, (len(times_s), 1)), STEP_S)
        near_s = times_s[nearest_m < 2.0 * NEAR_M]
        invented = any(isinstance(fault, FalseHand) for fault in scenario.faults)
        faults = [
            invented
            or not isinstance(fault, HandSensorFault | AvoiderFault)
            or bool(((near_s >= fault.from_s) & (near_s < fault.end_s)).any())
            for fault in scenario.faults
        ]
        self.join(scenario.title, dict(zip(dict(_parts(scenario)), [*begun, *faults], strict=True)))

    def join(self, title: str, parts: dict[str, bool], runs: int = 1) -> None:
        """Add ``runs`` runs of the scenario ``title``.

        ``parts`` states for each part whether these runs exercised it.
        """
        known = self.parts.setdefault(title, {})
        known |= {part: tried or known.get(part, False) for part, tried in parts.items()}
        self.runs[title] = self.runs.get(title, 0) + runs

    def lines(self, *spaces: ScenarioSpace, subject: str = "runs") -> list[str]:
        """Return one line for each title with parts that no run exercised; the line lists these parts.

        The line also lists the values of ``spaces`` that change only these parts. ``subject`` is the noun
        that the text uses for the runs.
        """
        titled, lines = {space.title: space for space in spaces}, []
        for title, parts in self.parts.items():
            idle = [part for part, tried in parts.items() if not tried]
            values = untried_values(titled[title], idle) if idle and title in titled else []
            idle += [f"{name}, which varies" for name in values]
            if idle:
                noun = subject if self.runs[title] > 1 else subject.replace("runs", "run", 1)
                runs = f"{self.runs[title]} {noun}"
                lines.append(f"{UNTRIED} {runs} of {title!r}, and nothing is known of: {'; '.join(idle)}")
        return lines


def _parts(scenario: Scenario) -> Iterator[tuple[str, object]]:
    """Yield every move and fault, each with a name that is the same in all draws of a space."""
    for hand in scenario.hands:
        for number, move in enumerate(hand.moves if isinstance(hand, MovingHand) else (), start=1):
            yield f"move {number} of {hand.name} ({_NAMES[type(move)]})", move
    for number, fault in enumerate(scenario.faults, start=1):
        own = OWN_KEYS[type(fault)]
        yield f"fault {number} ({own.told_by} {own.name})", fault


def moves_begun(
    scenario: Scenario, tcp_in_base_m: NDArray[np.float64], period_s: float
) -> tuple[list[bool], NDArray[np.float64]]:
    """Return whether each move of each hand began.

    It is assumed that the TCP moves along ``tcp_in_base_m`` (n, 3). Successive positions of the TCP are
    ``period_s`` apart in time. The second result is the distance of the nearest hand from the TCP, shape
    (n,).
    """
    hands = hands_at_start(scenario)
    tcp_m = np.ascontiguousarray(tcp_in_base_m)
    nearest_m = _follow(hands.state, hands.moves, hands.samples, tcp_m, period_s)
    begun = []
    for state, hand in zip(hands.state, scenario.hands, strict=False):
        if not isinstance(hand, MovingHand):
            continue
        steps = hands.moves[state["first"] : state["first"] + state["count"]]
        at = int(steps["after"][0]) if hand.delay_s > 0.0 else 0
        for _ in hand.moves:
            under_way = state["current"] == at and state["elapsed_s"] > 0.0
            begun.append(bool(at < len(steps) and (state["current"] > at or under_way)))
            at = int(steps["after"][at]) if at < len(steps) else at
    return begun, nearest_m


@compiled
def _follow(
    hands: HandRecords,
    moves: MoveRecords,
    samples: NDArray[np.float64],  # (s, 7)
    tcp_in_base_m: NDArray[np.float64],  # (n, 3)
    period_s: float,
) -> NDArray[np.float64]:
    """Return the distance of the nearest hand from the TCP, shape (n,).

    This also advances ``hands`` by n - 1 periods.
    """
    nearest_m = np.full(tcp_in_base_m.shape[0], np.inf)
    for k in range(tcp_in_base_m.shape[0]):
        for hand in range(hands.shape[0]):
            squared = 0.0
            for i in range(3):
                squared += (hands[hand].position_in_base_m[i] - tcp_in_base_m[k, i]) ** 2
            if hands[hand].present:
                nearest_m[k] = min(nearest_m[k], np.sqrt(squared))
        if k + 1 < tcp_in_base_m.shape[0]:
            advance_hands(hands, moves, samples, tcp_in_base_m[k], k * period_s, period_s)
    return nearest_m


def untried_values(space: ScenarioSpace, idle: list[str]) -> list[str]:
    """Return the names of the varied values of ``space`` that affect only the parts ``idle``."""
    rows, untried = space.values_of_draws(range(LOOKED_AT), 0), []
    for parameter, used in zip(space.parameters, space.used_by(rows), strict=True):
        changed: set[str] = set()
        for row in islice(rows[used], 3):
            with suppress(InputError):  # values that do not go together
                point = space.cube_at(row[None])[0]
                point[parameter.columns] = (point[parameter.columns] + 0.5) % 1.0
                changed |= _differing(space.scenario(row), space.at(point))
        if changed and changed <= set(idle):
            untried.append(parameter.name)
    return untried


def _differing(first: Scenario, second: Scenario) -> set[str]:
    """Return the names of the moves and faults that differ between two scenarios.

    If the scenarios differ in anything else, the result also contains "".
    """
    (mine, rest), (theirs, of_other) = (_split(scenario) for scenario in (first, second))
    changed = {part for part in mine.keys() | theirs.keys() if mine.get(part) != theirs.get(part)}
    return changed if rest == of_other else {*changed, ""}


def _split(scenario: Scenario) -> tuple[dict[str, object], str]:
    """Return the moves and faults of ``scenario``, and the text of the scenario without them."""
    hands = (replace(h, moves=()) if isinstance(h, MovingHand) else h for h in scenario.hands)
    return dict(_parts(scenario)), write_scenario(replace(scenario, hands=tuple(hands), faults=()))
