"""What holds for every property of the catalogue: an empty trace and one cut short never hold."""

from __future__ import annotations

from dataclasses import replace

import pytest
from test_catalogue import IDS, claim, shipped

from safety_harness.admission.claims import property_of
from safety_harness.claims.properties.catalogue import CATALOGUE
from safety_harness.claims.properties.entry import CatalogueEntry
from safety_harness.scenario.model import Verdict
from safety_harness.trace.trace import Trace


def truncated(trace: Trace, ticks: int) -> Trace:
    kept = trace.decisions["tick"] < ticks
    return replace(
        trace,
        ticks=trace.ticks[:ticks].copy(),
        decisions=trace.decisions[kept].copy(),
        decision_latency_s=trace.decision_latency_s[kept].copy(),
        ended="interrupted by the user",
    )


@pytest.mark.parametrize("entry", CATALOGUE, ids=IDS)
def test_an_empty_trace_is_no_evidence(entry: CatalogueEntry) -> None:
    trace = shipped(entry.scenario)
    evaluation = property_of(claim(entry), trace.scenario).evaluate(truncated(trace, 0))
    assert evaluation.verdict is Verdict.INCONCLUSIVE


@pytest.mark.parametrize("entry", CATALOGUE, ids=IDS)
def test_a_trace_that_was_cut_short_never_holds(entry: CatalogueEntry) -> None:
    trace = shipped(entry.scenario)
    prop = property_of(claim(entry), trace.scenario)
    for ticks in (1, 2, 100, len(trace.ticks) // 2, len(trace.ticks) - 1):
        evaluation = prop.evaluate(truncated(trace, ticks))
        assert evaluation.verdict is not Verdict.HOLDS, (ticks, evaluation)
        for part in evaluation.parts:
            assert part.verdict is not Verdict.HOLDS, (ticks, part)
