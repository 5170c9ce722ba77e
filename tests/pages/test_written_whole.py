"""A report is there whole or not at all."""

from __future__ import annotations

import os
from datetime import UTC, datetime
from pathlib import Path

import factory
import pytest

from safety_harness.extensions.pages.run_page import write_report

WHEN = datetime(2025, 11, 21, 9, 30, tzinfo=UTC)


def test_a_report_is_written_whole_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "deep" / "er" / "report.html"
    arguments = {"title": "t", "command": "c", "interrupted": False, "generated_at": WHEN}
    write_report(path, [], **arguments)
    before = path.read_bytes()
    assert before.endswith(b"</html>\n")

    def no_room(_: int) -> None:
        raise OSError("no space left")

    monkeypatch.setattr(os, "fsync", no_room)
    with pytest.raises(OSError, match="no space"):
        write_report(path, [factory.truncated_run()], **arguments)
    assert path.read_bytes() == before
    assert list(path.parent.iterdir()) == [path]


def test_text_that_cannot_be_encoded_does_not_lose_the_report(tmp_path: Path) -> None:
    write_report(tmp_path / "r.html", [], title="\udcff", command="c", interrupted=False, generated_at=WHEN)
    assert "\\udcff" in (tmp_path / "r.html").read_text(encoding="utf-8")


def test_a_keyword_that_no_report_has_is_not_left_out_silently(tmp_path: Path) -> None:
    arguments = {"title": "t", "command": "c", "interrupted": False, "generated_at": WHEN}
    with pytest.raises(TypeError, match="unknown keywords: skiped"):
        write_report(tmp_path / "r.html", [], **arguments, skiped=())
    assert not list(tmp_path.iterdir())
