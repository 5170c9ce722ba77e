"""Was it the shield, or would the rest have kept the hands from a moving arm without it?  The run once more.

Three kinematic runs: as it is, without its shield, and with the shield alone, which is without an avoider.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from safety_harness.admission.admit import Admitted
from safety_harness.claims.properties.base import Evaluation
from safety_harness.claims.properties.touching import NO_MOVING_PART_TOUCHES
from safety_harness.search.attribution.attribute import Outcome, ReplaysInWorld
from safety_harness.search.attribution.ingredients import Altered, setting
from safety_harness.trace.trace import Trace


@dataclass(frozen=True)
class ShieldAttribution:
    """What became of *no moving part touches a hand*, and the run as it is; None: it had none of these."""

    trace: Trace
    shielded: Evaluation
    plain: Evaluation
    alone: Evaluation | None

    @property
    def words(self) -> str:
        """Who was decisive."""
        found = (self.shielded, self.plain, self.shielded if self.alone is None else self.alone)
        untold = [one for one in found if Outcome.of(one) is Outcome.UNTOLD]
        if untold:
            return f"who was decisive is not known: {untold[0].reason}"
        kept, plain, alone = (Outcome.of(one) is not Outcome.VIOLATED for one in found)
        if not kept:
            return f"not even the shield kept hands from what moves: {self.shielded.margin_text()}"
        if not plain:
            return f"the shield was decisive: {self.plain.margin_text()} without it"
        alike = f"{self.plain.margin_text()} without it"
        if self.alone is None:
            return f"the shield was not needed: {alike}"
        only = "would have sufficed" if alone else "would not have"
        return f"the avoider was decisive: {alike}; the shield alone {only}: {self.alone.margin_text()}"


def attribute_shield(admitted: Admitted) -> ShieldAttribution | None:
    """Of a scenario with a shield; None for one without.  What a run raises is raised."""
    if admitted.scenario.shield is None:
        return None
    system = Altered.of(admitted)
    systems = [system, replace(system, scenario=replace(system.scenario, shield=None))]
    if admitted.driver is None:
        systems.append(setting("avoidance", lambda _: {"critical_distance_m": 0.0})(system))
    traces = ReplaysInWorld()(systems)
    for one in traces:
        if isinstance(one, Exception):
            raise one
    found = [one for one in traces if isinstance(one, Trace)]
    said = [NO_MOVING_PART_TOUCHES.prop.evaluate(one) for one in found]
    return ShieldAttribution(found[0], said[0], said[1], said[2] if len(said) > 2 else None)
