"""The evidence report in a real browser: quiet, readable, its replays play and show what the trace has."""

from __future__ import annotations

import base64
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browsing import assert_quiet, colour, forget, show
from made_up_evidence import evidence
from partly_measured import partly_measured

from safety_harness.admission.admit import admit
from safety_harness.admission.trial import judge, run_kinematic
from safety_harness.extensions.assurance.certification.page import render
from safety_harness.report.evidence import JudgedRun
from safety_harness.scenario.read import read_scenario
from safety_harness.trace.known import Gap, Measurement, Source
from safety_harness.trace.unmeasured import knowing

SCENARIO = Path(__file__).parents[3] / "scenarios" / "fast-reach.yaml"
FIRST = "document.querySelector('figure.replay')"


@pytest.fixture(scope="module")
def run() -> JudgedRun:
    trace = run_kinematic(admit(read_scenario(SCENARIO)))
    return JudgedRun(trace=trace, evaluations=judge(trace), replay_command="")


@pytest.fixture(scope="module")
def report(run: JudgedRun, tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("certification") / "evidence.html"
    path.write_text(render(evidence(), {1: run, 2: run}))
    return path.as_uri()


def replayed(browser: Any, name: str, number: int = 0) -> str:
    figure = f"document.querySelectorAll('figure.replay')[{number}]"
    return str(browser.execute_script(f"return {figure}.dataset[arguments[0]]", name))


def awake(browser: Any, number: int = 0) -> None:
    """Scroll to a replay and wait until it is drawn."""
    from selenium.webdriver.support.wait import WebDriverWait

    figure = f"document.querySelectorAll('figure.replay')[{number}]"
    browser.execute_script(f"{figure}.scrollIntoView({{block: 'center'}})")
    WebDriverWait(browser, 60).until(
        lambda _: replayed(browser, "triangles", number) not in ("", "None", "0")
    )


def test_no_request_leaves_the_page_and_nothing_is_wrong_in_the_console(browser: Any, report: str) -> None:
    assert_quiet(
        browser, report, do="document.querySelectorAll('details').forEach((d) => { d.open = true; })"
    )


def test_markup_of_the_user_runs_nowhere(browser: Any, report: str) -> None:
    show(browser, report, width=1000)
    kinds = browser.execute_script("return [...document.scripts].map((s) => s.type)")
    assert kinds == [""]
    assert browser.execute_script("return document.querySelectorAll('b').length") == 0


@pytest.mark.parametrize(("width", "scheme"), [(360, "light"), (768, "dark"), (1280, "light")])
def test_the_page_never_scrolls_sideways(browser: Any, report: str, width: int, scheme: str) -> None:
    show(browser, report, width=width, scheme=scheme)
    browser.execute_script("document.querySelectorAll('details').forEach((d) => { d.open = true; })")
    assert browser.execute_script("return document.documentElement.scrollWidth") <= width
    outside = browser.execute_script(
        """return [...document.querySelectorAll('main *, header *, footer *')].filter((e) =>
             !e.closest('.drawing, .unseen, .stage') && e.getBoundingClientRect().right > innerWidth + 1
           ).map((e) => e.outerHTML.slice(0, 120))"""
    )
    assert outside == []


def test_every_link_leads_to_a_part_of_the_page_that_then_is_open(browser: Any, report: str) -> None:
    show(browser, report, width=1000)
    lost = browser.execute_script(
        """return [...document.querySelectorAll('a[href]')].map((a) => a.getAttribute('href'))
             .filter((h) => !h.startsWith('#') || !document.getElementById(h.slice(1)))"""
    )
    assert lost == []
    browser.execute_script("location.hash = 'files'")
    assert browser.execute_script("return document.getElementById('files').open")


def test_a_replay_shows_the_arm_where_the_trace_has_it(browser: Any, report: str, run: JudgedRun) -> None:
    """The viewer turns the joints by itself; where its tool comes to lie is known from the trace."""
    show(browser, report, width=420)
    awake(browser)
    for time_s in (0.0, 1.0, 2.48):
        browser.execute_script(
            f"""const scrub = {FIRST}.querySelector('.scrub');
                scrub.value = arguments[0]; scrub.dispatchEvent(new Event('input'))""",
            time_s,
        )
        shown = np.array([float(word) for word in replayed(browser, "tcp").split()])
        tick = round(time_s / run.trace.scenario.settings.clock.control_period_s)
        true = run.trace.ticks["transform_tcp_to_base"][tick, :3, 3]
        assert np.abs(shown - true).max() < 2e-3, time_s


def to_the_beginning(browser: Any) -> None:
    """Far from the end of the replay, however slow this machine is."""
    begin = "s.value = s.min; s.dispatchEvent(new Event('input'))"
    browser.execute_script(f"const s = {FIRST}.querySelector('.scrub'); {begin}")


def test_a_replay_plays_pauses_and_ends(browser: Any, report: str, run: JudgedRun) -> None:
    from selenium.webdriver.common.by import By
    from selenium.webdriver.support.wait import WebDriverWait

    show(browser, report, width=420)
    awake(browser)
    figure = browser.find_elements(By.CSS_SELECTOR, "figure.replay")[0]
    play = figure.find_element(By.CSS_SELECTOR, ".play")
    to_the_beginning(browser)
    browser.execute_script(f"{FIRST}.querySelector('.speed').value = '0.1'")  # a busy machine draws seldom
    before = float(replayed(browser, "time"))
    play.click()
    assert play.text == "Pause"
    WebDriverWait(browser, 60).until(lambda _: float(replayed(browser, "time")) > before + 0.1)
    assert replayed(browser, "state") == "playing"
    play.click()
    WebDriverWait(browser, 60).until(lambda _: replayed(browser, "state") == "paused")
    assert play.text == "Play"
    nearly = "s.value = s.max - 0.05; s.dispatchEvent(new Event('input'))"
    browser.execute_script(f"const s = {FIRST}.querySelector('.scrub'); {nearly}")
    play.click()
    WebDriverWait(browser, 60).until(lambda _: replayed(browser, "state") == "paused")
    assert float(replayed(browser, "time")) == pytest.approx(run.trace.time_s[-1], abs=1e-3)


def test_the_button_and_the_replay_go_to_the_worst_moment_of_the_claim_in_the_heading(
    browser: Any, run: JudgedRun, tmp_path: Path
) -> None:
    """Two headings of one run, whose claims have their worst moments at other times."""
    from selenium.webdriver.common.by import By

    moments = {one.sentence: one.worst_time_s for one in run.evaluations if one.worst_time_s}
    first = "hand distance never below 50 mm"
    second = max(moments, key=lambda sentence: abs(moments[sentence] - moments[first]))
    assert abs(moments[first] - moments[second]) > 0.05
    whole = evidence()
    examples = tuple(
        replace(one, sentence=sentence)
        for one, sentence in zip(whole.counterexamples, (first, second), strict=True)
    )
    path = tmp_path / "evidence.html"
    path.write_text(render(replace(whole, counterexamples=examples), {1: run, 2: run}))
    show(browser, path.as_uri(), width=420)
    for number, sentence in enumerate((first, second)):
        awake(browser, number)
        assert float(replayed(browser, "time", number)) == pytest.approx(moments[sentence], abs=1e-3)
        article = browser.find_elements(By.CSS_SELECTOR, "article.counterexample")[number]
        assert sentence in article.find_element(By.TAG_NAME, "h3").text
        assert f"worst moment at {moments[sentence]:.3f} s" in article.text
        figure = f"document.querySelectorAll('figure.replay')[{number}]"
        begin = "s.value = s.min; s.dispatchEvent(new Event('input'))"
        browser.execute_script(f"const s = {figure}.querySelector('.scrub'); {begin}")
        assert float(replayed(browser, "time", number)) == 0.0
        browser.execute_script(f"{figure}.querySelector('[data-jump]').click()")
        assert float(replayed(browser, "time", number)) == pytest.approx(moments[sentence], abs=1e-3)
        assert f"TCP at {moments[sentence]:.3f} s" in article.text
        tick = int(np.argmin(np.abs(run.trace.time_s - moments[sentence])))
        distance_mm = run.trace.ticks["hand_distance_m"][tick, 0] * 1e3
        says = article.find_element(By.CSS_SELECTOR, ".says-now").text
        assert f"{abs(distance_mm):.0f} mm" in says


def test_the_keyboard_turns_plays_and_pauses(browser: Any, report: str) -> None:
    from selenium.webdriver.common.by import By
    from selenium.webdriver.common.keys import Keys
    from selenium.webdriver.support.wait import WebDriverWait

    show(browser, report, width=420)
    awake(browser)
    stage = browser.find_elements(By.CSS_SELECTOR, "figure.replay .stage")[0]
    before = stage.screenshot_as_png
    browser.execute_script("arguments[0].focus()", stage)
    for _ in range(4):
        stage.send_keys(Keys.ARROW_LEFT)
    assert stage.screenshot_as_png != before
    for state in ("playing", "paused"):
        stage.send_keys(Keys.SPACE)
        WebDriverWait(browser, 60).until(lambda _, state=state: replayed(browser, "state") == state)
    to_the_beginning(browser)
    scrub = browser.find_elements(By.CSS_SELECTOR, "figure.replay .scrub")[0]
    text = scrub.get_attribute("aria-valuetext")
    scrub.send_keys(Keys.ARROW_RIGHT, Keys.ARROW_RIGHT)
    assert scrub.get_attribute("aria-valuetext") != text


def test_one_picture_is_lent_to_the_replay_that_is_looked_at(browser: Any, report: str) -> None:
    show(browser, report, width=420)
    awake(browser)
    awake(browser, 1)
    assert browser.execute_script("return document.querySelectorAll('canvas').length") == 1
    inside = "return document.querySelectorAll('figure.replay')[1].contains(document.querySelector('canvas'))"
    assert browser.execute_script(inside)


def test_the_replay_follows_the_colours_of_the_page(browser: Any, report: str) -> None:
    brightness = {}
    for scheme in ("light", "dark"):
        show(browser, report, width=420, scheme=scheme)
        awake(browser)
        brightness[scheme] = sum(colour(browser, "figure.replay", "backgroundColor"))
    assert brightness["light"] > 600 > 200 > brightness["dark"]


def test_a_table_is_copied_with_all_its_cells(browser: Any, report: str) -> None:
    show(browser, report, width=1000)
    text = browser.execute_script(
        """const button = document.querySelector('.copy-table'); button.click();
           return new Promise((done) => setTimeout(() => done(button.dataset.copied), 300))"""
    )
    lines = text.split("\n")
    assert len(lines) == 7
    assert {line.count("\t") for line in lines} == {6}
    assert lines[1].startswith("hand distance never below 50 mm\trefuted\t1.71 %")


def test_in_print_all_is_unfolded_and_no_table_is_cut(browser: Any, report: str) -> None:
    show(browser, report, width=700, scheme="dark", media="print")
    assert sum(colour(browser, "body", "backgroundColor")) > 600
    printed = browser.execute_cdp_cmd("Page.printToPDF", {"preferCSSPageSize": True})
    assert base64.b64decode(printed["data"]).startswith(b"%PDF")
    assert browser.execute_script("return [...document.querySelectorAll('details')].every((d) => d.open)")
    cut = browser.execute_script(
        """return [...document.querySelectorAll('table')].filter((t) =>
             t.getBoundingClientRect().right > innerWidth + 1
             || getComputedStyle(t.rows[1] ?? t.rows[0]).breakInside !== 'avoid'
           ).map((t) => t.caption?.textContent)"""
    )
    assert cut == []
    assert browser.execute_script(f"return getComputedStyle({FIRST}).display") == "none"


def test_the_page_leads_within_two_screens_and_has_few_stops_for_the_keyboard(
    browser: Any, report: str
) -> None:
    show(browser, report, width=1280)
    led = browser.execute_script("return document.querySelector('.verdicts').getBoundingClientRect().bottom")
    assert led <= 2 * 800
    stops = browser.execute_script(
        """return [...document.querySelectorAll("a[href], button, input, select, summary, [tabindex]")]
             .filter((e) => e.tabIndex >= 0 && !e.disabled && e.checkVisibility()).length"""
    )
    assert 40 < stops <= 140


def test_the_argument_begins_on_a_phone_s_screen(browser: Any, report: str) -> None:
    show(browser, report, width=390)
    box = "document.querySelector('.gsn a').getBoundingClientRect()"
    left, right = browser.execute_script(f"return [{box}.left, {box}.right]")
    assert 0 <= left < right <= 390


def test_a_printed_page_has_25_sheets_at_most_and_all_of_it_if_asked(
    browser: Any, run: JudgedRun, tmp_path: Path
) -> None:
    """More counterexamples and faults than fit."""
    whole = evidence()
    examples = tuple(replace(whole.counterexamples[0], number=number) for number in range(1, 31))
    assert whole.selftest is not None
    trial = replace(whole.selftest, faults=whole.selftest.faults * 40)
    full = replace(whole.provenance, command="safety-harness certify plan.yaml --full")
    sheets = []
    for provenance in (whole.provenance, full):
        many = replace(whole, counterexamples=examples, selftest=trial, provenance=provenance)
        (tmp_path / "evidence.html").write_text(render(many, dict.fromkeys(range(1, 31), run)))
        show(browser, (tmp_path / "evidence.html").as_uri(), width=1280, media="print")
        printed = browser.execute_cdp_cmd("Page.printToPDF", {"preferCSSPageSize": True})["data"]
        sheets.append(len(re.findall(rb"/Type\s*/Page\b(?!s)", base64.b64decode(printed))))
    assert 10 < sheets[0] <= 25
    assert sheets[1] > 40


def test_the_coverage_map_tells_what_a_cell_counts_under_the_pointer_and_from_the_keyboard(
    browser: Any, report: str
) -> None:
    from selenium.webdriver.common.by import By
    from selenium.webdriver.common.keys import Keys

    show(browser, report, width=1280)
    walk = browser.find_element(By.CSS_SELECTOR, ".cells input")
    says = browser.find_element(By.CSS_SELECTOR, ".cells output")
    first = says.text
    assert first == "above, above 1 m/s, to 50 mm, hand unseen, protective stop: 19 runs, 4 with a violation"
    walk.send_keys(Keys.ARROW_RIGHT)
    assert says.text == "right, to 1 m/s, to 200 mm, seen, proposed position: 41 runs"
    assert walk.get_attribute("aria-valuetext") == says.text
    browser.execute_script(
        """document.querySelector("svg g:has(> title) rect")
             .dispatchEvent(new PointerEvent("pointerover", { bubbles: true }))"""
    )
    assert says.text == first


def test_it_opens_quickly_enough_to_be_read(browser: Any, report: str) -> None:
    """No claim about this machine's clock: the whole page is there before any replay is built."""
    show(browser, report, width=1000)
    assert browser.execute_script("return document.readyState") == "complete"
    assert replayed(browser, "state", 1) == "asleep"


def test_a_replay_shows_what_was_measured_and_says_what_was_not(
    browser: Any, run: JudgedRun, tmp_path: Path
) -> None:
    lost = Measurement(source=Source.LOG, gaps=(Gap(first=10, after=60),))
    trace = knowing(partly_measured(run.trace), {"transform_tcp_to_base": lost, "joint_position_rad": lost})
    (tmp_path / "evidence.html").write_text(render(evidence(), {1: replace(run, trace=trace)}))
    forget(browser)
    show(browser, (tmp_path / "evidence.html").as_uri(), width=1000)
    awake(browser)
    assert "mode not measured" in said(browser, 0.5)
    assert " mm" in said(browser, 0.5)
    assert "not measured" in said(browser, 1.0).replace("mode not measured", "")
    assert browser.get_log("browser") == []


def said(browser: Any, time_s: float) -> str:
    """What a replay says at a time."""
    script = f"const r = {FIRST}.querySelector('.scrub'); r.value = {time_s};"
    browser.execute_script(script + "r.dispatchEvent(new Event('input'));")
    return str(browser.execute_script(f"return {FIRST}.querySelector('.says-now').textContent"))
