from __future__ import annotations

from safety_harness.certification.standards import EXCLUSIONS, OWN, TRACED, entry_of, traced
from safety_harness.properties.catalogue import CATALOGUE


def test_every_claim_of_the_catalogue_is_traced_to_a_hazard() -> None:
    assert set(TRACED) == {entry.example for entry in CATALOGUE}
    for entry in CATALOGUE:
        assert entry_of(entry.example) is not None
        assert traced(entry.example).hazard


def test_separation_is_traced_to_the_technical_specification() -> None:
    terms = [f"{term.standard} {term.term}" for term in traced("protective separation kept").terms]
    assert any("ISO/TS 15066" in term and "S_p" in term for term in terms)
    assert any("ISO 10218-2:2025" in term for term in terms)


def test_a_formula_is_traced_to_nothing_that_its_author_did_not_say() -> None:
    assert traced("always hand distance > 30 mm") is OWN
    assert OWN.terms == ()


def test_no_performance_level_is_claimed_and_what_is_left_out_is_named() -> None:
    text = " ".join(EXCLUSIONS)
    for left_out in ("contact forces", "fingers", "torso and head", "whom no scenario has", "real sensors"):
        assert left_out in text
    assert "no performance level" in text
