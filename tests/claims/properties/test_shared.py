"""What several claims derive from a trace together changes none of them."""

from __future__ import annotations

from dataclasses import replace

from safety_harness.admission.claims import property_of
from safety_harness.claims.properties.base import Evaluation
from safety_harness.claims.properties.catalogue import CATALOGUE
from safety_harness.scenario.model import Claim, Verdict
from safety_harness.trace.trace import Trace


def judged(trace: Trace, sentences: list[str]) -> dict[str, Evaluation]:
    claims = [Claim(sentence=sentence, expected=Verdict.HOLDS) for sentence in sentences]
    return {claim.sentence: property_of(claim, trace.scenario).evaluate(trace) for claim in claims}


def test_the_order_of_the_claims_changes_nothing_and_neither_does_being_alone(visit: Trace) -> None:
    sentences = [entry.example for entry in CATALOGUE]
    together = judged(replace(visit), sentences)
    assert judged(replace(visit), sentences[::-1]) == together
    for sentence in sentences:
        assert judged(replace(visit), [sentence])[sentence] == together[sentence]


def test_judging_again_says_the_same(visit: Trace) -> None:
    """Some claims sort or write to arrays of their own: never to what others read."""
    fresh, before = replace(visit), visit.ticks.tobytes()
    first = judged(fresh, [entry.example for entry in CATALOGUE])
    assert judged(fresh, [entry.example for entry in CATALOGUE]) == first
    assert visit.ticks.tobytes() == before
