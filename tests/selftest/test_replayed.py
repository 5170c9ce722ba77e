"""What is shown in 3-D of a self-test is what was caught."""

from __future__ import annotations

from small import shipped, trials

from safety_harness.scenario.model import Verdict
from safety_harness.selftest.catalogue import EVERY
from safety_harness.selftest.outcome import FaultOutcome
from safety_harness.selftest.replayed import caught_runs
from safety_harness.selftest.session import try_out

EPISODES = (shipped("stops-in-time"), shipped("hand-visits-and-leaves"))


def test_a_caught_fault_is_run_again_and_violates_what_it_violated() -> None:
    one = caught("speed limit")
    ((told, run),) = caught_runs([one, one], EPISODES)
    assert told is one
    assert one.alarm is not None
    assert [claim.sentence for claim in run.trace.scenario.claims] == [one.alarm.claim]
    assert run.evaluations[0].verdict is Verdict.VIOLATED
    assert run.evaluations[0].margin_text() == one.alarm.margin
    assert caught_runs([one], EPISODES, most=0) == []


def caught(words: str) -> FaultOutcome:
    fault = next(one for one in EVERY if words in one.name and not one.harmless)
    return try_out(trials("stops-in-time", "hand-visits-and-leaves"), fault)
