from __future__ import annotations

import re
from dataclasses import replace

import factory
import page
import pytest
from made_up_evidence import HASH, HOSTILE, STRATA, evidence, outcome

from safety_harness.extensions.assurance.certification.evidence import ClaimStatus, OpenFinding, by_severity
from safety_harness.extensions.assurance.certification.page import render
from safety_harness.extensions.pages.page_parts import asset


@pytest.fixture(scope="module")
def text() -> str:
    return render(evidence(), {1: factory.violated_run()})


@pytest.fixture(scope="module")
def document(text: str) -> page.Node:
    return page.parse(text)


def test_the_first_page_says_of_each_claim_the_verdict_the_bound_and_how_often_it_was_tested(
    document: page.Node,
) -> None:
    (table,) = document.all("table", "verdicts")
    rows = [row.text for row in table.all("tr")][1:]
    assert len(rows) == 6
    assert "refuted" in rows[0]
    assert "1.71 %" in rows[0]
    assert "8880 of 9000 runs" in rows[0]
    assert "not bounded" in rows[1]
    assert "0 of 9000 runs" in rows[1]


def test_a_refuted_claim_names_on_top_a_stratum_that_exceeds_its_target() -> None:
    """Another stratum, of fewer runs, has a larger upper bound, and may well keep the target."""
    refuted = evidence().claims[0]
    few = outcome("few", ClaimStatus.NOT_SHOWN, upper=0.4)
    whole = replace(evidence(), claims=(replace(refuted, outcomes=(few, *refuted.outcomes)),))
    (shown,) = page.parse(render(whole, {})).all("ul", "answers")
    refuting = {one.stratum for one in refuted.outcomes if one.standing is ClaimStatus.REFUTED}
    assert "more than" in shown.text
    assert "(few)" not in shown.text
    assert any(f"({stratum})" in shown.text for stratum in refuting)


def test_claims_stand_by_gravity_wherever_they_are_listed(document: page.Node) -> None:
    grave = [claim.sentence for claim in by_severity(evidence().claims)]
    (table,) = document.all("table", "verdicts")
    articles = [one for one in document.all("article") if "claim-" in one.attributes.get("id", "")]
    for listed in ([row.text for row in table.all("tr")][1:], [one.text for one in articles]):
        assert all(name in text for name, text in zip(grave, listed, strict=True))
    assert grave[0].startswith("hand distance never below")
    assert [one.standing for one in by_severity(evidence().claims)][:2] == [
        ClaimStatus.REFUTED,
        ClaimStatus.UNTESTED,
    ]


def test_the_page_leads_with_the_gravest_findings_and_folds_the_rest() -> None:
    many = tuple(OpenFinding(text=f"finding {k}", place="plan") for k in range(9))
    whole = evidence()
    shown = page.parse(render(replace(whole, findings=(*many, *whole.findings)), {}))
    lead = shown.text[shown.text.index("Gravest findings") : shown.text.index("Not shown here")]
    assert (
        lead.index("is refuted in 3 strata") < lead.index("never put to the test") < lead.index("finding 0")
    )
    assert lead.index("finding 0") < lead.index("8 more open findings") < lead.index("finding 1")


def test_every_number_of_the_first_page_leads_to_its_rows(document: page.Node) -> None:
    (table,) = document.all("table", "verdicts")
    numbers = [cell for cell in table.all("td", "number") if cell.text not in ("0", "\u2013", "not bounded")]
    targets = [cell.all("a")[0].attributes["href"][1:] for cell in numbers if cell.text != "0.2 %"]
    assert len(targets) == 12
    for target in targets:
        row = document.one(target)
        assert row.tag == "tr"
        assert row.attributes["id"].startswith("row-")
    counted = [one.all("a")[0].attributes["href"][1:] for one in document.all("dd") if "of 6" in one.text]
    assert [document.one(one).tag for one in counted] == ["tr"] * 4


def test_the_box_on_top_has_bound_target_and_verdict_of_each_claim(document: page.Node) -> None:
    box = next(one for one in document.all("div", "banner") if one.all("li"))
    lines = [one.text for one in box.all("li")]
    assert len(lines) == 6
    assert all(one.all("span", "verdict") for one in box.all("li"))
    assert any(" violate it (" in line and line.endswith(" was the target") for line in lines)
    assert any("runs put it to the test" in line for line in lines)
    order = [
        node.attributes.get("id", node.tag)
        for node in document.all("section")[0].children
        if hasattr(node, "tag")
    ]
    assert order.index("nav") > order.index("div")


def test_no_sentence_stands_twice() -> None:
    """Nor in the words of claims, which differ from each other in a real plan."""
    claims = tuple(
        replace(one, rationale=f"Why {one.number}.", exercised_when="") for one in evidence().claims
    )
    run = factory.violated_run()
    shown = page.parse(render(replace(evidence(), claims=claims), {1: run, 2: run}))
    kinds = ("p", "li", "caption", "dd", "summary")
    leaves = [one for one in shown.walk() if one.tag in kinds and not (one.all("li")[1:] or one.all("p")[1:])]
    said = [part for one in leaves for part in re.split(r"(?<=[.;:]) ", one.text) if len(part) > 60]
    twice = {one for one in said if said.count(one) > 1 and HOSTILE not in one and HASH not in one}
    assert twice <= {"Drag or use the arrow keys to turn, + and \u2212 to zoom, space to play."}


def test_all_of_it_is_printed_only_if_that_was_asked_for() -> None:
    whole = evidence(counterexamples=0)
    asked = replace(whole.provenance, command="safety-harness certify plan.yaml --full")
    for one, full in ((whole, False), (replace(whole, provenance=asked), True)):
        (box,) = page.parse(render(one, {})).all("div", "evidence")
        assert ("full" in box.attributes["class"].split()) == full


def test_it_says_that_it_is_no_certificate_and_claims_no_performance_level(document: page.Node) -> None:
    (statement,) = document.all("p", "statement")
    assert "It is no certificate" in statement.text
    assert "no performance level" in statement.text
    hazards = document.text[document.text.index("Hazards and claims") :]
    assert "claims no performance level" in hazards


def test_a_report_with_an_inconclusive_claim_is_not_green() -> None:
    fine = page.parse(render(evidence(only_shown=True, counterexamples=0), {}))
    assert [node.attributes["class"] for node in fine.all("div", "banner")] == ["banner fine"]
    whole = evidence(counterexamples=0)
    for standing in ClaimStatus:
        if standing is ClaimStatus.SHOWN:
            continue
        only = tuple(claim for claim in whole.claims if claim.standing in (standing, ClaimStatus.SHOWN))
        shown = page.parse(render(replace(whole, standing=standing, claims=only), {}))
        banners = [node.attributes["class"] for node in shown.all("div", "banner")]
        assert not any("fine" in one for one in banners), standing


def test_every_link_leads_somewhere(document: page.Node) -> None:
    ids = [node.attributes["id"] for node in document.walk() if "id" in node.attributes]
    assert len(ids) == len(set(ids))
    links = [node.attributes["href"] for node in document.all("a")]
    assert len(links) > 40
    for link in links:
        assert link.startswith("#")
        assert link[1:] in ids, link


def test_names_are_text_and_never_markup(text: str, document: page.Node) -> None:
    assert HOSTILE not in text
    assert document.all("b") == []
    assert STRATA[2] in document.text
    kinds = [node.attributes.get("type", "") for node in document.all("script")]
    assert kinds == [""]


def test_the_same_evidence_gives_the_same_bytes(text: str) -> None:
    assert render(evidence(), {1: factory.violated_run()}) == text


def test_pictures_button_and_replay_show_the_worst_moment_of_the_claim_in_the_heading() -> None:
    """Two claims are violated at 8.6 s and at 5.1 s: each heading has its own."""
    run, whole = factory.violated_run(), evidence()
    moments = dict(zip((factory.APART, factory.SLOW), (8.6, 5.1), strict=True))
    examples = tuple(
        replace(one, sentence=sentence) for one, sentence in zip(whole.counterexamples, moments, strict=True)
    )
    parsed = page.parse(render(replace(whole, counterexamples=examples), {1: run, 2: run}))
    for article, (sentence, moment_s) in zip(
        parsed.all("article", "counterexample"), moments.items(), strict=True
    ):
        assert sentence in article.text
        assert f"worst moment at {moment_s:.3f} s" in article.text
        (figure,) = article.all("figure", "replay")
        assert float(figure.attributes["data-from"]) == moment_s
        (button,) = (one for one in article.all("button") if "data-jump" in one.attributes)
        assert (button.text, float(button.attributes["data-jump"])) == ("Worst moment", moment_s)
        assert f"TCP at {moment_s:.3f} s" in article.text
        drawn = [node.text for node in article.all("desc") if "Hands are drawn" in node.text]
        assert len(drawn) == 4
        assert all(f"at {moment_s:.2f} s" in words for words in drawn)


def test_the_viewer_is_there_once_and_only_where_there_is_something_to_replay(text: str) -> None:
    viewer = asset("replay.js")
    assert text.count(viewer) == 1
    assert len(text) < 2_500_000
    none = render(evidence(counterexamples=0), {})
    assert viewer not in none
    assert len(none) < 400_000


def test_what_the_plan_did_not_measure_is_said(document: page.Node) -> None:
    words = document.text
    assert "no run exercised it, so nothing is known about it" in words
    assert "scenarios with another source" in words
    assert "This report does not compare the simulator with a real cell." in words


def test_a_search_that_was_asked_for_and_is_not_there_is_not_passed_over() -> None:
    whole = evidence(counterexamples=0)
    missing = page.parse(render(replace(whole, search=None), {}))
    assert "The plan asks for a search of 2000 runs, but its results are missing." in missing.text
    none = page.parse(render(replace(whole, search=None, plan=replace(whole.plan, search_runs=0)), {}))
    assert "The plan asks for no search." in none.text


def test_it_lists_by_standard_what_is_missing(document: page.Node) -> None:
    standards = document.text[document.text.index("Standards, and missing points") :]
    assert "ISO 13849-1:2023a rate of dangerous failures an hour" in standards
    for words in (
        "not covered here",
        "superseded in content by ISO 10218-2:2025",
        "applies from 20 January 2027",
    ):
        assert words in standards
