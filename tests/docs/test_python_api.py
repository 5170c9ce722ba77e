"""The examples of docs/reference/python/jobs.md run as they stand, and have at most ten lines."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "reference" / "python" / "jobs.md").read_text(encoding="utf-8")
BLOCKS = dict(re.findall(r"^## (.*?)\n.*?```python\n(.*?)```", PAGE, re.M | re.S))
LONG = ("Search for violations", "Certify a plan", "Score an avoider")  # tests of each job are quick siblings


@pytest.mark.parametrize("title", BLOCKS)
def test_an_example_has_at_most_ten_lines(title: str) -> None:
    assert len(BLOCKS[title].splitlines()) <= 10
    assert len(BLOCKS) == 7


@pytest.mark.parametrize(
    "title", [pytest.param(one, marks=[pytest.mark.long] * (one in LONG)) for one in BLOCKS]
)
def test_an_example_runs_as_it_stands(
    title: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(ROOT / "examples" / "logs", tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    exec(compile(BLOCKS[title], title, "exec"), {})
    assert capsys.readouterr().out
