"""``safety_harness.fuzz``: what it returns, and that the command writes and says the same."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest

import safety_harness
from safety_harness.base.exceptions import InputError
from safety_harness.cli.fuzz import fuzz as fuzz_command
from safety_harness.search import session as search_session
from tests.search.short_space import TEXT


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(search_session, "SHRINKING_RUNS", 5)
    monkeypatch.setattr(search_session, "MOST_SHRUNK", 1)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "short.yaml").write_text(TEXT)
    return tmp_path


def texts(folder: Path) -> dict[str, str]:
    """The files of a search without what depends on time: how many questions were asked again."""
    files = [*folder.rglob("*.yaml"), *folder.glob("coverage.svg"), folder / "findings.json"]
    return {os.path.relpath(one, folder): re.sub(r'"asked": \d+', "", one.read_text()) for one in files}


def test_what_is_written_afterwards_is_what_the_command_writes(folder: Path) -> None:
    found = safety_harness.fuzz("short.yaml", budget=12)
    assert sorted(folder.iterdir()) == [folder / "short.yaml"]  # nothing before it is asked for
    code = fuzz_command(Path("short.yaml"), out=Path("out"), budget=12)
    Path("out").rename("by-command")
    written = found.write("out")
    assert texts(Path("out")) == texts(Path("by-command"))
    assert code == found.exit_code == 1
    (one,) = written.counterexamples
    assert one.path.parent == Path("out")
    assert one.path.with_suffix(".trace").is_file()
    again = safety_harness.run(one.path)
    assert again.exit_code == 0
    said = repr(found)
    assert said.startswith(f"<short: {found.session.causes.summary}; ")
    assert " and in PyBullet" in said
    assert "; claims exercised in " in said
    assert "\n" not in said


def test_an_option_that_cannot_be_used_is_refused() -> None:
    with pytest.raises(InputError, match="at least 1 run; got 0"):
        safety_harness.fuzz("short.yaml", budget=0)
