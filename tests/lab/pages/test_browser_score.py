"""The page about scored avoiders in a real browser: quiet, no wider than the screen."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
import score_cards
from browsing import assert_quiet, show

from safety_harness.extensions.lab.pages.score_page import ScoreEvidence, render

LONG = "reports/very-long-name-without-a-break/" * 6


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> str:
    file: Path = tmp_path_factory.mktemp("scores") / "evaluation.html"
    scored = score_cards.scored(avoider=f"{LONG}mine.py:Mine", file=f"{LONG.replace('/', '-')}.yaml")
    when = datetime(2026, 11, 22, tzinfo=UTC)
    file.write_text(render(ScoreEvidence(scored=scored, command=LONG, generated_at=when)), encoding="utf-8")
    return file.as_uri()


def test_no_request_leaves_the_page_of_scores_and_its_console_is_quiet(browser: Any, page: str) -> None:
    assert_quiet(browser, page)


@pytest.mark.parametrize("width", [360, 768, 1280])
def test_the_page_of_scores_never_scrolls_sideways(browser: Any, page: str, width: int) -> None:
    show(browser, page, width=width)
    assert browser.execute_script("return document.documentElement.scrollWidth") <= width
    outside = browser.execute_script(
        """return [...document.querySelectorAll('main *, header *, footer *')].filter((e) =>
             !e.closest('.drawing, .unseen, .scroll') && e.getBoundingClientRect().right > innerWidth + 1
           ).map((e) => e.outerHTML.slice(0, 120))"""
    )
    assert outside == []
