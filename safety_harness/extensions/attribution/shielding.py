"""Determine whether the shield or the rest of the system kept the moving arm from touching hands.

The answer needs three runs: the unchanged run, a run without the shield, and a run with the shield but
without an avoider.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from safety_harness.admission.admit import Admitted
from safety_harness.claims.properties.base import Evaluation
from safety_harness.claims.properties.touching import NO_MOVING_PART_TOUCHES
from safety_harness.extensions.attribution.attribute import KINEMATIC_REPLAYS, Outcome, ReplaysInWorld
from safety_harness.extensions.attribution.ingredients import Altered, setting
from safety_harness.trace.trace import Trace


@dataclass(frozen=True)
class ShieldAttribution:
    """The evaluations of the claim *no moving part touches a hand* in three runs.

    ``trace`` is the unchanged run. ``alone`` is None for a scenario with a user's own controller.
    """

    trace: Trace
    shielded: Evaluation
    plain: Evaluation
    alone: Evaluation | None

    @property
    def summary(self) -> str:
        """A sentence on whether the shield or the avoider kept the moving arm from touching hands."""
        evaluations = (self.shielded, self.plain, self.shielded if self.alone is None else self.alone)
        untold = [
            evaluation for evaluation in evaluations if Outcome.from_evaluation(evaluation) is Outcome.UNTOLD
        ]
        if untold:
            return f"who was decisive is not known: {untold[0].reason}"
        kept, plain, alone = (
            Outcome.from_evaluation(evaluation) is not Outcome.VIOLATED for evaluation in evaluations
        )
        if not kept:
            return f"a moving part touched a hand even with the shield: {self.shielded.margin_text()}"
        if not plain:
            return f"the shield was decisive: {self.plain.margin_text()} without it"
        alike = f"{self.plain.margin_text()} without it"
        if self.alone is None:
            return f"the shield was not needed: {alike}"
        only = "would have sufficed" if alone else "would not have"
        return f"the avoider was decisive: {alike}; the shield alone {only}: {self.alone.margin_text()}"


def attribute_shield(
    admitted: Admitted, replays: ReplaysInWorld = KINEMATIC_REPLAYS
) -> ShieldAttribution | None:
    """Return the attribution of the ``admitted`` scenario, or None if the scenario has no shield.

    If a run fails, its exception is raised.
    """
    if admitted.scenario.shield is None:
        return None
    system = Altered.from_admitted(admitted)
    systems = [system, replace(system, scenario=replace(system.scenario, shield=None))]
    if admitted.driver is None:
        systems.append(setting("avoidance", lambda _: {"critical_distance_m": 0.0})(system))
    traces = replays(systems)
    for run in traces:
        if isinstance(run, Exception):
            raise run
    done = [run for run in traces if isinstance(run, Trace)]
    judged = [NO_MOVING_PART_TOUCHES.prop.evaluate(run) for run in done]
    return ShieldAttribution(done[0], judged[0], judged[1], judged[2] if len(judged) > 2 else None)
