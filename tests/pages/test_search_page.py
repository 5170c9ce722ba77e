"""The page about a search: everything found is on it, with files and commands, and nothing is overstated."""

from __future__ import annotations

import itertools
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from functools import cache
from pathlib import Path

import factory
import numpy as np
import pytest
from page import Node, parse

from safety_harness.admission.agreement import Agreement, LargestDifference, present_source
from safety_harness.base.exceptions import Place, ScenarioError
from safety_harness.claims.properties.base import Unit
from safety_harness.extensions.pages.search_page import SearchEvidence, render
from safety_harness.search.confirm import Complaint, Disagreement, InOneWorld, disagreement_of
from safety_harness.search.counterexample import Counterexample
from safety_harness.search.coverage import Coverage, CoverageCell
from safety_harness.search.cube import Column, Cube
from safety_harness.search.findings import Findings, Goal, Outcomes
from safety_harness.search.shrink import Shrunk
from safety_harness.search.trials import in_kinematic
from safety_harness.search.written import Causes, WrittenCounterexample
from safety_harness.trace.overruling import Overruling
from safety_harness.trace.records import Check
from tests.search.short_space import SHORT

GOALS = (Goal(factory.APART, 0.1, Unit.LENGTH), Goal("TCP speed never above 250 mm/s", 0.1, Unit.SPEED))
CELL = CoverageCell("right", "to 1 m/s", "touching", "hand unseen", "proposed position")
AGREEMENT = Agreement(
    source=present_source(),
    shipped=62,
    random=500,
    seed=1,
    near_m=0.005,
    compared=16141,
    agreed=16140,
    compared_near=170,
    agreed_near=170,
    optimistic=("a scenario: PyBullet violated, kinematic holds",),
    disagreements=("a scenario: PyBullet violated, kinematic holds",),
    differences=(LargestDifference("TCP position [m]", 3.3e-4, "a-stuck-joint"),),
    left_out=(),
)


def findings_of(margins: Sequence[Sequence[float]], searcher: str = "default") -> Findings:
    """Of one run after another, with these margins [m, m/s]."""
    found = Findings(GOALS, Cube((Column(), Column())), searcher)
    rows = np.array(margins, float).reshape(-1, len(GOALS))
    points = np.linspace(0.0, 1.0, 2 * len(rows)).reshape(-1, 2)
    found.add(points, Outcomes.of_margins(rows))
    return found


def counterexample() -> Counterexample:
    run = factory.violated_run()
    scenario = run.trace.scenario
    number = next(k for k, one in enumerate(run.evaluations) if one.verdict.value == "violated")
    return Counterexample(
        complaint=Complaint(scenario.claims[number]),
        shrunk=Shrunk(scenario, used=88, steps=(), settled=True, interrupted=False),
        run=run.trace,
        evaluations=run.evaluations,
        found_margin=-0.1098,
        found_contact="contact",
        circumstances=("the run: right, to 1 m/s", "decision 1; largest spread 7 mm (threshold 5 mm)"),
        attribution=(
            "whose fault: perception (ideal): +9.0 mm",
            "in PyBullet, perception (ideal): kept, +8.0 mm",
        ),
        draws=7,
    )


def shown() -> WrittenCounterexample:
    one = counterexample()
    assert one.complaint.claim is not None
    found = findings_of([(-0.1, 0.1)])
    return WrittenCounterexample(
        one=one,
        groups=found.groups,
        searcher="default",
        path=Path("out/space-claim-1.yaml"),
        trace_file=Path("out/space-claim-1.trace"),
        text="# A counterexample\nscenario: x\n",
        expected=False,
    )


@cache
def apart() -> Disagreement:
    """Violated in the world that was searched, and held in what stands for the other: another draw."""
    claim = next(claim for claim in SHORT.simplest.claims if "hand distance" in claim.sentence)
    complaint, group = Complaint(claim), findings_of([(0.1, -0.02)]).groups[0]
    draws = [SHORT.draw(1, k) for k in range(8)]
    worlds = [disagreement_of(group, complaint, one, in_kinematic, in_kinematic).searched for one in draws]
    violated = next(world for world in worlds if world and complaint.is_in(world.run))
    held = next(world for world in worlds if world and not complaint.is_in(world.run))
    return Disagreement(group, complaint, violated, held)


def evidence(**changes: object) -> SearchEvidence:
    whole = SearchEvidence(
        title="a hand comes",
        space="unseen-hand",
        tested="avoider mc-dropout",
        seed=3,
        budget=1000,
        command="safety-harness fuzz space.yaml --budget 1000",
        generated_at=datetime(2026, 11, 21, 9, 30, tzinfo=UTC),
        findings=findings_of([(0.3, 0.2), (0.1, 0.2), (-0.05, 0.1), (-0.11, 0.1)]),
        fallback="",
        overruling=Overruling(2810, 2500, 310, Counter({Check.UNCERTAIN: 2700, Check.TABLE: 110})),
        computing_time="computing time not modelled",
        repeated=None,
        baseline=findings_of([(0.4, 0.2), (0.2, 0.2), (0.3, 0.2), (0.1, 0.1)], "uniform"),
        coverage=Coverage(Counter({CELL: 4})),
        violations=Coverage(Counter({CELL: 2})),
        shown=(shown(),),
        confirmed=2,
        physical=1,
        confirmed_in=("PyBullet",),
        unconfirmed=(apart(),),
        not_found=(),
        nearest_hand_m=0.012,
        agreement=AGREEMENT,
        provenance=factory.PROVENANCE,
    )
    return replace(whole, **changes)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def text() -> str:
    return render(evidence())


@pytest.fixture(scope="module")
def page(text: str) -> Node:
    return parse(text)


def banners(page: Node) -> list[str]:
    found = [node for node in page.walk() if "banner" in node.attributes.get("class", "").split()]
    return [node.all("strong")[0].text for node in found]


def test_each_claim_has_its_counts_its_first_violation_and_its_least_margin_with_the_baseline_beside(
    page: Node,
) -> None:
    rows = page.all("table", "claims-table")[0].all("tbody")[0].all("tr")
    cells = [[cell.text for cell in row.children if isinstance(cell, Node)] for row in rows]
    assert cells[0] == [
        f"1 {factory.APART}",
        "2 of 4",
        "3",
        "\u2212110.0 mm",
        "0 of 4",
        "\u2013",
        "+100.0 mm",
    ]
    assert cells[1][1:4] == ["0 of 4", "\u2013", "+100.0 mm/s"]


def test_without_a_baseline_there_is_no_column_for_one() -> None:
    table = parse(render(evidence(baseline=None))).all("table", "claims-table")[0]
    assert len(table.all("thead")[0].all("th")) == 4


def test_a_counterexample_is_shown_with_pictures_margins_reasons_files_and_commands(page: Node) -> None:
    section = page.one("counterexample-1")
    assert len([node for node in section.all("svg") if node.attributes.get("role") == "img"]) == 4
    for words in (
        "\u2212109.8 mm before it was shrunk",
        "shrunk in 88 runs",
        "7 of 10",
        "largest spread 7 mm",
        "whose fault: perception (ideal): +9.0 mm",
        "in PyBullet, perception (ideal): kept, +8.0 mm",
    ):
        assert words in section.text, words
    links = [link.attributes["href"] for link in section.all("ul", "files")[0].all("a")]
    assert links == ["space-claim-1.yaml", "space-claim-1.trace"]
    commands = [code.text for code in section.all("code", "copy")]
    assert commands == [
        "safety-harness run out/space-claim-1.yaml",
        "safety-harness replay out/space-claim-1.trace",
    ]
    assert section.all("pre")[0].children[0] == shown().text


def test_the_drawings_show_the_worst_moment_of_the_claim_in_the_heading() -> None:
    """Two claims are violated at 8.6 s and at 5.1 s; the heading is of the second."""
    one = counterexample()
    claim = one.shrunk.scenario.claims[1]
    about_speed = replace(shown(), one=replace(one, complaint=Complaint(claim, "too fast")))
    for example, moment_s, other_s in ((shown(), 8.6, 5.1), (about_speed, 5.1, 8.6)):
        section = parse(render(evidence(shown=(example,)))).one("counterexample-1")
        caption = section.all("figcaption")[0].text
        assert f"{moment_s:.3f} s, the worst moment of {example.one.complaint.sentence}" in caption
        assert f"{other_s:.3f} s" not in caption
        drawn = [node.text for node in section.all("desc")]
        assert len(drawn) == 4
        assert all(f"Hands are drawn in full at {moment_s:.2f} s" in words for words in drawn)


def test_counterexamples_of_one_cause_are_one_card() -> None:
    known = replace(counterexample(), causes=("avoider (exact optimum)",))
    three = tuple(replace(shown(), one=known, path=Path(f"out/{name}.yaml")) for name in "abc")
    causes = Causes({"avoider (exact optimum)": ["a.yaml", "c.yaml"], "camera": ["b.yaml"]}, 7, 7)
    page = parse(render(evidence(shown=three, causes=causes)))
    assert "2 causes explained, 7 examples not explained yet" in page.text
    assert "One cause explains 2 examples: avoider (exact optimum). It also explains" in page.text
    assert "causes explained2" in page.all("dl", "counts")[0].text
    assert "examples not explained7" in page.all("dl", "counts")[0].text
    assert "This command explains the rest:" in page.text
    assert " --explain all" in page.text
    cards = page.all("div", "answer")
    assert len(cards) == 2
    assert [card.attributes["aria-label"] for card in cards] == ["Cause 1", "Cause 2"]
    assert all("as found" in card.text and "shrunk" in card.text for card in cards)
    assert all("109.8 mm, contact" in card.text for card in cards)
    assert all("contact" in card.text and "safety-harness run " in card.text for card in cards)
    assert all(len(card.all("svg")) == 1 for card in cards)
    three = tuple(replace(one, one=replace(one.one, causes=())) for one in three)
    alone = parse(render(evidence(shown=three, causes=Causes({}, 3))))
    assert "0 causes explained, 3 examples not explained. Each of the" in alone.text
    assert "This command explains the rest:" not in alone.text
    assert len(alone.all("div", "answer")) == 3


def test_what_pybullet_does_not_confirm_is_listed_and_called_no_violation(page: Node) -> None:
    assert "Not confirmed." in banners(page)
    assert "TCP speed never above 250 mm/s" in page.text
    assert "The two worlds disagree on them, so they do not count as violations" in page.text
    assert "PyBullet showed 2 of 3 tried findings" in page.text
    assert "Physics had a part in 1 of these 2" in page.text


def test_what_pybullet_does_not_confirm_is_drawn_in_either_world_with_what_each_says(page: Node) -> None:
    (section,) = page.all("section", "apart")
    assert len([node for node in section.all("svg") if node.attributes.get("role") == "img"]) == 4
    searched, confirming = (node.text for node in section.all("p") if node.all("span", "verdict"))
    assert searched.startswith("violated")
    assert "kinematic world" in searched
    assert confirming.startswith("holds")
    assert "PyBullet" in confirming


def test_a_disagreement_without_runs_says_why() -> None:
    error = ScenarioError(place=Place(), expected="a hand", got="none")
    refused = replace(apart(), searched=InOneWorld(error))
    words = parse(render(evidence(unconfirmed=(refused,)))).all("section", "apart")[0].text
    assert "no run: " in words
    assert "expected a hand" in words


def test_only_so_many_disagreements_are_drawn_and_the_others_are_counted() -> None:
    more = replace(apart(), searched=None, confirming=None)
    page = parse(render(evidence(unconfirmed=(apart(), more))))
    assert len(page.all("section", "apart")) == 1
    assert "The first 1 are drawn." in page.text


@pytest.mark.parametrize(
    ("distance", "banner", "said"),
    [
        ("touching", "Hands touched the arm.", "in 3 a hand touched the arm"),
        ("to 50 mm", "Nothing found.", "no evidence of safety"),
    ],
)
def test_finding_nothing_is_called_no_evidence_and_not_said_beside_a_touch(
    distance: str, banner: str, said: str
) -> None:
    coverage = Coverage(Counter({replace(CELL, distance=distance): 3}))
    none = findings_of([(0.1, 0.1)])
    page = parse(render(evidence(findings=none, coverage=coverage, shown=(), unconfirmed=(), confirmed=0)))
    assert banners(page) == [banner]
    assert said in page.text


def test_interruption_a_claim_that_always_fails_and_one_never_tested_are_said_first() -> None:
    findings = findings_of([(-0.1, np.nan)] * 20)
    findings.interrupted = True
    found = banners(parse(render(evidence(findings=findings, baseline=None, unconfirmed=()))))
    assert found == ["Interrupted.", "Violated.", "Always violated.", "Never put to the test."]


def test_points_that_were_refused_are_counted_with_their_reasons() -> None:
    findings = findings_of([(0.1, 0.1)])
    findings.refused["tcp start: out of reach"] = 12
    page = parse(render(evidence(findings=findings)))
    assert "tcp start: out of reach" in page.text
    assert not any(node.attributes.get("id") == "refused" for node in parse(render(evidence())).walk())


def test_the_agreement_of_the_worlds_is_there_and_old_once_the_source_has_changed(page: Node) -> None:
    words = parse(render(evidence())).text
    for expected in ("16,140", "16,141", "over 99.9 %", "0.00033", "PyBullet violated, kinematic holds"):
        assert expected in words, expected
    assert "Not measured with the present source." not in banners(page)
    old = parse(render(evidence(agreement=replace(AGREEMENT, source="f" * 16))))
    assert "Not measured with the present source." in banners(old)


def test_a_mishap_without_a_trace_has_a_section_too() -> None:
    one = replace(
        counterexample(),
        complaint=Complaint(None, "the run failed: ValueError: x"),
        run=ValueError("x"),
        evaluations=(),
        found_margin=None,
        circumstances=(),
        attribution=(),
        draws=None,
    )
    page = parse(render(evidence(shown=(replace(shown(), one=one, trace_file=None),))))
    section = page.one("counterexample-1")
    assert "the run failed: ValueError: x" in section.text
    assert not section.all("figure")


def test_a_search_interrupted_before_anything_was_tried_has_a_page() -> None:
    nothing = Findings(GOALS, Cube((Column(), Column())), "default")
    nothing.interrupted = True
    empty = evidence(
        findings=nothing, baseline=None, coverage=Coverage(), shown=(), unconfirmed=(), confirmed=0
    )
    assert "Interrupted." in banners(parse(render(empty)))


def test_markup_in_any_text_of_the_user_is_shown_and_not_obeyed() -> None:
    path = Path(f"out/x{factory.HOSTILE}.yaml")
    hostile = replace(shown(), path=path, trace_file=path.with_suffix(".trace"), text=factory.HOSTILE)
    text = render(evidence(title=factory.HOSTILE, tested=factory.HOSTILE, shown=(hostile,)))
    assert text.count("<script") == 1
    assert "<b>" not in text


def test_the_page_asks_nothing_of_the_network_and_links_to_files_beside_it(text: str, page: Node) -> None:
    assert "http:" not in text
    assert "https:" not in text
    for node in page.walk():
        for name in ("src", "href", "action"):
            assert re.match(r"#|data:,$|space-claim-1\.(yaml|trace)$", node.attributes.get(name, "#"))


def test_ids_are_unique_everything_pointed_at_exists_and_headings_descend(page: Node) -> None:
    ids = [node.attributes["id"] for node in page.walk() if "id" in node.attributes]
    assert len(ids) == len(set(ids))
    for node in page.walk():
        targets = node.attributes.get("aria-labelledby", "").split()
        if node.attributes.get("href", "").startswith("#"):
            targets.append(node.attributes["href"][1:])
        assert set(targets) <= set(ids), node.attributes
    levels = [int(node.tag[1]) for node in page.walk() if re.fullmatch(r"h[1-6]", node.tag)]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(after <= before + 1 for before, after in itertools.pairwise(levels))
    for table in page.all("table"):
        assert table.all("caption")[0].text


def test_the_same_evidence_gives_the_same_bytes(text: str) -> None:
    assert render(evidence()) == text
