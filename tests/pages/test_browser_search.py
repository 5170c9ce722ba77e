"""The page about a search in a real browser: quiet, no wider than the screen, its map readable."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from browsing import assert_quiet, show
from test_search_page import AGREEMENT, evidence, shown

from safety_harness.extensions.pages.coverage_map import coverage_map
from safety_harness.extensions.pages.page_parts import asset
from safety_harness.extensions.pages.search_page import render
from safety_harness.extensions.pages.svg import standalone

LONG = "reports/very-long-name-without-a-break/" * 6


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("fuzz")
    whole = evidence(command=f"safety-harness fuzz {LONG}", shown=(shown(), shown()), agreement=AGREEMENT)
    (folder / "fuzz.html").write_text(render(whole), encoding="utf-8")
    drawn = coverage_map(whole.coverage, whole.violations.counts, prefix="m-", title="Coverage")
    (folder / "coverage.svg").write_text(standalone(drawn, style=asset("report.css")), encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def page(folder: Path) -> str:
    return (folder / "fuzz.html").as_uri()


def test_no_request_leaves_the_page_and_nothing_is_wrong_in_the_console(browser: Any, page: str) -> None:
    assert_quiet(browser, page)


@pytest.mark.parametrize("width", [360, 768, 1280])
def test_the_page_never_scrolls_sideways(browser: Any, page: str, width: int) -> None:
    show(browser, page, width=width)
    assert browser.execute_script("return document.documentElement.scrollWidth") <= width
    outside = browser.execute_script(
        """return [...document.querySelectorAll('main *, header *, footer *')].filter((e) =>
             !e.closest('.drawing, .unseen') && e.getBoundingClientRect().right > innerWidth + 1
           ).map((e) => e.outerHTML.slice(0, 120))"""
    )
    assert outside == []


def test_no_two_words_of_the_map_overlap_and_none_is_cut_off(browser: Any, page: str) -> None:
    show(browser, page, width=1280)
    boxes = browser.execute_script(
        """const svg = document.querySelector('.coverage svg'), own = svg.getBoundingClientRect();
           return [...svg.querySelectorAll('text')].map((e) => { const b = e.getBoundingClientRect();
             return [e.textContent, b.left - own.left, b.top - own.top, b.right - own.left,
                     b.bottom - own.top, own.width]; })"""
    )
    assert len(boxes) > 100
    for number, (words, left, top, right, bottom, width) in enumerate(boxes):
        assert left >= -1, words
        assert right <= width + 1, words
        for other, left2, top2, right2, bottom2, _ in boxes[:number]:
            apart = right <= left2 or right2 <= left or bottom <= top2 + 4 or bottom2 <= top + 4
            assert apart, (words, other)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_map_alone_follows_the_readers_scheme(browser: Any, folder: Path, scheme: str) -> None:
    show(browser, (folder / "coverage.svg").as_uri(), width=1100, scheme=scheme)
    paper, ink = browser.execute_script(
        """const s = getComputedStyle(document.documentElement);
           return [s.backgroundColor, getComputedStyle(document.querySelector('text')).fill]"""
    )
    brightness = [sum(int(word) for word in one[4:-1].split(",")) for one in (paper, ink)]
    assert (brightness[0] > brightness[1]) == (scheme == "light")
    assert abs(brightness[0] - brightness[1]) > 300
