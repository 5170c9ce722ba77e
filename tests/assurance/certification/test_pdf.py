from __future__ import annotations

from pathlib import Path

import pytest
from browsing import needed

from safety_harness.base.exceptions import InputError, OutputError
from safety_harness.extensions.assurance.certification.folder import browser, write_pdf


def test_without_a_browser_it_says_what_is_missing(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(InputError, match="Chromium") as refused:
        browser()
    assert refused.value.place.field == "--pdf"


def test_a_browser_that_prints_nothing_is_an_error(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    fake = tmp_path / "chromium"
    fake.write_text("#!/bin/sh\necho no display >&2\nexit 3\n")
    fake.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
    with pytest.raises(OutputError, match="no display"):
        write_pdf(tmp_path / "page.html", tmp_path / "page.pdf")


def test_a_page_is_printed(tmp_path: Path) -> None:
    needed("chromium")
    page = tmp_path / "page.html"
    page.write_text("<!DOCTYPE html><title>t</title><p>words</p>")
    write_pdf(page, tmp_path / "page.pdf")
    assert (tmp_path / "page.pdf").read_bytes().startswith(b"%PDF-")
