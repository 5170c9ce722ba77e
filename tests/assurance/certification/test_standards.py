from __future__ import annotations

import page
from made_up_evidence import evidence

from safety_harness.claims.properties.catalogue import CATALOGUE, entry_claimed
from safety_harness.claims.properties.tally import EXCLUSIONS
from safety_harness.extensions.assurance.certification.page import render
from safety_harness.extensions.assurance.certification.standards import (
    OWN,
    QUESTIONS,
    STANDARDS,
    TRACED,
    Tracing,
    standards_of,
    traced,
)


def tracing_of(sentence: str) -> Tracing:
    claimed = entry_claimed(sentence)
    return traced(claimed and claimed[0])


def test_every_claim_of_the_catalogue_is_traced_to_one_hazard_by_its_key() -> None:
    assert sorted(key for one in STANDARDS.hazards for key in one.claims) == sorted(e.key for e in CATALOGUE)
    assert all(traced(entry).hazard and traced(entry) is not OWN for entry in CATALOGUE)


def test_the_key_of_a_claim_is_its_words_without_values() -> None:
    entry, _ = entry_claimed("GIVES WAY AT MOST 1 TIME") or (None, None)
    assert entry is not None
    assert entry.key == "retreats-at-most-times"


def test_separation_is_traced_to_the_technical_specification() -> None:
    terms = [f"{term.standard} {term.term}" for term in tracing_of("protective separation kept").terms]
    assert any("ISO/TS 15066" in term and "S_p" in term for term in terms)
    assert any("ISO 10218-2:2025" in term for term in terms)


def test_a_formula_is_traced_to_nothing_that_its_author_did_not_say() -> None:
    assert tracing_of("always hand distance > 30 mm") is OWN
    assert OWN.terms == ()


def test_no_performance_level_is_claimed_and_what_is_left_out_is_named() -> None:
    text = " ".join(EXCLUSIONS)
    for left_out in ("contact forces", "fingers", "torso and head", "whom no scenario has", "real sensors"):
        assert left_out in text
    assert "no performance level" in text


def test_every_term_is_of_a_document_of_the_table_and_none_of_one_that_is_history() -> None:
    current = {one.name for one in STANDARDS.standards if not one.status.startswith("history")}
    assert {term.standard for tracing in TRACED.values() for term in tracing.terms} <= current
    assert "ISO/TS 15066:2016" not in current


def test_of_each_requirement_it_says_what_speaks_to_it_or_what_would() -> None:
    asked = [one for standard in STANDARDS.standards for one in standard.requirements]
    assert all(one.means and one.asks for one in asked)
    covered = {bool(one.here) for one in asked}
    assert covered == {True, False}
    assert len({standard.id for standard in STANDARDS.standards}) == len(STANDARDS.standards)


def test_every_place_that_answers_or_speaks_to_a_requirement_is_on_the_page() -> None:
    shown = page.parse(render(evidence(counterexamples=0), {}))
    asked = [one for standard in STANDARDS.standards for one in standard.requirements]
    for one in (*asked, *QUESTIONS):
        assert not one.here or shown.one(one.here), one
    assert all(STANDARDS[one.of] and one.means for one in QUESTIONS)
    assert len({one.asks for one in QUESTIONS}) == 30
    assert shown.text.count("not covered here") >= sum(not one.here for one in QUESTIONS) > 5


def test_the_words_of_a_claim_name_their_documents_from_the_table_alone() -> None:
    for entry in CATALOGUE:
        assert "ISO" not in entry.source
        terms = traced(entry).terms
        assert dict(standards_of(entry))["standards"].count("ISO ") >= len(terms)


def test_law_and_standards_of_2026_have_their_rows() -> None:
    """Each text that was read in excerpts only says so."""
    rows = {one.name: one for one in STANDARDS.standards}
    for name in (
        "Regulation (EU) 2024/1689 (AI Act), as amended in 2026",
        "ISO/IEC TS 22440",
        "ISO/TR 22100-5:2021",
        "ANSI/A3 R15.06-2025",
        "Regulation (EU) 2023/1230",
    ):
        assert "in excerpts" in rows[name].source
    asked = " ".join(one.asks for one in rows["Regulation (EU) 2023/1230"].requirements)
    assert "1.2.1" in asked
    assert "five years" in asked
    (by_way_of,) = rows["Regulation (EU) 2024/1689 (AI Act), as amended in 2026"].requirements
    assert "by way of Regulation (EU) 2023/1230" in by_way_of.means
    assert "supervised" in rows["AMLAS"].about
