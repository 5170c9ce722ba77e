"""A file is there whole or not at all, and nothing is left beside it."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from safety_harness.base import whole_file
from safety_harness.base.whole_file import replacing, write_whole


def no_room(_: int) -> None:
    raise OSError("no space left")


def write_half(path: Path, error: BaseException) -> None:
    with replacing(path) as unfinished:
        unfinished.write_text("half")
        raise error


def test_what_is_written_takes_the_place_of_what_was_there(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "er" / "file.txt"
    for text in ("old\n", "new\r\n\udcff"):
        write_whole(path, text)
    assert path.read_bytes() == b"new\r\n\\udcff"
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize("there", [True, False])
def test_whatever_goes_wrong_what_was_there_stays_and_nothing_is_left(there: bool, tmp_path: Path) -> None:
    path = tmp_path / "file.txt"
    if there:
        path.write_text("old")
    for error in (OSError("no space left"), KeyboardInterrupt()):
        with pytest.raises(type(error)):
            write_half(path, error)
        assert list(tmp_path.iterdir()) == [path] * there
    assert not there or path.read_text() == "old"


def test_what_is_not_on_the_disk_takes_no_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "file.txt"
    path.write_text("old")
    monkeypatch.setattr(os, "fsync", no_room)
    with pytest.raises(OSError, match="no space"), replacing(path) as unfinished:
        unfinished.write_text("new")
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_what_was_never_written_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError), replacing(tmp_path / "file.txt"):
        pass


def test_the_rest_of_an_earlier_process_is_no_beginning(tmp_path: Path) -> None:
    with replacing(tmp_path / "file.txt") as unfinished:
        unfinished.write_text("rest")
        with replacing(tmp_path / "file.txt") as again:  # the same number, as if that one had been killed
            assert again == unfinished
            assert not again.exists()
            again.write_text("new")
        unfinished.write_text("newer")
    assert (tmp_path / "file.txt").read_text() == "newer"


def test_only_one_place_in_the_package_replaces_files() -> None:
    """Whoever writes a file by halves and renames it elsewhere forgets what ``replacing`` does not."""
    package = Path(whole_file.__file__).parent
    users = {
        file.name
        for file in package.rglob("*.py")
        if "os.replace(" in (text := file.read_text()) or '.part"' in text
    }
    assert users == {"whole_file.py"}
