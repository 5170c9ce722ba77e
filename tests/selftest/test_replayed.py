"""What is shown in 3-D of a self-test is what was caught."""

from __future__ import annotations

from small import shipped, trials

from safety_harness.extensions.selftest.catalogue import EVERY
from safety_harness.extensions.selftest.outcome import outcome_of
from safety_harness.extensions.selftest.replayed import caught_runs
from safety_harness.scenario.model import Verdict


def test_a_caught_fault_is_run_again_and_violates_what_it_violated() -> None:
    fault = next(one for one in EVERY if one.name == "overspeed")
    one = outcome_of(fault, [trials("network-certain").rung(fault, fault.ladder.values[0])])
    assert one.alarm is not None
    ((told, run),) = caught_runs([one, one], (shipped("network-certain"),))
    assert told is one
    assert [claim.sentence for claim in run.trace.scenario.claims] == [one.alarm.claim]
    assert run.evaluations[0].verdict is Verdict.VIOLATED
    assert run.evaluations[0].margin_text() == one.alarm.margin
    assert caught_runs([one], (shipped("network-certain"),), most=0) == []
