"""Page and JSON hold the same, whatever the numbers are."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from datetime import UTC, datetime

import made_up
import pytest

from safety_harness_paper import figure6, figure7, figure8, table1, table4, table5
from safety_harness_paper.document import About, comparison_words, document
from safety_harness_paper.intervals import Estimate, mean_of
from safety_harness_paper.page import render
from safety_harness_paper.plots import side_by_side
from safety_harness_paper.result import FigureComparison, PaperVerdict, Result
from safety_harness_paper.scale import DEFAULT

ABOUT = About(
    scale="default",
    seed=0,
    trainings=5,
    command="safety-harness reproduce all",
    package_version="1",
    source_hash="0123",
    software=(("numpy", "2"),),
    platform="a machine",
    generated_at=datetime(2026, 1, 2, 3, 4, tzinfo=UTC),
    keys=(("train DNN, seed 0", "abc"),),
)


@pytest.fixture(scope="module")
def results() -> list[Result]:
    main, reach, trials = made_up.main_evaluations(), made_up.reaches(), made_up.trials()
    return [
        table1.result(DEFAULT, main),
        table4.result(DEFAULT, reach),
        table5.result(DEFAULT, trials),
        figure6.result(DEFAULT, main),
        figure7.result(DEFAULT, trials),
        figure8.result(DEFAULT, trials),
    ]


def test_every_sentence_and_number_is_on_the_page(results: list[Result]) -> None:
    page = re.sub(r"&#39;", "'", render(results, ABOUT)).replace("&amp;", "&")
    for result in results:
        assert result.why.replace("&", "&amp;") in page or result.why in page
        for claim in result.claims:
            assert claim.sentence in page
        for one in result.comparisons:
            assert all(words in page for words in comparison_words(one))
        for table in result.tables:
            assert all(cell in page for row in table.rows for cell in row)
    assert "Not complete." not in page
    assert "Quick scale." not in page


def test_the_page_says_what_is_missing_and_that_quick_means_nothing(results: list[Result]) -> None:
    about = replace(ABOUT, scale="quick", missing=(("table2", "it failed <here>"),))
    page = render(results, about)
    assert "Not complete." in page
    assert "table2: it failed &lt;here&gt;" in page
    assert "Nothing follows from its numbers." in page


def test_the_page_works_in_the_dark_on_paper_and_without_a_network(results: list[Result]) -> None:
    page = render(results, ABOUT)
    assert "prefers-color-scheme: dark" in page
    assert "@media print" in page
    assert 'name="viewport"' in page
    assert "default-src 'none'" in page
    assert not re.search(r"url\((?!#)|https?://(?!www\.w3\.org)", page)
    assert not re.search(r"#a1b3[0-9a-f]{2}", page), "a colour of a drawing that is no variable"


def test_every_drawing_says_in_words_what_it_shows(results: list[Result]) -> None:
    page = render(results, ABOUT)
    drawings = re.findall(r'<svg[^>]*role="img"[^>]*>', page)
    assert len(drawings) == len(results)
    for drawing in drawings:
        labels = re.search(r'aria-labelledby="(\S+) (\S+)"', drawing)
        assert labels is not None
        assert all(f'id="{label}"' in page for label in labels.groups())


def test_the_same_results_give_the_same_bytes(results: list[Result]) -> None:
    assert render(results, ABOUT) == render(results, ABOUT)


def test_the_json_is_one_that_everybody_can_read(results: list[Result]) -> None:
    found = json.loads(json.dumps(document(results, ABOUT), allow_nan=False))
    assert [one["word"] for one in found["results"]] == [one.word.value for one in results]
    assert found["results"][0]["comparisons"][0]["agrees"] is True
    gap = found["results"][4]["plots"][0]["panels"][0]["series"][0]["y"]
    assert gap == [0.1, None, 0.0]


def test_numbers_that_are_not_finite_are_null() -> None:
    lonely = FigureComparison(label="", ours=mean_of([1.0]), paper=2.0)
    only = Result(
        name="one",
        title="",
        source="",
        paper_says="",
        word=PaperVerdict.NO_VERDICT,
        why="",
        comparisons=(lonely,),
    )
    ours = document([only], ABOUT)["results"][0]["comparisons"][0]["ours"]
    assert (ours["value"], ours["low"], ours["high"]) == (1.0, None, None)


@pytest.mark.parametrize(
    ("paper", "unit", "words"),
    [(0.8, "", "0.80"), (21.93, "mm", "21.93 mm"), (869.28, "", "869.28"), (None, "mm", "\u2013")],
)
def test_no_digit_of_the_paper_is_lost(paper: float | None, unit: str, words: str) -> None:
    ours = Estimate(value=1.0, low=0.5, high=1.5)
    digits = 1 if paper == 869.28 else 2
    assert (
        comparison_words(FigureComparison(label="", ours=ours, paper=paper, unit=unit, digits=digits))[0]
        == words
    )


def test_without_a_figure_of_the_paper_nothing_is_drawn_beside_it() -> None:
    ours = Estimate(value=1.0, low=-math.inf, high=math.inf)
    assert side_by_side([FigureComparison(label="a", ours=ours)], prefix="p-", title="t") == ""
    assert side_by_side([FigureComparison(label="a", ours=ours, paper=0.0)], prefix="p-", title="t") == ""
    assert "<svg" in side_by_side([FigureComparison(label="a", ours=ours, paper=2.0)], prefix="p-", title="t")
