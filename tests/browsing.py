"""A real browser for tests of pages: what it takes to start it, and how a page is shown in it."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from typing import Any

import pytest

FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--enable-unsafe-swiftshader",  # WebGL without a graphics card
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)
REQUIRED = os.environ.get("SAFETY_HARNESS_REQUIRE_BROWSER") == "1"


def needed(program: str) -> str:
    found = shutil.which(program)
    if found is None:
        message = f"{program} is not installed, so pages are not tried in a browser"
        if REQUIRED:
            pytest.fail(message)
        pytest.skip(message)
    return found


def started(profile: Path) -> Any:
    """Chromium, driven by selenium; the test is skipped (or fails, where it is required) without them."""
    binary, driver = needed("chromium"), needed("chromedriver")
    if not REQUIRED:
        pytest.importorskip("selenium", reason="selenium is not installed")
    from selenium import webdriver
    from selenium.webdriver.chrome.options import Options
    from selenium.webdriver.chrome.service import Service

    options = Options()
    options.binary_location = binary
    for flag in FLAGS:
        options.add_argument(flag)
    options.add_argument(f"--user-data-dir={profile}")
    options.set_capability("goog:loggingPrefs", {"performance": "ALL", "browser": "ALL"})
    return webdriver.Chrome(options=options, service=Service(driver))


def show(browser: Any, report: str, *, width: int, scheme: str = "light", media: str = "screen") -> None:
    features = [{"name": "prefers-color-scheme", "value": scheme}]
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": media, "features": features})
    size = {"width": width, "height": 800, "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    browser.get(report)
    # The driver may return while the page still loads: its script has not filtered the rows yet.
    loaded = "document.readyState === 'complete' ? arguments[0]() : addEventListener('load', () => done())"
    browser.execute_async_script(f"const done = arguments[0]; {loaded}")


def colour(browser: Any, selector: str, name: str) -> list[int]:
    script = "return getComputedStyle(document.querySelector(arguments[0]))[arguments[1]]"
    value = browser.execute_script(script, selector, name)
    return [int(word) for word in value[value.index("(") + 1 : -1].split(",")[:3]]


def forget(browser: Any) -> None:
    """Leave the page that is shown, and empty the logs: what it still had to say is not the next one's."""
    browser.get("about:blank")
    browser.get_log("performance")
    browser.get_log("browser")


def assert_quiet(browser: Any, page: str, *, do: str = "scrollTo(0, document.body.scrollHeight)") -> None:
    """Show the page and do something there: nothing else is asked for, and the console has no word."""
    forget(browser)
    show(browser, page, width=1000)
    browser.execute_script(do)
    messages = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
    sent = [m["params"] for m in messages if m["method"] == "Network.requestWillBeSent"]
    asked = {one["request"]["url"] for one in sent if one["documentURL"] == page}
    assert page in asked, asked  # the log does see requests
    assert asked - {page} <= {"data:,"}, asked
    said = browser.get_log("browser")
    assert said == [], said
