"""Compiled templates are kept in the cache; a damaged cache, or one that cannot be written, costs nothing."""

from __future__ import annotations

from pathlib import Path

import pytest

from safety_harness.report.page_parts import templates


def rendered() -> str:
    environment = templates.__wrapped__()
    return environment.from_string("{{ 1 + 1 }}").render() + environment.get_template("page.html.j2").name


@pytest.fixture
def kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("SAFETY_HARNESS_CACHE", str(tmp_path))
    return tmp_path


def files(folder: Path) -> list[Path]:
    return [file for file in folder.rglob("*") if file.is_file()]


def test_a_template_is_compiled_once(kept: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert rendered() == "2page.html.j2"
    (file,) = files(kept)
    environment = templates.__wrapped__()
    monkeypatch.setattr(environment, "compile", None)
    assert environment.get_template("page.html.j2").name == "page.html.j2"
    assert files(kept) == [file]


@pytest.mark.parametrize("content", [b"", b"damaged", b"j2\x05\x00"])
def test_a_damaged_file_is_compiled_again(content: bytes, kept: Path) -> None:
    rendered()
    (file,) = files(kept)
    whole = file.read_bytes()
    file.write_bytes(content)
    assert rendered() == "2page.html.j2"
    assert file.read_bytes() == whole


def test_a_folder_that_cannot_be_written_keeps_nothing(kept: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (kept / "file").touch()
    monkeypatch.setenv("SAFETY_HARNESS_CACHE", str(kept / "file"))
    assert rendered() == "2page.html.j2"
    assert files(kept) == [kept / "file"]
