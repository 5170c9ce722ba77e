"""A gate with a region uses no answer to a question outside, and the claim sees it if one does."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from safety_harness import admit, read_scenario
from safety_harness.admission.checks import refuse_gate
from safety_harness.admission.trial import judge, run_kinematic
from safety_harness.base.exceptions import InadmissibleError
from safety_harness.claims.properties.within_region import ActedWithinRegion
from safety_harness.scenario.gate import AskedRegion, GateRule, PositionBox
from safety_harness.scenario.model import Scenario, Verdict
from safety_harness.scenario.read import parse_scenario
from safety_harness.scenario.write import write_scenario
from safety_harness.trace.records import Check, DecisionOutcome
from safety_harness.trace.trace import Trace

BOX = PositionBox(low_m=(0.0, 0.0, 0.0), high_m=(1.0, 1.0, 1.0))
SHIPPED = Path(__file__).parents[3] / "scenarios" / "proven-region.yaml"


@pytest.fixture(scope="module")
def trace() -> Trace:
    return run_kinematic(admit(read_scenario(SHIPPED)))


def test_depth_is_by_axis_and_negative_outside() -> None:
    region = AskedRegion(hand=BOX, tcp=BOX)
    inside = np.array([0.5, 0.25, 0.9])
    assert region.depth_m(inside, inside) == pytest.approx(0.1)
    assert region.depth_m(inside, np.array([0.5, 1.0, 0.5])) == 0.0
    assert region.depth_m(np.array([0.5, 0.5, -0.2]), inside) == pytest.approx(-0.2)
    assert not region.depth_m(np.array([np.nan, 0.5, 0.5]), inside) >= 0.0


def test_a_question_outside_falls_back_and_is_recorded(trace: Trace) -> None:
    used = trace.decisions["outcome"] == DecisionOutcome.PROPOSED
    outside = (trace.decisions["proposed_failed"] & Check.OUTSIDE_REGION) != 0
    assert used.any()
    assert (trace.decisions["proposed_failed"] == Check.OUTSIDE_REGION).any()
    assert not (used & outside).any()
    assert not (trace.decisions["opposite_failed"] & Check.OUTSIDE_REGION).any()
    assert judge(trace)[0].verdict is Verdict.HOLDS


def test_without_the_rule_another_answer_is_used_and_the_claim_is_violated(trace: Trace) -> None:
    found = run_kinematic(admit(replace(trace.scenario, gate=None)))
    judged = ActedWithinRegion().evaluate(replace(found, scenario=trace.scenario))
    assert judged.verdict is Verdict.VIOLATED
    assert ActedWithinRegion().evaluate(found).verdict is Verdict.INCONCLUSIVE


def test_it_is_read_and_written_and_refused_where_it_asks_nothing(trace: Trace) -> None:
    scenario: Scenario = trace.scenario
    assert parse_scenario(write_scenario(scenario)).gate == scenario.gate
    turned = AskedRegion(hand=BOX, tcp=PositionBox(low_m=BOX.high_m, high_m=BOX.low_m))
    for gate, words in (
        (GateRule(), "none of them"),
        (GateRule(questions_within=turned), "from is below to"),
    ):
        with pytest.raises(InadmissibleError, match=words):
            refuse_gate(replace(scenario, gate=gate))
