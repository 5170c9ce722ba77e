"""Test the attribution with seeded faults, whose causes are known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from safety_harness.admission.admit import Admitted
from safety_harness.extensions.attribution.attribute import Attribution, attribute
from safety_harness.extensions.attribution.ingredients import Altered, Ingredient
from safety_harness.extensions.selftest.fault import FaultyPart, SeededFault
from safety_harness.extensions.selftest.system import ChangedSystem
from safety_harness.scenario.model import Claim
from safety_harness.trace.trace import Trace

INGREDIENTS = {
    FaultyPart.AVOIDER: Ingredient.AVOIDER,
    FaultyPart.GATE: Ingredient.GATE,
    FaultyPart.PERCEPTION: Ingredient.PERCEPTION,
    FaultyPart.SERVOING: Ingredient.SERVOING,
    FaultyPart.MOTION: Ingredient.DRIVES,
    FaultyPart.TIMING: Ingredient.DEADLINE,
}


@dataclass(frozen=True, eq=False)
class SeededRunner:
    """A runner of altered systems that contain the fault.

    If attribution has replaced the faulty ingredient of a system by a correct one, this system runs without
    the fault.
    """

    fault: SeededFault
    magnitude: float
    around: ChangedSystem  # with the fault's circumstance, without the fault

    def __call__(self, systems: Sequence[Altered]) -> list[Trace | Exception]:
        """Run the ``systems``, and return the runs in the same order.

        If a system fails, the result contains the exception instead of a run.
        """
        return [self._run(system) for system in systems]

    def _run(self, altered: Altered) -> Trace | Exception:
        changed = {change.ingredient for change in altered.changes}
        system = replace(self.around, admitted=altered)
        if Ingredient.GATE in changed:
            system = replace(system, edits=())
        if INGREDIENTS[self.fault.part] not in changed:
            system = self.fault.seed_into(system, self.magnitude)
        try:
            return system.run()
        except Exception as error:
            return error


def attribute_seeded(
    fault: SeededFault, magnitude: float, admitted: Admitted, claims: Sequence[Claim]
) -> tuple[Attribution, ...]:
    """Return the causes to which attribution traces the violations of ``claims`` by a seeded fault.

    Attribution tries a correct replacement for every part that can have a fault. It thus gets no hint about
    the part that is actually faulty.
    """
    around = fault.circumstance.bring_about(ChangedSystem(admitted))
    run = SeededRunner(fault, magnitude, around)
    return attribute(around.admitted, claims, run=run, faulty=INGREDIENTS.values())
