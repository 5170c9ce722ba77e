from __future__ import annotations

from dataclasses import replace

import factory
import pytest

from safety_harness.claims.properties.base import Unit
from safety_harness.report.evidence import JudgedRun
from safety_harness.scenario.model import Verdict


def test_a_run_needs_one_evaluation_for_each_claim() -> None:
    run = factory.holds_run()
    with pytest.raises(ValueError, match="2 claims, got 1"):
        replace(run, evaluations=run.evaluations[:1])


def test_a_foreseen_violation_is_as_expected_and_an_unforeseen_one_is_not() -> None:
    run = factory.violated_run()
    assert run.as_expected == (False, True, True)
    assert not run.all_as_expected
    assert run.count(Verdict.VIOLATED) == 2
    assert factory.holds_run().all_as_expected


def test_an_inconclusive_claim_is_not_the_one_that_was_expected_to_hold() -> None:
    assert factory.truncated_run().as_expected == (False,)
    assert factory.no_hands_run().as_expected == (True,)


def test_the_worst_claim_is_a_violated_length_with_the_smallest_margin() -> None:
    source = factory.scenario(claims=tuple(factory.claim(str(i)) for i in range(4)))
    trace = factory.trace(source, ticks=10)
    violated = Verdict.VIOLATED
    evaluations = (
        factory.evaluation("holds by little", margin=0.0001),
        factory.evaluation("speed", violated, margin=-9.0, unit=Unit.SPEED),
        factory.evaluation("length", violated, margin=-0.01),
        factory.evaluation("no moment", violated, margin=-5.0, worst_time_s=None),
    )
    run = JudgedRun(trace, evaluations, "again")
    assert run.shown_claim() == 2
    assert replace(run, evaluations=(evaluations[3],) * 4).shown_claim() is None
    never = factory.evaluation("nan", violated, worst_time_s=float("nan"))
    assert replace(run, evaluations=(never, *evaluations[1:])).shown_claim() == 2


def test_below_a_claims_heading_only_its_own_worst_moment_is_shown() -> None:
    run = factory.violated_run()
    assert [run.under_claim(one.sentence).shown_claim() for one in run.trace.scenario.claims] == [0, 1, 2]
    assert run.under_claim("the avoider raised").shown_claim() == run.shown_claim() == 0
    unmoved = replace(run.evaluations[1], worst_time_s=None)
    silent = replace(run, evaluations=(run.evaluations[0], unmoved, run.evaluations[2]))
    assert silent.under_claim(unmoved.sentence).shown_claim() is None
