"""Check that the arm acts only on answers to questions within the gate's region, which a proof covers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from safety_harness.claims.properties.base import Evaluation, Unit, judged
from safety_harness.claims.properties.entry import CatalogueEntry
from safety_harness.claims.properties.measured import reads, unexercised
from safety_harness.claims.properties.proposals import PROPOSAL, as_told, proposals
from safety_harness.trace.records import DecisionOutcome
from safety_harness.trace.trace import Trace


@dataclass(frozen=True, kw_only=True)
class ActedWithinRegion:
    """The claim that the arm acts on an answer only if its question is within the gate's region.

    The margin is the least depth of the question's hand and TCP inside their boxes, over all axes.
    """

    unit: Unit = Unit.LENGTH
    sentence: str = "acts only on answers within the gate's region"

    @reads(also=(*PROPOSAL, "decision.outcome"), ends=lambda prop, trace, margin: as_told(trace, margin))
    def evaluate(self, trace: Trace) -> Evaluation:
        """Judge each proposal that the arm used."""
        region = None if trace.scenario.gate is None else trace.scenario.gate.questions_within
        if region is None:
            return unexercised(self, "the gate has no region; its key questions within exercises it")
        used = proposals(trace)
        used = used[used["outcome"] == DecisionOutcome.PROPOSED]
        if not len(used):
            return unexercised(
                self, "answers acted on = 0; a usable one to a question within the region exercises it"
            )
        depths_m = [
            region.depth_m(question["hand_position_in_base_m"], question["tcp_position_in_base_m"])
            for question in used
        ]
        at = int(np.argmin(depths_m))  # the first NaN, if there is one
        reason = "how far within the region a question was" + (
            f", least of {len(used)}" if len(used) > 1 else ""
        )
        return judged(self, trace, depths_m[at], float(used["time_s"][at]), reason, len(used))


WITHIN_REGION = CatalogueEntry(
    prop=ActedWithinRegion(),
    rationale=(
        "a proof about the answers in a region is worthless in the control loop if the arm "
        "also acts on other answers"
    ),
    source="the project's own: the run-time check of a proven region",
    margin=(
        "the least distance along any axis between a query's hand or TCP and the surface of the box for it"
    ),
    parameters="the scenario's `gate: {questions within: ...}`",
    exercised="the gate has a region, and the arm acted on an answer",
    scenario="proven-region",
    broken_by="a gate that does not check whether a query is within the region",
)
