"""The page and the file about scored avoiders: every figure is there, and nothing is overstated."""

from __future__ import annotations

import itertools
import json
import re
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

import factory
import numpy as np
import pytest
import score_cards
from page import Node, parse

from safety_harness.extensions.lab.pages.question_maps import VIEWS, Scale, question_map
from safety_harness.extensions.lab.pages.score_document import document, sentence
from safety_harness.extensions.lab.pages.score_page import ScoreEvidence, render
from safety_harness.extensions.lab.pages.score_tables import COLUMNS, figures, mm, rows_of
from safety_harness.extensions.lab.scoring.results import Scored

WHEN = datetime(2026, 11, 22, tzinfo=UTC)
SCALE = Scale((0.01, 0.06), ("small", "middle", "large"))


def written(scored: Scored, command: str = "safety-harness evaluate mc-dropout") -> str:
    return render(ScoreEvidence(scored=scored, command=command, generated_at=WHEN))


@pytest.fixture(scope="module")
def text() -> str:
    return written(score_cards.scored())


@pytest.fixture(scope="module")
def page(text: str) -> Node:
    return parse(text)


def test_the_answer_stands_on_top_and_counts_what_was_asked(page: Node) -> None:
    (head,) = page.all("h1")
    assert head.text == "2 findings on mc-dropout in 400 questions."
    none = score_cards.scored()
    none.avoiders[0].findings = ()
    assert "no proof of safety" in sentence(none)


def test_each_finding_says_what_where_and_by_how_much(page: Node) -> None:
    (table,) = page.all("table", "findings")
    rows = [[cell.text for cell in row.all("th") + row.all("td")] for row in table.all("tr")[1:]]
    assert rows == [
        ["far from the optimum", "seen", "1 % of the answers are more than 70.1 mm off the optimum"],
        ["does not repeat", "everywhere", "2 of 50 answers differ"],
    ]


def test_what_is_unlike_the_yardsticks_has_a_heading_of_its_own() -> None:
    """Below "Findings: None." it would read as a finding."""
    scored = score_cards.scored()
    one = scored.avoiders[0]
    one.findings, one.unlike = (), one.findings
    headed = {h.text: section for section in parse(written(scored)).all("section") for h in section.all("h2")}
    assert "None." in headed["Findings"].text
    assert headed["Findings"].all("table") == []
    (table,) = headed["Unlike the yardsticks"].all("table")
    assert "unlike the yardsticks in 2 ways" in table.text


def test_yardsticks_stand_below_the_avoider_region_by_region(page: Node) -> None:
    table = page.all("table", "scores")[0]
    rows = [[cell.text for cell in row.all("th") + row.all("td")][:2] for row in table.all("tr")[1:]]
    assert rows == [
        ["seen", "mc-dropout"],
        ["seen", "closed-form optimum"],
        ["far (no run asks)", "mc-dropout"],
        ["far (no run asks)", "closed-form optimum"],
    ]


def test_figures_are_those_of_the_card_and_what_is_not_known_is_a_dash() -> None:
    card = score_cards.scorecard(shift_m=0.07)
    row = next(rows_of([card], figures))
    cells = dict(zip(COLUMNS, row.cells, strict=True))
    score = card.regions[0]
    assert score.off_m is not None
    assert cells["off mm: p50"] == mm(score.off_m[0].value) == "70.0"
    assert cells["in reach"] == "\u2013"
    assert cells["jump mm"] == "81.0"
    assert figures(replace(score, off_m=None, wrong_and_sure=None), [])[4:] == ("\u2013",) * 2 + (
        mm(score.off_most_m),
        "\u2013",
        "\u2013",
    )


def test_the_avoider_is_not_its_own_yardstick() -> None:
    card = score_cards.scorecard()
    assert [row.avoider for row in rows_of([card, card], figures)] == ["mc-dropout", "mc-dropout"]


def test_worst_questions_link_to_their_files_and_are_of_another_ledger(page: Node) -> None:
    (table,) = page.all("table", "worst")
    (link,) = table.all("a")
    assert link.attributes["href"] == "worst-1.yaml"
    assert "\u221223.4" in table.text
    assert "proposals lead away to within 10 mm: violated" in table.text
    assert "A search for the worst asked 500 questions" in page.text
    assert "they enter no figure" in page.text
    assert "safety-harness run worst-1.yaml" in page.text
    assert "a hand within the robot" in page.text


def test_jumps_repeatability_and_times_are_in_words(page: Node) -> None:
    assert "81.0 mm where the hand moves 0.01 mm" in page.text
    assert "2 of 50 differ by 10.0 mm at most" in page.text
    assert "p50 0.8 ms, p99 2.1 ms, max 10 ms of 100 answers" in page.text


def test_what_no_run_asks_and_what_is_not_shown_are_said(page: Node) -> None:
    assert page.text.count("No run can ask such a question") == 1
    assert "Not shown:" in page.text


def test_an_interrupted_session_and_one_that_did_not_answer_are_said_first() -> None:
    page = parse(written(score_cards.scored(interrupted=True, failed=["x: no answer"])))
    banners = [node.text for node in page.all("p", "banner")]
    assert banners[0].startswith("Interrupted.")
    assert banners[1] == "Not scored. x: no answer"


def test_markup_of_the_user_is_shown_and_not_obeyed() -> None:
    text = written(score_cards.scored(avoider=factory.HOSTILE), command=factory.HOSTILE)
    assert text.count("<script") == 1
    assert "<b>" not in text


def test_the_page_asks_nothing_of_the_network_and_links_only_to_its_files(text: str, page: Node) -> None:
    assert "http:" not in text
    assert "https:" not in text
    for node in page.walk():
        for name in ("src", "href", "action"):
            assert re.match(r"#|data:,$|worst-1\.yaml$", node.attributes.get(name, "#"))


def test_ids_are_unique_tables_have_captions_and_headings_descend(page: Node) -> None:
    ids = [node.attributes["id"] for node in page.walk() if "id" in node.attributes]
    assert len(ids) == len(set(ids))
    for node in page.walk():
        assert set(node.attributes.get("aria-labelledby", "").split()) <= set(ids)
    levels = [int(node.tag[1]) for node in page.walk() if re.fullmatch(r"h[1-6]", node.tag)]
    assert levels[0] == 1
    assert all(after <= before + 1 for before, after in itertools.pairwise(levels))
    for table in page.all("table"):
        assert table.all("caption")[0].text


def test_the_same_evidence_gives_the_same_bytes_and_few_of_them(text: str) -> None:
    assert written(score_cards.scored()) == text
    assert len(text) < 200_000


def test_a_cell_of_a_map_is_as_bad_as_its_worst_question() -> None:
    positions = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [1.0, 0.0, 0.0]])
    values = np.array([0.0, 0.5, 0.03, np.nan])
    drawn = question_map(positions, values, SCALE, VIEWS[0], prefix="m-", title="t")
    assert "3 cells with questions, seen from above: 0 of small, 1 of middle, 2 of large." in drawn
    share = replace(SCALE, edges=(0.4, 0.6), shares=True)
    drawn = question_map(positions[:2], np.array([0.0, 1.0]), share, VIEWS[0], prefix="m-", title="t")
    assert "1 cells with questions, seen from above: 0 of small, 1 of middle, 0 of large." in drawn


def test_the_file_has_every_figure_with_its_interval_and_times_apart() -> None:
    read: dict[str, Any] = json.loads(document(score_cards.scored()))
    (one,) = read["avoiders"]
    region = one["regions"][0]
    assert region["asked"] == 200
    assert set(region["off_m"]) == {"p50", "p95", "p99"}
    assert region["off_m"]["p50"].keys() == {"value", "low", "high"}
    assert region["wrong_and_sure"].keys() == {"count", "trials", "low", "high"}
    assert "questions" not in region
    assert "answers" not in region
    assert one["search"]["worst"][0]["claims"] == {"proposals lead away to within 10 mm": "violated"}
    assert one["yardsticks"][0]["avoider"] == "closed-form optimum"
    assert read["times"]["mc-dropout"]["p99_s"] == 0.0021
    assert "median_s" not in json.dumps(read["avoiders"])


def test_the_file_says_what_happened_and_has_no_number_that_is_none() -> None:
    scored = score_cards.scored(interrupted=True, failed=["x"])
    card = scored.avoiders[0].card
    regions = (replace(card.regions[0], least_gained_m=float("nan")), *card.regions[1:])
    scored.avoiders[0].card = replace(card, regions=regions)
    read = json.loads(document(scored), parse_constant=lambda word: pytest.fail(word))
    assert (read["interrupted"], read["failed"]) == (True, ["x"])
    assert read["avoiders"][0]["regions"][0]["least_gained_m"] is None
