"""The avoider answered: what is no answer counts, what the scenario's own faults suppress does not."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from examples import VISIT, Displaced, Raising, Slow, hand, run, scenario
from numpy.typing import NDArray

from safety_harness.cell.avoidance.avoider import Avoider, Proposal
from safety_harness.claims.properties.answered import (
    AvoiderAnswered,
    by_default,
    fault_of,
    unanswered,
    without_numbers,
)
from safety_harness.scenario.faults import AvoiderLate, AvoiderNaN, AvoiderSilent, Fault
from safety_harness.scenario.model import Claim, Verdict
from safety_harness.scenario.moves import MoveTo, Wait
from safety_harness.trace.trace import Trace

ANSWERED = AvoiderAnswered()
HERE = scenario(VISIT, duration_s=1.5)


@dataclass(frozen=True)
class Returning:
    """An avoider that returns whatever it is told to."""

    what: object
    name: str = "returning"

    def propose(
        self,
        *,
        hand_position_in_base_m: NDArray[np.float64],
        tcp_position_in_base_m: NDArray[np.float64],
        seed: int,
    ) -> Proposal:
        return self.what  # type: ignore[return-value]


@pytest.mark.parametrize(
    ("avoider", "first"),
    [
        (Raising(), "ZeroDivisionError: at ..."),
        (Returning([0.5, 0.0, 0.4]), "got list"),
        (Returning(None), "got NoneType"),
        (Returning(Proposal(np.full(3, np.nan))), "not finite"),
        (Slow(decision_time_s=0.2), "no answer within 100 ms"),
    ],
    ids=["raises", "list", "nothing", "nan", "late"],
)
def test_what_is_no_answer_violates_it_by_as_many_as_there_are(avoider: Avoider, first: str) -> None:
    trace = run(HERE, avoider=avoider)
    evaluation = ANSWERED.evaluate(trace)
    asked = len(trace.decisions)
    assert asked > 0
    assert (evaluation.verdict, evaluation.margin) == (Verdict.VIOLATED, -asked)
    assert evaluation.worst_time_s == trace.decisions["time_s"][0]
    assert evaluation.exercised == asked
    assert evaluation.reason.startswith(f"{asked} of {asked} questions without a usable answer; first: ")
    assert first in fault_of(trace)
    assert by_default(trace) == evaluation


def test_answers_hold_even_those_that_the_gate_refuses(visit: Trace) -> None:
    for trace in (
        visit,
        run(HERE, avoider=Displaced((0.0, 2.0, 0.0))),  # out of reach
        run(HERE, avoider=Displaced((0.0, 0.0, 0.08), spread_m=0.03, spread_threshold_m=0.02)),  # in doubt
    ):
        evaluation = ANSWERED.evaluate(trace)
        assert (evaluation.verdict, evaluation.margin) == (Verdict.HOLDS, 0.0)
        assert evaluation.exercised == len(trace.decisions) > 0
        assert by_default(trace) is None


def test_an_avoider_that_is_never_asked_is_no_evidence_and_no_failure() -> None:
    trace = run(scenario(duration_s=0.2), avoider=Raising())
    evaluation = ANSWERED.evaluate(trace)
    assert evaluation.verdict is Verdict.INCONCLUSIVE
    assert evaluation.reason.startswith("never exercised: there is no hand in this scenario")
    assert by_default(trace) is None


@pytest.mark.parametrize(
    "fault", [AvoiderSilent(), AvoiderNaN(), AvoiderLate(delay_s=0.3)], ids=["silent", "nan", "late"]
)
def test_what_a_fault_of_the_scenario_suppresses_is_not_the_avoiders_doing(fault: Fault) -> None:
    trace = run(replace(HERE, faults=(fault,)))
    assert (trace.decisions["fault"] != "").all()
    assert ANSWERED.evaluate(trace).verdict is Verdict.INCONCLUSIVE
    assert by_default(trace) is None


def test_an_avoider_that_raises_has_no_excuse_in_a_fault_that_only_delays_it() -> None:
    trace = run(replace(HERE, faults=(AvoiderLate(delay_s=0.05),)), avoider=Raising())
    assert unanswered(trace).all()
    assert ANSWERED.evaluate(trace).verdict is Verdict.VIOLATED


def test_the_first_answer_that_is_missing_is_the_worst_moment() -> None:
    stays = hand(MoveTo(position_in_base_m=(0.84, -0.35, 0.25), speed_mps=1.0), Wait(duration_s=9.0))
    visit = run(scenario(stays, duration_s=4.0))
    decisions = visit.decisions.copy()
    assert len(decisions) >= 2
    decisions["fault"][-1] = "it raised"
    evaluation = ANSWERED.evaluate(replace(visit, decisions=decisions))
    assert (evaluation.margin, evaluation.worst_time_s) == (-1.0, decisions["time_s"][-1])
    assert f"1 of {len(decisions)} questions" in evaluation.reason
    decisions = visit.decisions.copy()
    decisions["proposed_position_in_base_m"][-1] = np.nan
    assert ANSWERED.evaluate(replace(visit, decisions=decisions)).margin == -1.0


@pytest.mark.parametrize("expected", list(Verdict))
def test_who_expects_otherwise_is_not_told(expected: Verdict) -> None:
    claim = Claim(sentence="The avoider answered", expected=expected)
    trace = run(replace(HERE, claims=(claim,)), avoider=Raising())
    assert (by_default(trace) is None) is (expected is not Verdict.HOLDS)


@pytest.mark.parametrize(
    ("text", "without"),
    [
        ("hand too near (ct.py:40) at 0.336 s", "hand too near (ct.py:40) at ... s"),
        ("bad -1e-3 and 67", "bad ... and ..."),
        ("mine-2.py:Mine ended with exit status 3", "mine-2.py:Mine ended with exit status 3"),
    ],
)
def test_mistakes_are_told_apart_without_their_numbers(text: str, without: str) -> None:
    assert without_numbers(text) == without


def test_a_fault_is_no_excuse_for_an_answer_that_is_too_late_by_itself() -> None:
    delayed = replace(HERE, faults=(AvoiderLate(delay_s=0.008),))
    own = ANSWERED.evaluate(run(delayed, avoider=Slow(decision_time_s=0.2)))
    assert own.verdict is Verdict.VIOLATED
    of_the_fault = ANSWERED.evaluate(run(delayed, avoider=Slow(decision_time_s=0.096)))
    assert of_the_fault.verdict is Verdict.INCONCLUSIVE
