"""The coverage as a picture: every cell once, larger for more runs, violations framed, light or dark."""

from __future__ import annotations

import re
from collections import Counter
from xml.etree import ElementTree

import pytest

from safety_harness.extensions.pages.coverage_map import CLASSES, SIZES_PX, coverage_map, size_class
from safety_harness.extensions.pages.page_parts import asset
from safety_harness.extensions.pages.svg import standalone
from safety_harness.search.coverage import Coverage, CoverageCell

MANY = CoverageCell("front", "to 0.5 m/s", "farther", "seen", "proposed position")
ONE = CoverageCell("below", "above 1 m/s", "touching", "both unseen", "protective stop")
COVERAGE = Coverage(Counter({MANY: 1234, ONE: 1}))
SVG = "{http://www.w3.org/2000/svg}"


def drawn(coverage: Coverage, violations: dict[CoverageCell, int] | None = None) -> ElementTree.Element:
    return ElementTree.fromstring(coverage_map(coverage, violations or {}, prefix="m-", title="Coverage"))


def cells(root: ElementTree.Element) -> dict[str, list[ElementTree.Element]]:
    """The shapes of each cell with runs, by the words that it shows when pointed at."""
    return {group.findtext("title", ""): group.findall("rect") for group in root.findall("g")}


def test_a_cell_with_runs_is_a_square_that_says_how_many_and_all_others_are_dots() -> None:
    root = drawn(COVERAGE)
    assert set(cells(root)) == {f"{MANY}: 1,234 runs", f"{ONE}: 1 run"}
    (dots,) = root.findall("path")
    assert len(set(re.findall(r"M\d+ \d+", dots.attrib["d"]))) == 1536 - 2


def test_the_rows_and_columns_have_their_totals() -> None:
    words = [text.text for text in drawn(COVERAGE).findall("text")]
    for direction, runs in (("front", "1,234 runs"), ("below", "1 run"), ("left", "0 runs")):
        assert words[words.index(direction) + 1] == runs
    assert words.count("1,234") == 2  # its row, its column
    assert words.count("1,234 runs") == 2  # its direction, its distance


def test_more_runs_make_a_larger_square() -> None:
    sizes = [SIZES_PX[size_class(count)] for count in (1, 2, 9, 10, 99, 100, 999, 1000, 10**6)]
    assert sizes == [3, 5, 5, 7, 7, 9, 9, 11, 11]
    assert len(CLASSES) == len(SIZES_PX)


def test_a_cell_with_violations_is_told_by_a_frame_and_by_words_not_by_colour_alone() -> None:
    shapes = cells(drawn(COVERAGE, {ONE: 1}))
    assert len(shapes[f"{ONE}: 1 run, 1 with a violation"]) == 2
    assert len(shapes[f"{MANY}: 1,234 runs"]) == 1


def test_no_two_cells_are_drawn_at_one_place() -> None:
    everything = Coverage(Counter(dict.fromkeys(Coverage().holes, 1)))
    places = [
        (one.attrib["x"], one.attrib["y"]) for shapes in cells(drawn(everything)).values() for one in shapes
    ]
    assert len(set(places)) == len(places) == 1536


def test_it_says_what_it_shows_to_those_who_cannot_see_it() -> None:
    root = drawn(COVERAGE, {ONE: 1})
    assert root.attrib["aria-labelledby"] == "m-title m-desc"
    description = root.findtext("desc", "")
    for words in ("2 of 1536 cells in 1235 runs", "front 1234", "1 cells have violations"):
        assert words in description


def test_no_runs_are_a_map_of_dots() -> None:
    assert cells(drawn(Coverage())) == {}


def test_as_a_file_of_its_own_every_colour_has_a_value_on_light_and_on_dark_paper() -> None:
    text = standalone(coverage_map(COVERAGE, prefix="m-", title="Coverage"), style=asset("report.css"))
    root = ElementTree.fromstring(text)
    assert root.tag == f"{SVG}svg"
    light, dark = root.findtext(f"{SVG}style", "").split("@media")
    used = set(re.findall(r"var\((--fig-[\w-]+)\)", text))
    assert used
    for name in used:
        assert f"{name}: #" in light
        assert f"{name}: #" in dark
    assert re.search(r"background:#\w+", light)
    assert "http:" not in text.replace("http://www.w3.org/2000/svg", "")


@pytest.mark.parametrize("count", [1, 50])
def test_the_same_counts_give_the_same_bytes_whatever_their_order(count: int) -> None:
    one, other = Coverage(Counter({MANY: count, ONE: 2})), Coverage(Counter({ONE: 2, MANY: count}))
    assert coverage_map(one, prefix="", title="t") == coverage_map(other, prefix="", title="t")
