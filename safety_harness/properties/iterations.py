"""Servoing gets there within so many iterations of the control loop, as the paper counts."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import floor

from safety_harness.properties.base import Evaluation, Unit
from safety_harness.properties.entry import CatalogueEntry, count
from safety_harness.properties.servoing import GainSwitchReached
from safety_harness.scenario.model import Verdict
from safety_harness.trace.trace import Trace


@dataclass(frozen=True, kw_only=True)
class GainSwitchIterations:
    """``GainSwitchReached`` with its time counted in control ticks after the last hand has left."""

    within: int
    unit: Unit = Unit.COUNT

    @property
    def sentence(self) -> str:
        """As the catalogue writes it."""
        return f"gain switch reached within {self.within} iterations"

    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge the first crossing after the hands have left."""
        period_s = trace.scenario.settings.clock.control_period_s
        # half a period more, so that no rounding of times decides; the margin is cut to whole ticks
        timed = GainSwitchReached(within_s=(self.within + 0.5) * period_s).evaluate(trace)
        found = replace(timed, sentence=self.sentence, unit=self.unit)
        if timed.margin is None:
            return found
        left = floor(timed.margin / period_s)
        if timed.verdict is Verdict.INCONCLUSIVE:
            return replace(found, margin=float(left))
        how = "not reached in" if timed.reason.startswith("not") else "reached after"
        words = f"{how} {self.within - left} iterations; {self.within} were allowed"
        return replace(found, margin=float(left), reason=words)


GAIN_SWITCH_ITERATIONS = CatalogueEntry(
    example="gain switch reached within 600 iterations",
    pattern=r"gain switch reached within (\S+) iterations",
    make=lambda match, _, place: GainSwitchIterations(within=count(match[1], place)),
    unit=Unit.COUNT,
    rationale="the same in the paper's measure, which does not depend on the control period",
    source="the paper, eq. 15 and section 5: iterations until |f - f*|^2 is below the threshold",
    margin="iterations left of those allowed, counted in control ticks from when the last hand has left",
    parameters="the iterations allowed",
    exercised="the error is above the switch after the last hand has left",
    inconclusive="a hand is near to the end, or the run ends before the iterations allowed",
    scenario="servoing-alone",
    broken_by="a controller that does nothing",
)
