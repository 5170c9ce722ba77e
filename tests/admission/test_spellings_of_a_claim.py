"""Two spellings of a claim have one meaning, and two claims never have the same."""

from __future__ import annotations

import pytest
from examples import scenario

from safety_harness import Verdict
from safety_harness.admission.claims import meaning_of, property_of
from safety_harness.claims.properties.catalogue import CATALOGUE
from safety_harness.scenario.model import Claim


def meaning(sentence: str) -> str:
    return meaning_of(property_of(Claim(sentence=sentence, expected=Verdict.HOLDS), scenario()))


@pytest.mark.parametrize(
    "spelling",
    [
        "hand distance > 50 mm",
        "hand distance >= 5 cm",
        "always hand distance > 0.05 m",
        "always hand distance >= 50 mm",
        "hand distance never below 5 cm",
    ],
)
def test_a_spelling_means_what_the_catalogues_sentence_means(spelling: str) -> None:
    assert meaning(spelling) == meaning("hand distance never below 50 mm")


def test_a_limit_on_a_speed_has_spellings_too() -> None:
    assert meaning("TCP speed <= 0.25 m/s") == meaning("TCP speed never above 250 mm/s")


@pytest.mark.parametrize(
    "other",
    [
        "hand distance > 51 mm",
        "always (hand distance > 50 mm or servoing)",
        "always for 2 s hand distance > 50 mm",
        "hand distance < 50 mm",
        "predicted hand distance > 50 mm",
        "nearest hand to TCP > 50 mm",
        "TCP speed <= 0.25 m/s",
    ],
)
def test_another_claim_means_something_else(other: str) -> None:
    assert meaning(other) != meaning("hand distance never below 50 mm")


def test_no_two_claims_of_the_catalogue_mean_the_same() -> None:
    made = [entry.prop for entry in CATALOGUE]
    assert len({meaning_of(claimed) for claimed in made}) == len(made)
