"""The report in a real browser: quiet on the network, without errors, readable at every width."""

from __future__ import annotations

import base64
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlparse

import factory
import pytest
from browsing import assert_quiet, colour, forget, show
from page import parse

from safety_harness.extensions.pages.run_page import write_report


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("report") / "report.html"
    write_report(
        path,
        [
            factory.holds_run(),
            factory.violated_run(),
            factory.no_hands_run(),
            factory.truncated_run(),
            factory.hostile_run(),
        ],
        title=f"Report {factory.HOSTILE}",
        command="harness run " + "very-long-name-without-a-break/" * 8,
        interrupted=True,
        generated_at=datetime(2025, 11, 21, 9, 30, tzinfo=UTC),
    )
    return Path(path).as_uri()


def test_no_request_leaves_the_page_and_nothing_is_wrong_in_the_console(browser: Any, report: str) -> None:
    assert_quiet(browser, report)


def test_markup_of_the_user_runs_nowhere(browser: Any, report: str) -> None:
    show(browser, report, width=1000)
    assert browser.execute_script("return document.scripts.length") == 1
    assert browser.execute_script("return document.querySelectorAll('b').length") == 0


def test_the_policy_stops_a_script_that_is_not_the_reports_own(browser: Any, report: str) -> None:
    show(browser, report, width=1000)
    inserted = "const s = document.createElement('script'); s.textContent = 'window.ran = 1';"
    browser.execute_script(inserted + "document.body.append(s)")
    assert browser.execute_script("return window.ran === undefined")
    forget(browser)


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [360, 768, 1280])
def test_the_page_never_scrolls_sideways(browser: Any, report: str, width: int, scheme: str) -> None:
    show(browser, report, width=width, scheme=scheme)
    assert browser.execute_script("return document.documentElement.scrollWidth") <= width
    # Nor is anything cut off without a way to scroll to it.
    outside = browser.execute_script(
        """return [...document.querySelectorAll('main *, header *, footer *')].filter((e) =>
             !e.closest('.drawing, .unseen') && e.getBoundingClientRect().right > innerWidth + 1
           ).map((e) => e.outerHTML.slice(0, 120))"""
    )
    assert outside == []


@pytest.mark.parametrize("width", [400, 800, 832, 1400])
def test_a_drawing_that_is_wider_than_the_screen_says_so_and_scrolls_to_its_end(
    browser: Any, report: str, width: int
) -> None:
    show(browser, report, width=width)
    wider, hinted, reached, focusable = browser.execute_script(
        """const box = document.querySelector('.drawing.wide'), hint = document.querySelector('.hint');
           const wider = box.scrollWidth > box.clientWidth;
           box.scrollLeft = 1e5;
           const end = box.querySelector('svg').getBoundingClientRect().right;
           const reached = end <= box.getBoundingClientRect().right + 1;
           return [wider, hint.offsetHeight > 0, reached, box.tabIndex === 0]"""
    )
    assert hinted or not wider
    assert (wider, hinted) == {400: (True, True), 1400: (False, False)}.get(width, (wider, hinted))
    assert reached
    assert focusable


def test_a_sorted_table_names_the_scenario_in_every_row(browser: Any, report: str) -> None:
    from selenium.webdriver.common.by import By

    def named() -> list[bool]:
        found: list[bool] = browser.execute_script(
            """return [...document.querySelectorAll('.verdicts tbody th > div')].map(
                 (e) => getComputedStyle(e).opacity === '1')"""
        )
        return found

    show(browser, report, width=1280)
    differs = "return [...document.querySelectorAll('.verdicts tbody tr')].map(r => r.matches('.differs'))"
    again = [False, True, False, True, True, False, False, False]
    expected = [not a or d for a, d in zip(again, browser.execute_script(differs), strict=True)]
    assert named() == expected
    assert False in expected
    browser.find_elements(By.CSS_SELECTOR, ".verdicts thead th button")[0].click()
    assert all(named())


def test_dark_paper_turns_text_and_curves_light(browser: Any, report: str) -> None:
    brightness = {}
    for scheme in ("light", "dark"):
        show(browser, report, width=1000, scheme=scheme)
        brightness[scheme] = {
            "paper": sum(colour(browser, "body", "backgroundColor")),
            "text": sum(colour(browser, "body", "color")),
            "figure": sum(colour(browser, ".drawing text", "fill")),
        }
    assert brightness["light"]["paper"] > 600 > 300 > brightness["light"]["text"]
    assert brightness["dark"]["paper"] < 150 < 500 < brightness["dark"]["text"]
    assert brightness["dark"]["figure"] > brightness["light"]["figure"] + 150


def test_every_small_text_has_enough_contrast_in_both_schemes(browser: Any, report: str) -> None:
    def luminance(rgb: list[int]) -> float:
        linear = [(c / 255 / 12.92 if c <= 10 else ((c / 255 + 0.055) / 1.055) ** 2.4) for c in rgb]
        return float(0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2])

    for scheme in ("light", "dark"):
        show(browser, report, width=1000, scheme=scheme)
        paper = luminance(colour(browser, "body", "backgroundColor"))
        for selector in (
            "body",
            "caption",
            ".verdict.holds",
            ".verdict.violated",
            ".verdict.inconclusive",
            ".claim-number",
            ".file",
            "a[href]",
        ):
            ink = luminance(colour(browser, selector, "color"))
            contrast = (max(ink, paper) + 0.05) / (min(ink, paper) + 0.05)
            assert contrast >= 4.5, (scheme, selector, contrast)
        for selector in (".badge", ".banner.grave"):
            washes = [luminance(colour(browser, selector, name)) for name in ("color", "backgroundColor")]
            contrast = (max(washes) + 0.05) / (min(washes) + 0.05)
            assert contrast >= 4.5, (scheme, selector, contrast)


def test_a_click_on_a_heading_sorts_the_table_by_the_number_and_not_by_its_text(
    browser: Any, report: str
) -> None:
    from selenium.webdriver.common.by import By

    show(browser, report, width=1280)
    margin = browser.find_elements(By.CSS_SELECTOR, ".verdicts thead th button")[4]
    cells = (
        "return [...document.querySelectorAll('.verdicts tbody td:nth-child(5)')].map(c => c.dataset.sort)"
    )
    for direction in ("ascending", "descending"):
        margin.click()
        shown = browser.execute_script(cells)
        numbers = [float(one) for one in shown if one]
        assert numbers == sorted(numbers, reverse=direction == "descending")
        assert shown[-1] == ""  # what has no margin stays at the end
        heading = margin.find_element(By.XPATH, "..")
        assert heading.get_attribute("aria-sort") == direction


def test_milliseconds_are_sorted_among_seconds(browser: Any, report: str) -> None:
    show(browser, report, width=1280)
    margins = ["\u22121.5 s", "\u2212300.0 ms", "+100.0 ms", "\u22122.0 s"]
    ordered = browser.execute_script(
        "return arguments[0].map(text => Number(amount(text))).sort((a, b) => a - b)", margins
    )
    assert ordered == [-2.0, -1.5, -0.3, 0.1]


def test_the_keyboard_reaches_the_skip_link_first(browser: Any, report: str) -> None:
    from selenium.webdriver.common.by import By
    from selenium.webdriver.common.keys import Keys

    show(browser, report, width=1000)
    browser.find_element(By.TAG_NAME, "body").send_keys(Keys.TAB)
    active = browser.switch_to.active_element
    assert active.get_attribute("class") == "skip"
    assert active.rect["x"] >= 0
    active.send_keys(Keys.ENTER)
    assert browser.execute_script("return document.activeElement.id") == "verdicts"


def test_in_print_everything_is_unfolded_and_on_light_paper(browser: Any, report: str) -> None:
    show(browser, report, width=700, scheme="dark", media="print")
    assert sum(colour(browser, "body", "backgroundColor")) > 600
    assert browser.execute_script("return document.documentElement.scrollWidth") <= 700
    printed = browser.execute_cdp_cmd("Page.printToPDF", {"preferCSSPageSize": True})
    assert base64.b64decode(printed["data"]).startswith(b"%PDF")
    assert browser.execute_script("return [...document.querySelectorAll('details')].every(d => d.open)")


def shown_rows(browser: Any) -> list[str]:
    script = """return [...document.querySelectorAll(".verdicts tbody tr")].filter((row) => row.offsetHeight)
      .map((row) => [...row.cells].map((cell) => cell.textContent.trim()).join(" | "))"""
    return list(browser.execute_script(script))


def write_in(browser: Any, name: str, value: str) -> None:
    script = """const control = document.querySelector(".filter").elements[arguments[0]];
      control.value = arguments[1]; control.dispatchEvent(new Event("input", { bubbles: true }))"""
    browser.execute_script(script, name, value)


def test_the_verdicts_are_filtered_and_the_filter_stands_in_the_address(browser: Any, report: str) -> None:
    show(browser, report, width=1280)
    every = shown_rows(browser)
    assert len(every) == 8
    write_in(browser, "verdict", "violated")
    violated = shown_rows(browser)
    assert 0 < len(violated) < len(every)
    assert all("violated" in row for row in violated)
    assert all(row.split(" | ")[0] for row in violated)  # each names its scenario, also without the row above
    write_in(browser, "find", "no such words")
    assert shown_rows(browser) == []
    write_in(browser, "find", "150 two hands")
    (row,) = shown_rows(browser)
    address = browser.current_url
    browser.get("about:blank")
    browser.get(address)
    assert shown_rows(browser) == [row]
    show(browser, address, width=400)
    assert shown_rows(browser) == [row]
    browser.execute_script("document.querySelector('.filter [type=reset]').click()")
    browser.implicitly_wait(0)
    assert browser.execute_async_script("setTimeout(arguments[0], 50)") is None
    assert len(shown_rows(browser)) == len(every)
    assert "=" not in browser.current_url


def test_no_address_keeps_the_page_from_working(browser: Any, report: str) -> None:
    forget(browser)
    for address in ("#100%", "#find=100%", "#", "#no-such-run"):
        browser.get("about:blank")
        show(browser, report + address, width=1280)
        assert browser.execute_script("return document.querySelectorAll('.copy-button').length") > 1
    assert browser.get_log("browser") == []


def test_the_slash_leads_to_the_filter_and_a_link_unfolds_its_run(browser: Any, report: str) -> None:
    from selenium.webdriver.common.keys import Keys

    show(browser, report, width=1280)
    browser.find_element("tag name", "body").send_keys("/")
    assert browser.switch_to.active_element.get_attribute("type") == "search"
    browser.switch_to.active_element.send_keys("a/b", Keys.TAB)
    browser.execute_script(
        "document.querySelector('#run-2 > details').open = false; location.hash = '#run-2'"
    )
    assert browser.execute_async_script("setTimeout(arguments[0], 50)") is None
    assert browser.execute_script("return document.querySelector('#run-2 > details').open")


@pytest.fixture(scope="module")
def long_report(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A page of more runs than a browser reads as it opens it; each has three claims."""
    path = tmp_path_factory.mktemp("long") / "report.html"
    made, runs = factory.violated_run(), []
    for k in range(1, 131):
        named = replace(made.trace.scenario, title=f"{factory.HOSTILE} {k} & 'more'")
        runs.append(replace(made, trace=replace(made.trace, scenario=named)))
    said = {"title": "Long", "command": "", "interrupted": False}
    write_report(path, runs, generated_at=datetime(2025, 11, 21, tzinfo=UTC), **said)  # type: ignore[arg-type]
    return Path(path).as_uri()


TITLES = "return [...document.querySelectorAll('.verdicts tbody th a')].map((one) => one.textContent)"


def test_a_long_table_finds_and_sorts_rows_that_were_never_laid_out(browser: Any, long_report: str) -> None:
    from selenium.webdriver.support.ui import WebDriverWait

    show(browser, long_report, width=1280)
    WebDriverWait(browser, 30).until(lambda _: len(browser.execute_script(TITLES)) == 40)
    counted = browser.find_element("css selector", ".filter output")
    assert counted.text == "390 rows, the first 40 shown"
    find = browser.find_element("css selector", ".filter input")
    find.send_keys(" 127 & 'more'")
    assert browser.execute_script(TITLES) == [f"{factory.HOSTILE} 127 & 'more'"] * 3  # as it was written
    assert browser.execute_script("return document.querySelectorAll('.verdicts b').length") == 0
    find.clear()
    browser.execute_script("document.querySelector('.verdicts thead button').click()")
    sort = "return [...document.querySelectorAll('.verdicts thead button')].forEach((one) => one.click())"
    browser.execute_script(sort)
    browser.execute_script("document.querySelector('.more').click()")
    assert len(browser.execute_script(TITLES)) == 390


@pytest.mark.parametrize("width", [390, 1280])
def test_an_address_asks_for_rows_that_were_never_laid_out(
    browser: Any, long_report: str, width: int
) -> None:
    forget(browser)
    show(browser, f"{long_report}#find=127&verdict=violated", width=width)
    assert len(browser.execute_script(TITLES)) == 2
    assert browser.get_log("browser") == []
    cells = (
        "return [...document.querySelectorAll('.verdicts tbody th')].every((one) => one.offsetWidth > 200)"
    )
    assert browser.execute_script(cells)


def test_a_link_opens_a_run_that_was_not_read_yet_and_all_are_read_in_time(
    browser: Any, long_report: str
) -> None:
    show(browser, f"{long_report}#run-130", width=1280)
    assert browser.execute_script("return document.querySelector('#run-130 > details').open")
    left = "document.querySelector('noscript.runs')"
    wait = f"const done = arguments[0], look = () => {left} ? setTimeout(look, 20) : done();"
    browser.execute_async_script(wait + "look()")
    assert browser.execute_script("return document.querySelectorAll('article.folds').length") == 130


def test_a_long_page_has_all_of_it_without_scripts(long_report: str) -> None:
    page = parse(Path(unquote(urlparse(long_report).path)).read_text())
    assert len(page.all("article", "folds")) == 130
    assert sum(len(one.all("tr")) - 1 for one in page.all("table", "verdicts")) == 390
