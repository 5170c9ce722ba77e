"""The site: built strictly, read from a folder in a browser that is offline, and searched there."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

import safety_harness

ROOT = Path(__file__).parents[2]
ALONE = {"NO_MKDOCS_2_WARNING": "1"}


def build(config: Path, site: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "-f", str(config), "-d", str(site)]
    return subprocess.run(command, capture_output=True, text=True, env=os.environ | ALONE, timeout=300)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    done = build(ROOT / "mkdocs.yml", folder)
    assert done.returncode == 0, done.stderr
    return folder


def small(tmp_path: Path, page: str) -> subprocess.CompletedProcess[str]:
    """The build of one page with our settings and hook."""
    text = (ROOT / "mkdocs.yml").read_text()
    contents = text[: text.index("\nnav:")].replace("[docs/hooks.py]", f"[{ROOT / 'docs' / 'hooks.py'}]")
    (tmp_path / "mkdocs.yml").write_text(contents + "\nnav:\n  - Start: index.md\n")
    (tmp_path / "docs" / "assets").mkdir(parents=True)
    (tmp_path / "docs" / "assets" / "iframe-worker.js").write_text("")
    (tmp_path / "docs" / "index.md").write_text(page)
    return build(tmp_path / "mkdocs.yml", tmp_path / "site")


def test_a_page_without_fault_is_built(tmp_path: Path) -> None:
    assert small(tmp_path, "# one\n\n[two](#two)\n\n## two\n").returncode == 0


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
    done = small(tmp_path, f"# one\n\n{page}\n")
    assert done.returncode != 0
    assert why in done.stderr + done.stdout


def test_the_site_is_searched_from_a_folder_without_a_network(site: Path, browser: Any) -> None:
    browser.get_log("performance")
    browser.get((site / "index.html").as_uri() + "?q=Clopper")
    found = ""
    for _ in range(300):
        links = browser.find_elements("css selector", ".md-search-result__link")
        found = " ".join(link.get_attribute("href") for link in links)
        if found:
            break
        time.sleep(0.1)
    assert "statistics.html" in found
    messages = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
    asked = [m["params"]["request"]["url"] for m in messages if m["method"] == "Network.requestWillBeSent"]
    assert asked
    assert not [url for url in asked if not url.startswith(("file:", "data:", "blob:"))]


def test_linked_files_of_the_repository_are_pages(site: Path) -> None:
    page = (site / "repository/examples/upwards.py.html").read_text()
    assert "class Upwards" in re.sub("<[^>]+>", "", page)
    assert "repository/examples/upwards.py.html" in (site / "avoiders.html").read_text()


def test_every_public_name_is_in_the_reference_and_its_arrays_say_their_shapes(site: Path) -> None:
    pages = "".join(page.read_text() for page in sorted((site / "api").glob("*.html")))
    assert [name for name in safety_harness.__all__ if f'id="safety_harness.{name}"' not in pages] == []
    servoing = re.sub("<[^>]+>", "", (site / "api" / "servoing.html").read_text())
    assert "L_wz =  i mu_(i-1,j+1) - j mu_(i+1,j-1)" in servoing
    assert "desired_interaction: (6, 6) L*" in servoing
    assert "interaction_pinv: (6, 6)" in servoing
