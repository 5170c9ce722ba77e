"""Why a scenario violates, as far as other runs tell: what takes the violation away, what was decided."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from safety_harness.admission.admit import admit
from safety_harness.admission.avoiders import folder_of
from safety_harness.admission.claims import property_of
from safety_harness.exceptions import InputError
from safety_harness.scenario.model import Scenario
from safety_harness.search.confirm import Complaint, failure_of
from safety_harness.search.coverage import cell_of
from safety_harness.search.simpler import simpler
from safety_harness.search.trials import ScenarioRunner
from safety_harness.space.regions import Seen, seen_by
from safety_harness.trace.records import Check, DecisionOutcome
from safety_harness.trace.trace import Trace

_MOST_REMOVED = 12  # ingredients that are taken away, one at a time


@dataclass(frozen=True)
class Ingredient:
    """What becomes of the complaint without one thing; ``matters`` if it is gone then."""

    step: str
    outcome: str
    matters: bool

    def __str__(self) -> str:
        return f"{self.step}: {self.outcome}"


def ingredients(scenario: Scenario, complaint: Complaint, world: ScenarioRunner) -> list[Ingredient]:
    """What becomes of the complaint when one thing is removed or neutralised."""
    found = []
    for step, other in list(simpler(scenario))[:_MOST_REMOVED]:
        try:
            run = world([admit(other)])[0]
            found.append(Ingredient(step, _outcome(complaint, run), not complaint.is_in(run)))
        except InputError as error:
            found.append(Ingredient(step, f"cannot be tried, expected {error.expected}", False))
    return found


def _outcome(complaint: Complaint, run: Trace | Exception) -> str:
    if complaint.claim is None or isinstance(run, Exception):
        return failure_of(run) or "nothing goes wrong"
    evaluation = property_of(complaint.claim, run.scenario).evaluate(run)
    margin = "" if evaluation.margin is None else f", {evaluation.margin_text()}"
    return evaluation.verdict.value + margin


def seen_of(scenario: Scenario) -> Seen:
    """What the scenario's avoider was trained on."""
    return seen_by(scenario.avoider, folder=folder_of(scenario), settings=scenario.settings)


def circumstances(trace: Trace) -> list[str]:
    """Where the run lies relative to the seen space, and what was decided in it."""
    seen = seen_of(trace.scenario)
    cell = cell_of(trace, seen)
    lines = [] if cell is None else [f"the run: {cell} (seen by {seen.source})"]
    for k, decision in enumerate(trace.decisions):
        spread_m = decision["proposed_spread_m"]
        words = [f"decision {k + 1} at {decision['time_s']:.3f} s"]
        words.append(DecisionOutcome(int(decision["outcome"])).name.lower())
        if decision["fault"]:
            words.append(f"the avoider: {decision['fault']}")
        elif np.any(spread_m > 0.0):
            words.append(f"largest spread {spread_m.max() * 1e3:.3g} mm")
            if np.isfinite(decision["spread_threshold_m"]):
                words[-1] += f" (threshold {decision['spread_threshold_m'] * 1e3:.3g} mm)"
        failed = Check(int(decision["proposed_failed"]))
        if failed:
            names = (
                str(check.name).lower().replace("_", " ") for check in Check if check and check in failed
            )
            words.append("the proposal failed: " + ", ".join(names))
        inside = seen.hand.contains(decision["hand_position_in_base_m"])
        words.append("hand seen in training" if inside else "hand where none was in training")
        lines.append("; ".join(words))
    return lines
