"""The site: built strictly, read from a folder in a browser that is offline, and searched there."""

from __future__ import annotations

import json
import os
import re
import threading
import time
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import build_site
import pytest

import safety_harness

ROOT = Path(__file__).parents[2]
SEARCH = """
  const found = [...document.querySelectorAll("*")].map((one) => one.shadowRoot).find((one) => one);
  const box = found?.querySelector("input");
  if (!box) return "";
  if (box.value !== arguments[0]) {
    box.value = arguments[0];
    box.dispatchEvent(new Event("input", { bubbles: true }));
  }
  return [...found.querySelectorAll("a")].map((one) => one.href).join(" ");
"""


class Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *_: object) -> None:
        """Nothing."""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The one that was built before, if we are told where ("make site-tests"); else built here."""
    if built := os.environ.get("SAFETY_HARNESS_SITE"):
        return Path(built)
    folder = tmp_path_factory.mktemp("site") / "site"
    build_site.main([str(folder)])
    return folder


def one_page(tmp_path: Path, page: str) -> None:
    """A repository with one page and our settings."""
    text = (ROOT / "mkdocs.yml").read_text()
    (tmp_path / "mkdocs.yml").write_text(text[: text.index("\nnav:")] + "\nnav:\n  - Start: index.md\n")
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs" / "index.md").write_text(page)


def small(tmp_path: Path, page: str) -> None:
    """Its build."""
    one_page(tmp_path, page)
    build_site.build(tmp_path, tmp_path / "site")


def test_a_page_without_fault_is_built(tmp_path: Path) -> None:
    one_page(tmp_path, "# one\n\n[two](#two)\n\n## two\n")
    (tmp_path / "docs" / "moved.yaml").write_text("zero: one\n")
    build_site.build(tmp_path, tmp_path / "site")
    assert "two" in (tmp_path / "site" / "index.html").read_text()
    assert (tmp_path / "site" / "moved.yaml").read_text() == "zero: one\n"  # for safety-harness docs


def test_of_releases_on_a_server_a_reader_chooses_one(tmp_path: Path, browser: Any) -> None:
    one_page(tmp_path, "# one\n\n[two](#two)\n\n## two\n")
    out = tmp_path / "sites"
    for version in ("0.9.0", "0.10.0"):
        build_site.release(tmp_path, out, version)
    listed = json.loads((out / "versions.json").read_text())
    assert [(one["version"], one["aliases"]) for one in listed] == [("0.10.0", ["latest"]), ("0.9.0", [])]
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(out)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        browser.get(f"http://127.0.0.1:{server.server_port}/")
        chosen = (
            "return [...document.querySelectorAll('.md-version__link')].map((one) => one.textContent.trim())"
        )
        until = time.monotonic() + 30.0
        while not (found := browser.execute_script(chosen)) and time.monotonic() < until:
            time.sleep(0.1)
        assert found == ["0.10.0", "0.9.0"]
        assert browser.current_url.rstrip("/").endswith("/0.10.0")
    finally:
        browser.get("about:blank")
        server.shutdown()
        server.server_close()


@pytest.mark.parametrize(
    ("page", "why"),
    [
        ("[there](nowhere.md)", "nowhere.md"),
        ("[there](#nowhere)", "nowhere"),
        ('<img src="https://example.org/a.png">', "without a network"),
        ('<script src="//example.org/a.js"></script>', "without a network"),
    ],
)
def test_a_broken_link_or_something_to_fetch_fails_the_build(page: str, why: str, tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match=re.escape(why)):
        small(tmp_path, f"# one\n\n{page}\n")


# What a field's own people type, and where they should be led.
WORDS = {
    "Clopper": "explanation/statistics.html",
    "uniform": "how-to/scenarios.html",
    "falsification": "reference/glossary.html",
    "robustness": "reference/glossary.html",
    "STL": "explanation/formulas.html",
    "vacuity": "reference/glossary.html",
}


def test_the_site_is_searched_from_a_folder_without_a_network(site: Path, browser: Any) -> None:
    browser.get_log("performance")
    browser.get((site / "index.html").as_uri())
    browser.execute_script("document.querySelector('.md-search__button').click()")
    found = dict.fromkeys(WORDS, "")
    for word, place in WORDS.items():
        for _ in range(300):
            found[word] = browser.execute_script(SEARCH, word)
            if place in found[word]:
                break
            time.sleep(0.1)
    assert {word: place for word, place in WORDS.items() if place not in found[word]} == {}
    messages = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
    asked = [m["params"]["request"]["url"] for m in messages if m["method"] == "Network.requestWillBeSent"]
    assert asked
    assert not [url for url in asked if not url.startswith(("file:", "data:", "blob:"))]


def test_linked_files_of_the_repository_are_pages(site: Path) -> None:
    page = (site / "repository/examples/upwards.py.html").read_text()
    assert "class Upwards" in re.sub("<[^>]+>", "", page)
    assert "repository/examples/upwards.py.html" in (site / "how-to" / "avoider.html").read_text()


def test_every_public_name_is_in_the_reference_and_its_arrays_say_their_shapes(site: Path) -> None:
    pages = "".join(page.read_text() for page in sorted((site / "reference" / "python").glob("*.html")))
    assert [name for name in safety_harness.__all__ if f'id="safety_harness.{name}"' not in pages] == []
    servoing = re.sub("<[^>]+>", "", (site / "reference" / "python" / "servoing.html").read_text())
    assert "L_wz =  i mu_(i-1,j+1) - j mu_(i+1,j-1)" in servoing
    assert re.search(r"interaction\s+NDArray\[float64\]\s+\(6, 6\) L\*", servoing)
    assert re.search(r"polygon_m\s+NDArray\[float64\]\s+The object's vertices \(n, 2\)", servoing)
