"""The next command that a command prints runs as printed, also with a path that needs quotes."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest
from typer.testing import CliRunner

from safety_harness.cli.main import app

TEXT = """\
scenario: a short run
duration: 300 ms
tcp start: {offset: [0 mm, -60 mm, 20 mm]}
avoider: opposite pose
claims: {joint speeds within limits: holds, hand distance never below 50 mm: holds}
hands:
- hand: right hand
  starts at: [800 mm, -300 mm, 300 mm]
  elbow towards: [1600 mm, -1200 mm, 300 mm]
  moves: [{reach for tcp: 2 m/s, stop at distance: 20 mm, give up after: 2 s}]
"""
SPACE = TEXT.replace("scenario:", "scenario space:").replace("300 ms", "from 300 ms to 400 ms")
TRACE = "runs/1/traces/one.trace"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder whose name has a blank, with a scenario, a space and two reports."""
    made = tmp_path_factory.mktemp("of") / "a cell"
    made.mkdir()
    (made / "one.yaml").write_text(TEXT)
    (made / "space.yaml").write_text(SPACE)
    for name in ("1", "2"):
        found = CliRunner().invoke(app, ["run", str(made / "one.yaml"), "--out", str(made / "runs" / name)])
        assert found.exit_code in (0, 1), found.output
    return made


def next_words(arguments: list[str]) -> list[str]:
    """The words of the next command of a command that ends well; it must end well itself."""
    found = CliRunner().invoke(app, arguments)
    assert found.exit_code in (0, 1), found.output
    line = found.stderr.splitlines()[-1]
    assert line.startswith("next: safety-harness "), found.stderr
    words = shlex.split(line.removeprefix("next: safety-harness ").partition("    (")[0])
    then = CliRunner().invoke(app, words + ["--no-open"] * (words[0] == "view"))
    assert then.exit_code in (0, 1), then.output
    return words


def in_folder(folder: Path, words: list[str]) -> list[str]:
    paths = ("runs", "one.yaml", "page.html", "pictures", "run.", "LOG")
    return [str(folder / word) if word.startswith(paths) else word for word in words]


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["view", TRACE, "--no-open", "--out", "page.html"], ["judge", TRACE, "-v"]),
        (["attribute", TRACE], ["attribute", TRACE, "--confirm"]),
        (["attribute", TRACE, "--confirm"], ["view", TRACE]),
        (["attribute", "runs/1/traces", "--confirm"], ["view", TRACE]),
        (["attribute", "one.yaml", "--confirm"], ["run", "one.yaml"]),
        (["show", "one.yaml", "--out", "pictures"], ["run", "one.yaml"]),
    ],
)
def test_a_command_that_ends_well_ends_with_the_next_command(
    folder: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, arguments: list[str], expected: list[str]
) -> None:
    monkeypatch.chdir(tmp_path)  # where commands without --out write
    assert next_words(in_folder(folder, arguments)) == in_folder(folder, expected)


def test_the_picture_of_a_space_leads_to_its_search(folder: Path, tmp_path: Path) -> None:
    file, out = folder / "space.yaml", str(tmp_path)
    found = CliRunner().invoke(app, ["show", str(file), "--out", out, "--draws", "2"])
    assert found.stderr.splitlines()[-1] == f"next: safety-harness fuzz '{file}'"
