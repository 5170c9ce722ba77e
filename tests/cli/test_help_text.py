"""``--help`` folds each paragraph once, and shows exit codes as a table."""

from __future__ import annotations

import itertools
import re

import pytest
from typer.main import get_command
from typer.testing import CliRunner

from safety_harness.cli.help_text import laid_out
from safety_harness.cli.main import app

TEXT = """Write a file.

    The command writes a file, and it says so in a sentence that a docstring
    folds.

    Exit code 0: written.
    Exit code 1: the file is there already, and it
    differs.
    Exit code 1 too: the disk is full.
    Exit code 130: interrupted.
    """


@pytest.mark.parametrize("plain", [False, True])
def test_a_docstring_becomes_paragraphs_and_a_table(plain: bool) -> None:
    first, second, table = laid_out(TEXT, 40, plain=plain).split("\n\n")
    assert first == "Write a file."
    assert second == "The command writes a file, and it says so in a sentence that a docstring folds."
    assert table.removeprefix("\b\n").splitlines() == [
        "Exit codes:",
        "0    written",
        "1    the file is there already, and it",
        "     differs; the disk is full",
        "130  interrupted",
    ]
    assert table.startswith("\b") == plain


@pytest.mark.parametrize("columns", [50, 80, 130])
@pytest.mark.parametrize("command", ["run", "fuzz", "validate", "docs"])
def test_no_line_of_a_paragraph_ends_before_the_next_word_would_not_fit(
    command: str, columns: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    shown = CliRunner().invoke(app, [command, "--help"]).stdout
    prose = shown.split("Exit codes:")[0].split("\n")
    for line, after in itertools.pairwise(prose):
        if line.strip() and after.strip() and "Usage" not in line:
            assert len(line.strip()) + 1 + len(after.split()[0]) > columns - 2, line


def test_exit_codes_are_a_table_in_every_command_that_states_them() -> None:
    group = get_command(app)
    names = [name for name in group.commands if "Exit code 0" in (group.commands[name].help or "")]  # type: ignore[attr-defined]
    assert len(names) > 10
    for name in names:
        shown = CliRunner().invoke(app, [name, "--help"]).stdout
        assert re.search(r"Exit codes:\s+0    ", shown), name
        assert "Exit code 0" not in shown, name
