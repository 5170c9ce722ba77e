"""``view`` writes one page with the replay of a stored run, or of two in step, and says what is not in it."""

from __future__ import annotations

import webbrowser
from dataclasses import replace
from pathlib import Path

import pytest
from browsing import show
from partly_measured import partly_measured

from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT
from safety_harness.extensions.pages.commands.drawing import view
from safety_harness.trace.store import save_trace
from safety_harness.trace.trace import Trace

MOST_BYTES = 600_000
ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def stored(visit: Trace, tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("traces") / "visit.trace"
    save_trace(visit, file)
    return file


def test_one_page_that_asks_nothing_of_the_network_is_written_and_opened(
    stored: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[str] = []
    monkeypatch.setattr(webbrowser, "open", lambda address: opened.append(address) or True)
    page = tmp_path / "deep" / "visit.html"
    assert view(stored, out=page) == AS_EXPECTED
    said = capsys.readouterr()
    assert said.out == f"{page}\n"
    assert said.err == f"next: safety-harness judge {stored} -v    (every verdict)\n"
    assert opened == [page.as_uri()]
    text = page.read_text()
    assert len(text) < MOST_BYTES
    assert "http:" not in text
    assert "https:" not in text
    assert text.count("<script") == 1
    assert view(stored, out=page, opens=False) == AS_EXPECTED
    assert len(opened) == 1


def test_what_was_not_measured_is_left_out_and_said(
    visit: Trace, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "partly.trace"
    save_trace(partly_measured(visit), file)
    assert view(file, out=tmp_path / "partly.html", opens=False) == AS_EXPECTED
    told = capsys.readouterr().err
    assert "not measured: " in told
    assert "mode" in told.partition("not measured: ")[2]
    assert "not measured: " in (tmp_path / "partly.html").read_text()


def test_bad_files_are_one_clear_error(
    stored: Path, visit: Trace, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    empty, broken = tmp_path / "empty.trace", tmp_path / "broken.trace"
    save_trace(
        replace(
            visit,
            ticks=visit.ticks[:0],
            decisions=visit.decisions[:0],
            decision_latency_s=visit.decision_latency_s[:0],
            overshoot_radps=visit.overshoot_radps[:0],
            ended="interrupted",
        ),
        empty,
    )
    broken.write_bytes(stored.read_bytes()[:-200])
    page = tmp_path / "page.html"
    for file, told in (
        (empty, "a run with at least one tick"),
        (broken, "broken.trace"),
        (tmp_path / "none.trace", "none.trace"),
        (ROOT / "scenarios" / "fast-reach.yaml", "safety-harness run"),
    ):
        assert view(stored, file, out=page, opens=False) == BAD_INPUT
        out, err = capsys.readouterr()
        assert out == ""
        assert err.count("error: ") == 1
        assert told in err, err
        assert not page.exists()
    assert view(stored, out=tmp_path / "page.pdf", opens=False) == BAD_INPUT
    assert "a file.html" in capsys.readouterr().err


def test_two_runs_go_in_step(browser: object, stored: Path, tmp_path: Path) -> None:
    from selenium.webdriver.support.wait import WebDriverWait

    page = tmp_path / "two.html"
    assert view(stored, stored, out=page, opens=False) == AS_EXPECTED
    show(browser, page.as_uri(), width=1200)
    script = "return [...document.querySelectorAll('figure.replay')].map((one) => one.dataset[arguments[0]])"
    run = browser.execute_script  # type: ignore[attr-defined]
    WebDriverWait(browser, 60).until(lambda _: run(script, "state") == ["ready", "ready"])
    stage = "document.querySelectorAll('.stage')[1]"
    for key, times in (("End", None), ("Home", ["0.000", "0.000"])):
        run(f"{stage}.dispatchEvent(new KeyboardEvent('keydown', {{ key: '{key}', bubbles: true }}))")
        WebDriverWait(browser, 20).until(lambda _: len(set(run(script, "time"))) == 1)
        if times:
            WebDriverWait(browser, 20).until(lambda _, times=times: run(script, "time") == times)
    assert len(set(run(script, "tcp"))) == 1
    run("document.querySelector('figure.replay [data-layer=separation]').click()")
    assert (
        run("return document.querySelectorAll('figure.replay [data-layer=separation][hidden]').length") == 0
    )
    lines = run("return [...document.querySelectorAll('svg .now')].map((one) => one.getAttribute('d'))")
    assert len(lines) == 4  # a strip and a drawing over time of each
    shown = run(
        """const svg = document.querySelector('svg[aria-labelledby^="view-1-time-"]');
           const { left, width } = svg.getBoundingClientRect();
           svg.dispatchEvent(new PointerEvent('pointerdown', { clientX: left + width / 2, bubbles: true }));
           return [...document.querySelectorAll('figure.replay')].map((one) => Number(one.dataset.time))"""
    )
    assert shown[0] == shown[1] > 0.0
    run(
        """window.saved = null; const made = URL.createObjectURL;
           URL.createObjectURL = (blob) => {
             const reader = new FileReader();
             reader.onload = () => { window.saved = reader.result; };
             reader.readAsDataURL(blob);
             return made(blob);
           };
           document.querySelector('figure.replay [data-save=png]').click()"""
    )
    WebDriverWait(browser, 30).until(lambda _: run("return window.saved"))
    assert run("return window.saved").startswith("data:image/png;base64,iVBOR")
